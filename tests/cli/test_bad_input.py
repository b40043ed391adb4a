"""Bad input gets one sentence and exit code 1, and what was done is kept."""

import json
import resource

import cv2
import numpy as np

from remind_jax.outputs.result import Result


def assert_refused(outcome, *words: str) -> None:
    """Exit code 1 and one sentence that holds all the words, no traceback."""
    assert outcome.code == 1, outcome
    assert outcome.stdout == ""
    sentence, *notes = outcome.stderr.splitlines()
    assert sentence.startswith("remind: ")
    assert all(note.startswith("what was done until then") for note in notes)
    for word in words:
        assert word in sentence


def test_corrupt_image_in_the_middle_is_skipped_counted_and_reported(command, scene):
    images, masks = scene
    bad = images / "0001.png"
    bad.write_bytes(bad.read_bytes()[:200])
    outcome = command("run", images, "--masks", masks, "--json", "--out", "a")
    summary = json.loads(outcome.stdout)
    assert (summary["frames"], summary["skipped_frames"]) == (3, 1)
    assert summary["skipped"][0]["name"] == "0001.png"
    outcome = command("run", images, "--masks", masks, "--out", "b")
    assert "1 frame skipped: '0001.png'" in outcome.stdout
    assert outcome.stderr == ""


def test_mask_of_another_size(command, scene):
    images, masks = scene
    cv2.imwrite(str(masks / "0002.png"), np.zeros((64, 64), np.uint8))
    outcome = command("run", images, "--masks", masks, "--out", "out")
    assert_refused(outcome, "0002.png", "64x64", "256x192")
    assert "what was done until then (2 frames) is in out" in outcome.stderr
    kept = Result.load("out")
    assert (len(kept), kept.complete) == (2, False)
    assert kept.timings_ms["step"]
    names = {"memory.safetensors", "report.html", "overlay.mp4", "tracks.csv"}
    assert names <= {path.name for path in (scene[0].parent.parent / "out").iterdir()}


def test_full_disk(command, scene):
    """A limit on the size of files stands for the disk: the system refuses the same writes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, hard))
    try:
        outcome = command("run", scene[0], "--masks", scene[1], "--out", "out")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert_refused(outcome, "cannot write", "out/")
    assert len(Result.load("out")) == 4


def test_what_this_user_may_not_touch_is_told(command, scene, monkeypatch):
    def refuse(folder, *rest):
        raise PermissionError(13, "Permission denied", str(folder))

    monkeypatch.setattr("remind_jax.session.run.check_folder", refuse)
    outcome = command("run", scene[0], "--masks", scene[1], "--out", "out")
    assert_refused(outcome, "'out' may not be read or written by this user; allow it, or choose")
