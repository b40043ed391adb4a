import json
import os
import subprocess
import sys

import pytest

from remind_jax.cli.main import main
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


def test_the_page_lies_in_the_folder_of_the_run(run, capsys):
    assert main(["label", str(run)]) == 0
    said = "".join(capsys.readouterr().out.split())
    assert "label.html:6identities" in said
    page = (run / "label.html").read_text()
    assert '"labeling":{' in page
    assert "prepareLabeling();" in page
    assert "{{" not in page


@pytest.mark.parametrize("name", ["truth", "truth.xml"])
def test_edits_make_truth_of_the_run(run, edits, tmp_path, name, capsys):
    truth = tmp_path / name
    words = ["label", str(run), "--apply", str(edits), "--out", str(truth)]
    assert main(words) == 0
    assert "7 identities, 40 frames, 1 edits" in " ".join(capsys.readouterr().out.split())
    assert main(words) == 1
    assert "exists; name another place" in " ".join(capsys.readouterr().err.split())
    assert main([*words, "--overwrite", "--quiet"]) == 0
    if name == "truth":
        assert main(["eval", str(truth), str(truth), "--quiet"]) == 0
        assert evaluate(truth, truth).scores()["IDF1"] == 1
        assert evaluate(truth, run).scores()["IDF1"] < 1


def test_truth_needs_a_place_and_edits(run, edits, tmp_path, capsys):
    assert main(["label", str(run), "--apply", str(edits)]) == 2
    assert "--out" in capsys.readouterr().err
    for words in (["--out", str(tmp_path / "truth")], ["--overwrite"]):
        assert main(["label", str(run), *words]) == 2
        assert "--apply" in capsys.readouterr().err


def test_inputs_are_not_replaced(run, edits, tmp_path, capsys):
    words = ["label", str(run), "--apply", str(edits), "--overwrite", "--out"]
    assert main([*words, str(run)]) == 1
    assert main([*words, str(edits)]) == 1
    assert main([*words, str(run / "detections.jsonl")]) == 1
    assert main([*words, str(tmp_path)]) == 1
    assert capsys.readouterr().err.count("input") >= 4


def test_a_pipe_in_place_of_the_video_is_not_waited_for(run, capsys):
    os.mkfifo(run / "overlay.mp4")
    assert main(["label", str(run)]) == 0
    assert "label.html" in capsys.readouterr().out


def words_of(run, edits, truth):
    return ["label", str(run), "--apply", str(edits), "--out", str(truth)]


def test_what_a_killed_command_left_is_no_truth(run, edits, tmp_path, capsys):
    truth = tmp_path / "truth"
    (truth / "Annotations").mkdir(parents=True)
    gone = subprocess.Popen([sys.executable, "-c", ""])
    gone.wait()
    left = truth / f"tour.{saving._machine()}.{gone.pid}-1.part"
    left.mkdir()
    (left / "000000.png").write_bytes(b"half")
    assert main([*words_of(run, edits, truth), "--quiet"]) == 0
    assert not left.exists()
