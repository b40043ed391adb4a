import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.sources import Sampling, open_source
from tests.sources import making


def pictures(num):
    return np.stack([making.picture(i) for i in range(num)])


def test_array_of_images():
    source = open_source(pictures(5), image_fps=20, sampling=Sampling(stride=2))
    frames = list(source)
    assert source.num_frames == 3
    assert [f.source_index for f in frames] == [0, 2, 4]
    assert [f.time_s for f in frames] == pytest.approx([0, 0.1, 0.2])
    for frame in frames:
        np.testing.assert_array_equal(frame.image, making.picture(frame.source_index))


def test_pairs_of_image_and_detections():
    pairs = [(making.picture(i), making.instance_map(ids=(i + 1,))) for i in range(3)]
    frames = list(open_source([*pairs[:2], [*pairs[2]]], class_names={1: "a", 2: "b", 3: "c"}))
    assert [f.detections.labels for f in frames] == [("a",), ("b",), ("c",)]


def test_frames_keep_their_number_time_and_name():
    given = [
        Frame(0, 7, 1.5, "x", making.picture(0), Detections.empty(*making.SIZE)),
        Frame(1, 9, 2.5, "y", making.picture(1)),
    ]
    frames = list(open_source(iter(given), sampling=Sampling(start=8)))
    assert [(f.index, f.source_index, f.time_s, f.name) for f in frames] == [(0, 9, 2.5, "y")]


def test_paths_of_images(tmp_path):
    making.write_images(tmp_path, ["b.png", "a.png"])
    (tmp_path / "c.png").write_bytes(b"x")
    source = open_source([tmp_path / "b.png", str(tmp_path / "c.png"), tmp_path / "a.png"])
    assert [f.name for f in source] == ["b.png", "a.png"]
    assert source.skipped[0].name == "c.png"


def test_gray_and_transparent_images_become_rgb():
    gray = making.picture(0)[..., 0]
    rgba = np.dstack([making.picture(0), gray])
    first, second, third = [f.image for f in open_source([gray, rgba, gray[..., None]])]
    np.testing.assert_array_equal(first, np.dstack([gray] * 3))
    np.testing.assert_array_equal(second, making.picture(0))
    np.testing.assert_array_equal(third, first)


def test_a_buffer_that_is_filled_anew_may_be_given_again_and_again():
    def camera():
        image, masks = making.picture(0), making.instance_map(ids=(1,))
        for i in range(3):
            np.copyto(image, making.picture(i))
            np.copyto(masks, making.instance_map(ids=(i + 1,)))
            yield Frame(i, i, i, "", image) if i == 2 else (image, {"masks": masks[None] == i + 1})

    frames = list(open_source(camera(), class_names=["one"]))
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.image, making.picture(i))
    for i, frame in enumerate(frames[:2]):
        seen = making.instance_map(ids=(i + 1,)) == i + 1
        np.testing.assert_array_equal(np.asarray(frame.detections.masks)[0], seen)


def test_iterator_can_be_read_once():
    source = open_source(iter(pictures(2)), name="camera")
    assert source.num_frames is None
    assert len(list(source)) == 2
    with pytest.raises(SourceError, match="'camera' is an iterator and was read already"):
        list(source)


@pytest.mark.parametrize(
    "item", [np.zeros((4, 5, 3), np.float32), np.zeros(3, np.uint8), "a" * 3, None, object()]
)
def test_other_items_are_refused_or_skipped(item):
    with pytest.raises(SourceError, match=r"item 0 is|none of the 1 frames"):
        list(open_source([item]))


@pytest.mark.parametrize("nothing", [[], np.zeros((0, 4, 4, 3), np.uint8), iter(())])
def test_no_frames_is_one_sentence(nothing):
    with pytest.raises(SourceError, match="'frames' has no frames"):
        list(open_source(nothing))


def test_things_without_frames():
    for spec in (3.5, object()):
        with pytest.raises(SourceError, match="is no source of frames"):
            open_source(spec)
    with pytest.raises(SourceError, match=r"an array \[4, 5, 3\] is one picture"):
        open_source(np.zeros((4, 5, 3), np.uint8))


def test_masks_in_memory():
    maps = np.stack([making.instance_map(ids=(i + 1,)) for i in range(3)])
    source = open_source(pictures(3), masks=maps, sampling=Sampling(start=1))
    assert [f.detections.instance_ids.tolist() for f in source if f.detections] == [[2], [3]]


def test_masks_per_frame_of_any_form():
    maps = [making.instance_map(), None, {"boxes": [[0, 0, 4, 4]], "labels": ["cup"]}]
    found = [frame.detections.labels for frame in open_source(pictures(3), masks=maps)]
    assert found == [("object", "object"), (), ("cup",)]
    for wrong in (maps[2], np.array(5), b"a", 5):
        with pytest.raises(SourceError, match=r"masks of type \w+ are not"):
            open_source(pictures(3), masks=wrong)
    (note,) = open_source(pictures(2), masks=maps).notes
    assert note == "masks were given for 3 frames, of which there are 2"


def test_masks_and_sampling_that_do_not_fit_the_frames_are_told():
    described = Frame(0, 0, 0.0, "a", features=np.zeros((1, 1, 3), np.float32))
    maps = [making.instance_map()]
    for frames, options, told in (
        ([described], {"masks": maps}, "no images that the masks could belong to"),
        (pictures(2), {"masks": maps}, "masks were given for 1 frames"),
        (pictures(1), {"sampling": Sampling(start=3)}, "asked for is number 3; lower the start"),
    ):
        with pytest.raises(SourceError, match=told):
            list(open_source(frames, **options))


def test_a_frame_that_is_none_is_refused():
    for wrong in ({"name": None}, {"source_index": None}, {"image": "x.png"}):
        frame = Frame(**{**dict(index=0, source_index=0, time_s=0.0, name="a"), **wrong})
        with pytest.raises(SourceError, match="frame"):
            list(open_source([frame]))
