"""`remind warmup`: what it compiles is there for the next process."""

import numpy as np

from remind_jax.cli.flags import load_config_with
from remind_jax.compiled import kept
from remind_jax.compiled.programs import clear_programs
from remind_jax.session.live import Tracker
from tests.cli import scenes

SMALL = ("static.num_detections=4", "static.num_objects=6", "static.num_pending=4")


def words(size: str) -> tuple[str, ...]:
    return "warmup", size, "--tracker", "bank", "--objects", "0", "--set", *SMALL


def test_what_was_warmed_up_is_loaded_later_for_as_many_as_it_says(command, folder):
    size = f"{scenes.WIDTH_PX}x{scenes.HEIGHT_PX}"
    done = command(*words(size), "--detections", "6")
    assert done.code == 0, done.stderr
    assert size in done.stdout
    assert str(folder) in done.stdout
    assert "for up to 8 detections in a frame and 6 objects" in done.stdout
    made = sorted(folder.iterdir())
    assert len(made) >= 3  # features, description, decision

    clear_programs()
    tracker = Tracker(load_config_with("default", (SMALL,), tracker="bank"))
    image, labels = scenes.picture(0)
    tracker.update(image, labels)
    tracker.update(image, np.stack([labels == 1] * 6))
    assert tracker.static.num_detections == 8
    tracker._memory.ahead.finish()
    assert sorted(folder.iterdir()) == made


def test_nothing_is_kept_if_so_wished(command, monkeypatch):
    monkeypatch.setenv(kept.VARIABLE, "off")
    size = f"{scenes.WIDTH_PX}x{scenes.HEIGHT_PX}"
    done = command(*words(size), "--detections", "0")
    assert "nothing is kept" in done.stdout


def test_a_folder_that_keeps_nothing_is_told(command, monkeypatch, tmp_path):
    (tmp_path / "file").write_text("no folder")
    monkeypatch.setenv(kept.VARIABLE, str(tmp_path / "file"))
    done = command(*words(f"{scenes.WIDTH_PX}x{scenes.HEIGHT_PX}"), "--detections", "0")
    assert done.code == 1
    assert "nothing could be kept in" in done.stderr
