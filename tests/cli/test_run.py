"""`remind run` and `remind view`, from files to files."""

import os
import shutil
import signal

import pytest

from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import FILE_NAMES
from remind_jax.session.live import Tracker


def test_run_writes_everything_and_says_what_it_found(command, scene, tmp_path):
    outcome = command("run", scene[0], "--masks", scene[1])
    assert (outcome.code, outcome.stderr) == (0, "")
    lines = outcome.stdout.splitlines()
    assert lines[0].startswith("images: 4 frames, 3 identities, 0 returns")
    assert lines[-1] == "output in runs/images, open runs/images/report.html"
    written = {path.name for path in (tmp_path / "runs" / "images").iterdir()}
    assert written == {*FILE_NAMES, "memory.safetensors"}


def test_an_earlier_run_is_replaced_only_on_request(command, scene):
    words = ("run", scene[0], "--masks", scene[1], "--quiet", "--no-overlay", "--out", "out")
    assert [command(*words).code, command(*words).code] == [0, 1]
    assert command(*words, "--overwrite", "--max-frames", 2).code == 0
    assert len(Result.load("out")) == 2


@pytest.fixture
def interrupted_after_two_frames(monkeypatch):
    """Ctrl-C is pressed while the second frame is in work."""
    advance = Tracker.advance

    def advance_and_interrupt(self, prepared):
        if prepared.frame.index == 1:
            os.kill(os.getpid(), signal.SIGINT)
        return advance(self, prepared)

    monkeypatch.setattr(Tracker, "advance", advance_and_interrupt)


@pytest.mark.usefixtures("interrupted_after_two_frames")
def test_interrupt_finishes_what_was_done(command, scene, tmp_path):
    outcome = command("run", scene[0], "--masks", scene[1], "--out", "out")
    assert outcome.code == 130
    assert "stopped; what was done is in out" in outcome.stdout
    kept = Result.load("out")
    assert (len(kept), kept.complete) == (2, False)
    assert {path.name for path in (tmp_path / "out").iterdir()} == {
        "checkpoint",  # what --resume goes on with
        *FILE_NAMES,
        "memory.safetensors",
    }


def test_view_draws_again_from_the_same_or_a_moved_source(command, scene, tmp_path):
    command("run", scene[0], "--masks", scene[1], "--quiet", "--out", "out")
    drawn = [tmp_path / "out" / name for name in ("overlay.mp4", "report.html")]
    for path in drawn:
        path.unlink()
    assert command("view", "out").stdout.startswith("images: 4 frames, 3 identities")
    assert all(path.exists() for path in drawn)
    shutil.move(scene[0], tmp_path / "moved")
    # Lines are as long as the terminal is wide.
    said = " ".join(command("view", "out").stdout.split())
    assert f"drawn without the frames: '{scene[0]}' does not exist" in said
    assert command("view", "out", "--source", "moved", "--quiet").code == 0


def test_source_names_become_folder_names(command, scene, tmp_path):
    strange = scene[0].rename(scene[0].with_name("my rooms: 2"))
    command("run", strange, "--masks", scene[1], "--quiet", "--no-overlay", "--max-frames", 1)
    assert (tmp_path / "runs" / "my_rooms_2").is_dir()


def test_features_are_kept_as_runs_go(command, scene, tmp_path):
    of_frames = ("--set", "input.closeups=never")
    run = ("run", scene[0], "--masks", scene[1], "--no-overlay", "--json", *of_frames)
    command(*run, "--out", "plain")
    tables = [(tmp_path / "plain" / "tracks.csv").read_bytes()]
    kept = []
    for name in ("first", "second"):
        command(*run, "--feature-cache", "kept", "--out", name)
        tables.append((tmp_path / name / "tracks.csv").read_bytes())
        files = (tmp_path / "kept").rglob("*.npy")
        kept.append({path: path.stat().st_mtime_ns for path in files})
    assert len(set(tables)) == 1
    assert kept[0] == kept[1]
    assert kept[0]
