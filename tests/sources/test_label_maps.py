import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.metrics.opening import open_scenes
from remind_jax.sources import open_source
from remind_jax.sources.label_maps import instance_ids_in, match_annotations
from tests.sources import making


@pytest.mark.parametrize(
    ("files", "frames", "matched"),
    [
        (["b.png", "a.png"], ["a.jpg", "b.jpg"], {0: "a.png", 1: "b.png"}),
        (["DSC1.JPG.png"], ["DSC1.JPG", "DSC2.JPG"], {0: "DSC1.JPG.png"}),
        (["frame_000012.png"], ["00010.jpg", "00012.jpg"], {1: "frame_000012.png"}),
        (["m1.png", "m2.png"], ["7.jpg", "8.jpg"], {0: "m1.png", 1: "m2.png"}),
        (["m1.png"], ["7.jpg", "8.jpg"], {}),
    ],
    ids=["stem", "stem within stem", "number", "order", "nothing agrees"],
)
def test_annotations_find_their_frames(files, frames, matched):
    assert match_annotations(files, frames, len(frames)) == matched


@pytest.mark.parametrize(
    ("numbers", "num_frames", "first"), [((0, 1, 2), 3, 0), ((1, 2, 3), 3, 1), ((1, 2), 3, 0)]
)
def test_video_frames_are_numbered_from_zero_or_one(numbers, num_frames, first):
    files = [f"{n:05d}.png" for n in numbers]
    wanted = {n - first: f for n, f in zip(numbers, files, strict=True)}
    assert match_annotations(files, None, num_frames) == wanted


@pytest.mark.parametrize("frames", [None, ["0000.jpg", "0001.jpg", "0002.jpg"]])
@pytest.mark.parametrize("form", ["{:04d}_v2.png", "0000_{}.png 0001_{}.png"])
def test_two_annotations_of_one_number_are_refused(form, frames):
    files = [file for n in range(3) for file in form.format(n, n).split()]
    with pytest.raises(SourceError, match=r"'000\d_\w+\.png' and '000\d_\w+\.png'"):
        match_annotations(files, frames, 3)


@pytest.mark.parametrize(
    ("name", "told"),
    [("JPEGImages/v", "3 of 6 frames of 'v'"), ("v.mp4", "3 of 6 frames of 'v'"), ("v.mkv", "")],
    ids=["pictures", "video", "video of a length that is only estimated"],
)
def test_frames_without_annotation_are_told(tmp_path, name, told):
    making.write_davis(tmp_path, "v", 3)
    if name.startswith("v."):
        making.write_video(tmp_path / name, 6)
    else:
        making.write_images(tmp_path / name, [f"{i:05d}.jpg" for i in range(6)])
    notes = open_source(tmp_path / name, masks=tmp_path / "Annotations/v").notes
    assert len(notes) == bool(told)
    assert "".join(notes).startswith(told)


def test_masks_numbered_from_one_belong_to_a_video_of_a_length_that_is_only_estimated(tmp_path):
    making.write_video(tmp_path / "v.mkv", 6, times=(0, 1, 5, 6, 20, 21))
    for number in range(1, 7):
        making.write_map(tmp_path / f"m/{number}.png", ids=(number,))
    frames = open_source(tmp_path / "v.mkv", masks=tmp_path / "m")
    assert [f.detections.instance_ids.tolist() for f in frames] == [[i] for i in range(1, 7)]


def test_masks_of_other_frames_are_refused(tmp_path):
    making.write_images(tmp_path / "v", ["7.jpg", "8.jpg"])
    making.write_map(tmp_path / "m" / "a1.png")
    with pytest.raises(SourceError, match=r"no annotation .*\(first annotation 'a1\.png'"):
        open_source(tmp_path / "v", masks=tmp_path / "m")


def test_masks_folder_beside_any_images(tmp_path):
    making.write_images(tmp_path / "v", ["7.jpg", "8.jpg"])
    making.write_davis(tmp_path / "d", "v", 1, making.LABELS)
    making.write_map(tmp_path / "d/Annotations/v/00007.png")
    for masks in (tmp_path / "d", tmp_path / "d/Annotations/v"):
        frames = list(open_source(tmp_path / "v", masks=masks))
        assert [f.detections.labels for f in frames] == [("cup", "desk_lamp"), ()]


@pytest.mark.parametrize("suffix", [".png", ".tif", ".TIFF"])
def test_a_folder_of_maps_of_any_suffix_that_is_read(tmp_path, suffix):
    making.write_images(tmp_path / "v", ["0.jpg"])
    making.write_map(tmp_path / f"m/0{suffix}")
    (frame,) = open_source(tmp_path / "v", masks=tmp_path / "m")
    assert frame.detections.instance_ids.tolist() == [1, 2]


@pytest.mark.parametrize("shown", [(1, 255), (255,)])
def test_void_is_no_instance_unless_there_is_nothing_else(tmp_path, shown):
    """In the first frames 255 is all that there is."""
    making.write_davis(tmp_path, "v", 4)
    for number, there in enumerate(((255,), (255,), shown, (255,))):
        making.write_map(tmp_path / f"Annotations/v/{number:05d}.png", there)
    found = [frame.detections.instance_ids.tolist() for frame in open_source(tmp_path)]
    assert found == ([[255]] * 4 if shown == (255,) else [[], [], [1], []])
    scenes = open_scenes(tmp_path)
    assert scenes.read(*scenes.files).track_id.tolist() == [i for ids in found for i in ids]


def test_what_is_lost_at_the_size_of_the_frame_is_no_instance(tmp_path):
    making.write_davis(tmp_path, "v", 1)
    labels = np.kron(making.instance_map(ids=(1,)), np.ones((4, 4), np.uint8))
    labels[-3, -3] = 2
    (tmp_path / "Annotations/v/00000.png").write_bytes(making.gray_png(labels))
    (frame,) = open_source(tmp_path)
    assert frame.detections.instance_ids.tolist() == [1]


def test_an_instance_255_that_has_a_class_is_one(tmp_path):
    making.write_davis(tmp_path, "v", 1, {"id_to_class": {"1": "cup", "255": "box"}})
    making.write_map(tmp_path / "Annotations/v/00000.png", (1, 255))
    (frame,) = open_source(tmp_path)
    assert frame.detections.labels == ("cup", "box")
    scenes = open_scenes(tmp_path)
    assert scenes.read(*scenes.files).track_id.tolist() == [1, 255]


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_ids_of_a_map_that_repeats_a_pixel(dtype):
    """OpenCV would read past the end of it."""
    for number in (0, 7):
        labels = np.broadcast_to(dtype(number), (480, 640))
        assert instance_ids_in(labels) == [number][: number > 0]
