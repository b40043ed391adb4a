import dataclasses
import errno
import json
import os
from pathlib import Path

import av
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import OutputError, SourceError
from remind_jax.outputs import overlay, tables
from remind_jax.outputs.label_edits import LABEL_PAGE_NAME
from remind_jax.outputs.report import read_sightings
from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import CVAT_NAME, FILE_NAMES, RunWriter, render_again
from tests.cli import scenes
from tests.outputs.fake_run import make_info, make_run, write_run


@pytest.fixture(scope="module")
def made():
    return make_run(num_frames=30)


def crops_of(folder: Path) -> list[tuple[int, int, bytes]]:
    sightings = read_sightings(folder / "report.html")
    return [(one.object_id, one.position, one.image.tobytes()) for one in sightings]


def count_frames(path: Path) -> int:
    with av.open(str(path)) as container:
        return sum(1 for _ in container.decode(video=0))


def test_a_finished_run_has_everything(tmp_path, made):
    write_run(tmp_path / "out", *made)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == sorted(FILE_NAMES)
    assert count_frames(tmp_path / "out" / "overlay.mp4") == 30
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["complete"] is True
    assert run["summary"] == made[1].summary()
    assert run["info"]["config"] == made[1].info.config
    loaded = Result.load(tmp_path / "out")
    assert loaded.summary()["outcome_shares"] == made[1].summary()["outcome_shares"]


def test_frames_without_images_are_written(tmp_path, made):
    frames = [type(f)(f.index, f.source_index, f.time_s, f.name) for f in made[0]]
    write_run(tmp_path, frames, made[1])
    assert count_frames(tmp_path / "overlay.mp4") == 30


@pytest.mark.parametrize("num_frames", [12, 0])
def test_what_was_added_is_there_without_an_end(tmp_path, made, num_frames):
    frames, result = made

    def stop_early() -> None:
        with RunWriter(tmp_path, result.info) as writer:
            for frame, tracks in zip(frames[:num_frames], result.tracks, strict=False):
                writer.add(frame, tracks)
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stop_early()
    loaded = Result.load(tmp_path)
    assert (loaded.complete, len(loaded)) == (False, num_frames)
    video = tmp_path / "overlay.mp4"
    assert (count_frames(video) if video.exists() else 0) == num_frames


def test_an_unusable_frame_rate_gets_a_neutral_one(tmp_path, made):
    frames, result = made
    info = type(result.info)(**{**vars(result.info), "fps": 0.0})
    write_run(tmp_path, frames[:3], type(result)(result.tracks[:3], info))
    assert Result.load(tmp_path).info.fps == 10


def test_overwriting_removes_only_what_a_run_writes(tmp_path, made):
    (tmp_path / "notes.txt").write_text("mine")
    old = [tmp_path / name for name in ("overlay.mp4", LABEL_PAGE_NAME, CVAT_NAME)]
    for file in old:
        file.write_text("old")
    write_run(tmp_path, *made, overwrite=True, overlay=False)
    assert (tmp_path / "notes.txt").read_text() == "mine"
    assert not any(file.exists() for file in old)


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_a_folder_without_permission_is_named(tmp_path):
    (tmp_path / "out").mkdir(mode=0o500)
    with pytest.raises(OutputError, match="may not be written to"):
        RunWriter(tmp_path / "out", make_info())


def fill_disk_under(path: Path) -> None:
    """From now on every write to this open file fails as on a full disk."""
    for link in Path("/proc/self/fd").iterdir():
        if os.path.realpath(link) == str(path):
            os.dup2(os.open("/dev/full", os.O_WRONLY), int(link.name))


def write_to_full_disk(folder: Path, made, full: str) -> None:
    frames, result = made
    with RunWriter(folder, result.info) as writer:
        for number, (frame, tracks) in enumerate(zip(frames, result.tracks, strict=True)):
            if number == 3:
                fill_disk_under(folder / full)
            writer.add(frame, tracks)


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("full", ["detections.jsonl", "tracks.csv"])
def test_a_full_disk_is_named_and_the_rest_is_kept(tmp_path, made, full):
    with pytest.raises(OutputError, match=rf"cannot write '.*{full}': No space left on device"):
        write_to_full_disk(tmp_path, made, full)
    loaded = Result.load(tmp_path)
    assert len(loaded) >= 3
    assert not loaded.complete
    assert count_frames(tmp_path / "overlay.mp4") == 3


