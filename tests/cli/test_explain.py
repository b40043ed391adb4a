"""`remind run --trace` and `remind explain`, from files to sentences."""

import json
import shutil

import pytest

from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import FILE_NAMES
from tests.cli import scenes


@pytest.fixture(scope="module")
def kept(tmp_path_factory):
    """Where the traced run of this module is kept."""
    return tmp_path_factory.mktemp("kept") / "run"


@pytest.fixture
def traced(command, scene, kept):
    """A run of four frames with a trace, made where it is not there yet."""
    if not kept.exists():
        words = ("run", scene[0], "--masks", scene[1], "--trace", "--quiet", "--no-overlay")
        outcome = command(*words, "--out", kept)
        assert (outcome.code, outcome.stderr) == (0, "")
    return kept


def test_a_traced_run_keeps_its_trace(traced):
    written = {path.name for path in traced.iterdir()}
    assert written == {*FILE_NAMES, "memory.safetensors", "trace.npz"} - {"overlay.mp4"}


def test_a_decision_of_the_default_is_explained(command, traced):
    outcome = command("explain", traced, "--frame", 3, "--detection", 0)
    assert (outcome.code, outcome.stderr) == (0, "")
    name = Result.load(traced).tracks[3].display_name(0)
    assert outcome.stdout.startswith(f"frame 3 (0.30 s, 0003.png), detection 0: {name}\nmatch ")
    assert "1. It is detection 4 of a tracklet" in outcome.stdout
    words = ("explain", traced, "--frame", 3, "--detection", 0, "--json")
    content = json.loads(command(*words).stdout)
    assert (content["name"], content["outcome"], content["age"]) == (name, "match", 4)


def test_without_a_detection_the_frame_is_listed(command, traced):
    outcome = command("explain", traced, "--frame", 3)
    assert [line.split()[0] for line in outcome.stdout.splitlines()[2:]] == ["0", "1", "2"]
    listed = json.loads(command("explain", traced, "--frame", 3, "--json").stdout)
    assert len(listed["detections"]) == 3


def test_what_is_not_there_is_named(command, traced, tmp_path):
    for words, message in (
        (("--frame", 4), "the run has no frame 4; it has frames 0 to 3"),
        (("--frame", 4, "--detection", 0), "the run has no frame 4; it has frames 0 to 3"),
        (("--frame", 3, "--detection", 3), "frame 3 has no detection 3; it has detections 0 to 2"),
    ):
        outcome = command("explain", traced, *words)
        assert (outcome.code, outcome.stdout) == (1, "")
        assert outcome.stderr == f"remind: {message}\n"
    bare = tmp_path / "bare"
    shutil.copytree(traced, bare, ignore=shutil.ignore_patterns("trace.npz"))
    outcome = command("explain", "bare", "--frame", 0, "--detection", 0)
    assert outcome.code == 1
    assert outcome.stderr == "remind: 'bare' holds no trace; run again with --trace\n"
    (bare / "run.json").unlink()  # as of a run that was killed
    outcome = command("explain", "bare", "--frame", 0, "--detection", 0)
    assert "go on with it (--resume)" in outcome.stderr


@pytest.mark.parametrize("config", ["default", pytest.param("remind", marks=pytest.mark.heavy)])
def test_objects_are_called_as_they_were_announced(command, tmp_path, config):
    """The vase of the first frame is seen once; without waiting it would be object 0."""
    images, masks = scenes.write_scene(tmp_path / "scene", seen={0: (4,)})
    out = tmp_path / "run"
    options = ("--trace", "--quiet", "--no-overlay", "--announce-after", 2, "--out", out)
    options = (*options, "--config", config)
    assert command("run", images, "--masks", masks, *options).code == 0
    assert [i for t in Result.load(out).tracks for i in t.object_id] == [-1, *(3 * [0, 1, 2])]
    once = command("explain", out, "--frame", 0, "--detection", 0).stdout
    assert "detection 0: vase new?\nprovisional new (seen too few times)" in once
    assert "detected too few times to be announced (input.announce_after 2)" in " ".join(
        line.strip() for line in once.splitlines()
    )
    content = json.loads(command("explain", out, "--frame", 3, "--detection", 2, "--json").stdout)
    assert (content["object_id"], content["name"]) == (2, "book 2")
    compared = [candidate["object_id"] for candidate in content["candidates"]]
    assert compared == ([2] if config == "remind" else [])  # plus compares what is open
