import json
import os
import subprocess
import sys

import pytest

from remind_jax.files import saving
from remind_jax.metrics import evaluate
from tests.outputs.fake_run import make_run


@pytest.fixture
def edits(tmp_path):
    result = make_run()[1]
    content = {
        "format": "remind-jax edits",
        "version": 1,
        "run": result.info.name,
        "num_detections": sum(len(tracks) for tracks in result.tracks),
        "edits": [{"edit": "move", "id": 3, "first": 26, "last": 39, "to": 9}],
    }
    (tmp_path / "edits.json").write_text(json.dumps(content))
    return tmp_path / "edits.json"


def test_the_page_lies_in_the_folder_of_the_run(command, run):
    os.mkfifo(run / "overlay.mp4")  # a pipe in place of the video is not waited for
    outcome = command("label", run)
    assert outcome.code == 0
    assert "label.html:6identities" in "".join(outcome.stdout.split())
    page = (run / "label.html").read_text()
    assert '"labeling":{' in page
    assert "prepareLabeling();" in page
    assert "{{" not in page
    assert "not complete" not in outcome.stdout
    told = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**told, "complete": False}))
    assert "the run is not complete" in command("label", run).stdout


@pytest.mark.parametrize("name", ["truth", "truth.xml"])
def test_edits_make_truth_of_the_run(command, run, edits, tmp_path, name):
    truth = tmp_path / name
    words = ("label", run, "--apply", edits, "--out", truth)
    assert "7 identities, 40 frames, 1 edits" in " ".join(command(*words).stdout.split())
    again = command(*words)
    assert again.code == 1
    assert "exists; name another place" in again.stderr
    assert command(*words, "--overwrite", "--quiet").code == 0
    if name == "truth":
        assert command("eval", truth, truth, "--quiet").code == 0
        assert evaluate(truth, truth).scores()["IDF1"] == 1
        assert evaluate(truth, run).scores()["IDF1"] < 1


def test_truth_needs_a_place_and_edits(command, run, edits):
    for words, lacking in (
        (("--apply", edits), "--out"),
        (("--out", "truth"), "--apply"),
        (("--overwrite",), "--apply"),
    ):
        outcome = command("label", run, *words)
        assert outcome.code == 2
        assert lacking in outcome.stderr


def test_inputs_are_not_replaced(command, run, edits, tmp_path):
    for out in (run, edits, run / "detections.jsonl", tmp_path):
        outcome = command("label", run, "--apply", edits, "--overwrite", "--out", out)
        assert outcome.code == 1
        assert "input" in outcome.stderr


def test_what_a_killed_command_left_is_no_truth(command, run, edits, tmp_path):
    truth = tmp_path / "truth"
    (truth / "Annotations").mkdir(parents=True)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = truth / f"tour.{saving._machine()}.{gone.pid}-1.part"
    left.mkdir()
    (left / "000000.png").write_bytes(b"half")
    assert command("label", run, "--apply", edits, "--out", truth, "--quiet").code == 0
    assert not left.exists()
