"""What a new user gets wrong is told in one sentence that says what to do."""

from __future__ import annotations

from pathlib import Path

import pytest

from remind_jax.cli import process
from tests.cli import scenes


@pytest.fixture
def things(tmp_path) -> Path:
    """A folder with what may be taken for something else."""
    scenes.write_scene(tmp_path / "scene", num=4)
    (tmp_path / "empty").mkdir()
    (tmp_path / "notes.txt").write_text("hello\n")
    (tmp_path / "runs" / "rooms").mkdir(parents=True)
    (tmp_path / "runs" / "rooms" / "detections.jsonl").write_text("")
    return tmp_path


SCENE = ("run", "scene/images", "--masks", "scene/masks", "--out", "out")


@pytest.mark.parametrize(
    ("words", "code", "told"),
    [
        (("run", "scene/images", "--masks", "scene/images"), 1, "it is a color picture"),
        ((*SCENE, "--config", "notes.txt"), 1, "'notes.txt' is no configuration; give a .yaml or"),
        ((*SCENE, "--duration", "5"), 2, "--duration is for a camera or a stream"),
        ((*SCENE, "--live", "8642"), 2, "--live is '8642'; give HOST:PORT, as 127.0.0.1:8642"),
        ((*SCENE, "--classes", "chair"), 2, "--classes is for a detector; give --detector"),
        ((*SCENE, "--confidence", "0.7"), 2, "--confidence is for a detector; give --detector"),
        ((*SCENE, "--sequence", "bear"), 2, "--sequence is 'bear', and '"),
        ((*SCENE, "--record", "out"), 2, "--record and --out are the same folder; give"),
        ((*SCENE, "--backbone", "patch-statistics+"), 1, "has nothing before or after a plus"),
        ((*SCENE, "--backbone", "onnx:"), 1, "nothing follows 'onnx:' in backbone 'onnx:'; give a"),
        ((*SCENE, "--memory", "empty"), 1, "is a folder; give the file, memory.safetensors"),
        ((*SCENE, "--delay", "-1"), 2, "--delay is -1; give a whole number from 0"),
        ((*SCENE, "--weights", "x.safetensors"), 1, "it needs none, leave them out"),
        ((*SCENE, "--backbone", "onnx"), 1, "give a file after a colon, 'onnx:FILE'"),
        ((*SCENE, "--backbone", "vit"), 1, "'vit:FILE', or as weights (--weights FILE)"),
        ((*SCENE, "--detector", "yolo11n-seg.pt"), 1, "yolo export model=yolo11n-seg.pt"),
        (("demo", "--out", "scene"), 1, "holds no earlier run; choose another one with --out"),
        (("view", "nowhere"), 1, "'nowhere' is not the output folder of a run: it does not exist"),
        (("view", "runs/room"), 1, "it does not exist; runs beside it: rooms"),
        (("explain", "notes.txt", "--frame", "0"), 1, "it is a file"),
        (
            ("eval", "notes.txt", "notes.txt", "--resamples", "-3"),
            2,
            "--resamples is -3; give a whole number from 0",
        ),
        (("eval", "notes.txt", "notes.txt", "--num-frames", "0"), 2, "--num-frames is 0; give 1"),
        (("benchmark", "scene", "--detector", "x.engine"), 1, "is no ONNX file"),
        (("benchmark", "scene", "--iou", "0.4"), 2, "--iou is for a detector"),
        (("sweep",), 1, "name the scenes to sweep over"),
        (("sweep", "scene", "--set", "decision.new=1,2", "--random", "0"), 2, "--random is 0"),
        (("sweep", "scene", "--set", "decision.new=1,2", "--batch", "0"), 2, "--batch is 0"),
        (("sweep", "scene", "--set", "decision.new=1,2", "--top", "0"), 2, "--top is 0"),
        (("sweep", "scene", "--settings", "notes.txt"), 1, "holds no settings"),
        (("sweep", "scene", "--set", "decision.new="), 1, "--set decision.new: '' in '' is no val"),
        (
            ("sweep", "scene", "--set", "decision.new=1,2", "decision.new=2,3"),
            1,
            "--set gives values of 'decision.new' twice; give them once",
        ),
        (("eval", "nowhere", "--visits"), 1, "'nowhere' does not exist; give a folder"),
        (
            ("run", "scene/images", "--backbone", "vit"),
            1,
            "'vit': missing a required argument: 'weights'; give a file",
        ),
    ],
    ids=lambda value: "-".join(value) if isinstance(value, tuple) else "",
)
def test_one_sentence_says_what_to_do(command, things, words, code, told):
    outcome = command(*words, static=("static.num_objects=6",))
    assert outcome.code == code
    assert told in outcome.stderr
    assert outcome.stderr.startswith("remind: ")
    assert outcome.stderr.count("\n") == 1
    assert "Errno" not in outcome.stderr
    assert not (things / "out").exists()


def test_a_list_without_names_is_wrong_usage(command, things):
    for flag in ("--classes", "--ignored-classes", "--set"):
        outcome = command(*SCENE, flag, static=("static.num_objects=6",))
        assert outcome.code == process.USAGE
        assert outcome.stderr.startswith(f"remind: Error parsing {flag}: nothing follows it")


@pytest.mark.parametrize("words", [("help",), ("help", "eval"), ("eval", "--help")])
def test_help_is_found_either_way(command, words):
    outcome = command(*words)
    assert outcome.code == process.FINE
    assert outcome.stdout.startswith("usage: remind")