def test_failing_to_finish_does_not_hide_the_first_error(tmp_path, monkeypatch):
    def pictures():
        yield scenes.picture(0)
        raise SourceError("the real one")

    def fail(*_):
        raise OutputError("no room")

    monkeypatch.setattr(tables, "write_tables", fail)
    with pytest.raises(SourceError, match="the real one"):
        rj.run(pictures(), tracker="iou", out=tmp_path, overlay=False, progress=False)
    assert json.loads((tmp_path / "run.json").read_text())["complete"] is False


def test_failing_to_finish_leaves_an_incomplete_run(tmp_path, made, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OutputError, match="No space left"):
        write_run(tmp_path, *made)
    loaded = Result.load(tmp_path)
    assert (loaded.complete, len(loaded)) == (False, 30)


def test_rendering_again_from_the_source_restores_every_picture(tmp_path, made):
    write_run(tmp_path, *made)
    names = ("overlay.mp4", "report.html", "mot.txt")
    before = {name: (tmp_path / name).read_bytes() for name in names}
    crops = crops_of(tmp_path)
    for name in names:
        (tmp_path / name).unlink()
    render_again(tmp_path, made[0])
    assert (tmp_path / "mot.txt").read_bytes() == before["mot.txt"]
    assert crops_of(tmp_path) == crops
    assert count_frames(tmp_path / "overlay.mp4") == 30
    assert (tmp_path / "report.html").exists()


def test_rendering_again_without_a_source_keeps_images(tmp_path, made):
    write_run(tmp_path, *made)
    overlay_before = (tmp_path / "overlay.mp4").read_bytes()
    crops = read_sightings(tmp_path / "report.html")
    result = render_again(tmp_path)
    assert len(result) == 30
    assert (tmp_path / "overlay.mp4").read_bytes() == overlay_before
    again = read_sightings(tmp_path / "report.html")
    assert len(again) == len(crops) > 0
    # The crops come back from JPEG: noise changes a little, the picture does not.
    for before, after in zip(crops, again, strict=True):
        assert np.abs(after.image.astype(int) - before.image).mean() < 3


def test_a_killed_run_is_drawn_from_its_detections(tmp_path, made):
    write_run(tmp_path, *made)
    for path in tmp_path.iterdir():
        if path.name != "detections.jsonl":
            path.unlink()
    (tmp_path / "overlay.mp4").write_bytes(b"\0" * 1000)
    result = render_again(tmp_path)
    assert not result.complete
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(
        set(FILE_NAMES) - {"tracks.csv"}
    )
    assert overlay.is_playable(tmp_path / "overlay.mp4")


def test_a_source_that_lacks_frames_is_refused_and_nothing_is_lost(tmp_path, made):
    write_run(tmp_path, *made)
    before = (tmp_path / "overlay.mp4").read_bytes()
    with pytest.raises(OutputError, match=r"the source has no frame 20 \('000020.jpg'\)"):
        render_again(tmp_path, made[0][:10])
    with pytest.raises(OutputError, match="frame 0 of the source is 80x64, that of the run 160x1"):
        render_again(tmp_path, make_run(num_frames=30, size=(64, 80))[0])
    dataclasses.replace(made[1], skipped=()).save_run_json(tmp_path)
    longer = [*made[0], dataclasses.replace(made[0][-1], source_index=99)]
    with pytest.raises(OutputError, match="has more frames than the 30 of the run"):
        render_again(tmp_path, longer, is_moved=True)
    assert (tmp_path / "overlay.mp4").read_bytes() == before
    assert sorted(path.name for path in tmp_path.iterdir()) == sorted(FILE_NAMES)
