import json
import os

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.errors import ConfigError, SourceError
from remind_jax.sources import Sampling, Source, open_source, reopen_source
from tests.sources import making


def same_frames(one, other):
    for a, b in zip(one, other, strict=True):
        np.testing.assert_array_equal(a.image, b.image)
        for field in ("index", "source_index", "time_s", "name"):
            assert getattr(a, field) == getattr(b, field)
        assert (a.detections is None) == (b.detections is None)
        if a.detections is not None:
            making.assert_same_detections(a.detections, b.detections)


@pytest.mark.parametrize("kind", ["video", "images", "davis"])
def test_description_reopens_the_same_frames(tmp_path, kind, monkeypatch):
    if kind == "video":
        making.write_video(tmp_path / "it.mp4", 6)
    elif kind == "images":
        making.write_images(tmp_path / "it", [f"{i}.png" for i in range(6)])
    else:
        making.write_davis(tmp_path / "it", num=6, metadata=making.LABELS)
    (name,) = [path.name for path in tmp_path.iterdir()]
    monkeypatch.chdir(tmp_path)
    rate = {} if kind == "video" else {"image_fps": 12}
    source = open_source(name, sampling=Sampling(stride=2, start=1), **rate)
    assert isinstance(source, Source)
    description = json.loads(json.dumps(source.describe()))
    monkeypatch.chdir("/")
    again = reopen_source(description)
    assert len(list(again)) == source.num_frames == 3
    same_frames(source, again)


def test_source_from_memory_says_that_it_cannot_be_reopened():
    description = open_source([making.picture(0)], name="camera").describe()
    assert description["reopen"] is None
    with pytest.raises(SourceError, match="'camera' came from memory"):
        reopen_source(description)


def test_file_with_masks_from_memory_reopens_without_them(tmp_path):
    making.write_images(tmp_path, ["0.png"])
    source = open_source(tmp_path, masks=[making.instance_map()])
    assert next(iter(source)).detections is not None
    assert next(iter(reopen_source(json.loads(json.dumps(source.describe()))))).detections is None


def test_source_passes_unchanged_and_can_be_sampled():
    source = open_source(np.stack([making.picture(i) for i in range(6)]), name="six")
    assert open_source(source) is source
    thinned = open_source(source, sampling={"stride": 3})
    assert thinned.name == "six"
    assert [f.source_index for f in thinned] == [0, 3]


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ({"sampling": {"strid": 2}}, "did you mean 'stride'"),
        ({"image_fps": 0}, "'image_fps' is 0"),
        ({"unlabelled": "ignore"}, "'unlabelled' is 'ignore'"),
        ({"sequence": "bear"}, "'sequence' is 'bear', and the source is no DAVIS folder"),
        ({"name": "\udcff"}, "'name' is .*; give text of 1 to 1000 characters"),
    ],
)
def test_bad_options_are_named(options, why):
    with pytest.raises(ConfigError, match=why):
        open_source([making.picture(0)], **options)


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("max_frames", r"give sampling=\{'max_frames': \.\.\.\}"),
        ("classes", r"give detector_options=\{'classes': \.\.\.\}"),
        ("masc", "did you mean 'masks'"),
        ("spec", "allowed: "),
    ],
)
def test_of_an_option_that_another_holds_it_is_told(name, why):
    with pytest.raises(ConfigError, match=f"run has no option '{name}'; {why}"):
        rj.run([making.picture(0)], **{name: 1})


def test_a_video_has_a_rate_of_its_own(tmp_path):
    making.write_video(tmp_path / "it.mp4", 2)
    with pytest.raises(ConfigError, match=r"'image_fps' is for images, and the video '.*it\.mp4'"):
        open_source(tmp_path / "it.mp4", image_fps=5)


def test_files_that_are_missing(tmp_path):
    making.write_images(tmp_path / "v", ["0.png"])
    for arguments in (
        {"spec": tmp_path / "w.mp4"},
        {"spec": tmp_path / "nowhere" / "w.mp4"},
        {"spec": tmp_path / "v", "masks": tmp_path / "m"},
        {"spec": tmp_path / "v", "metadata": tmp_path / "m.json"},
    ):
        with pytest.raises(SourceError, match="does not exist"):
            open_source(**arguments)


def test_a_damaged_description_is_told():
    for change in (
        {"spec": ["a"]},
        {"surprise": 1},
        {"sampling": {"stride": 0}},
        {"sampling": [1]},
        {"image_fps": float("nan")},
        {"unlabelled": "maybe"},
        {"name": 3},
    ):
        with pytest.raises(SourceError, match="the description of the source"):
            reopen_source({"name": "a", "reopen": {"spec": "a.mp4", **change}})


def test_names_that_are_no_text_are_written_out(tmp_path):
    """The disk takes any bytes; tables and records are UTF-8."""
    making.write_images(tmp_path / "v", ["0.png", "1.png"])
    os.rename(tmp_path / "v" / "1.png", os.fsencode(tmp_path / "v") + b"/1\xff.png")
    source = open_source(tmp_path / "v", masks="none")
    assert [frame.name for frame in source] == ["0.png", r"1\udcff.png"]
    os.rename(tmp_path / "v", os.fsencode(tmp_path) + b"/v\xff")
    with pytest.raises(SourceError, match=r"cannot be used: it is no text in UTF-8; rename it"):
        open_source(os.fsdecode(os.fsencode(tmp_path) + b"/v\xff"))


def test_a_current_folder_that_is_gone_is_told(tmp_path, monkeypatch):
    (tmp_path / "gone").mkdir()
    monkeypatch.chdir(tmp_path / "gone")
    (tmp_path / "gone").rmdir()
    with pytest.raises(SourceError, match=r"'x\.mp4' is no path that can be read"):
        open_source("x.mp4")
