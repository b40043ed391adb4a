import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.formats.pictures import decode_image, natural_key
from remind_jax.sources import Sampling, open_source
from remind_jax.sources.file_tree import last_number
from remind_jax.sources.source import UnreadableFrame
from tests.sources import making


@pytest.mark.parametrize("suffix", ["jpg", "png", "bmp", "webp", "tif"])
def test_rgb_in_natural_order(tmp_path, suffix):
    making.write_images(tmp_path / "v", [f"frame_{i}.{suffix}" for i in (8, 9, 10, 11)])
    frames = list(open_source(tmp_path / "v", image_fps=10))
    assert [f.name for f in frames] == [f"frame_{i}.{suffix}" for i in (8, 9, 10, 11)]
    assert [f.time_s for f in frames] == [0.0, 0.1, 0.2, pytest.approx(0.3)]
    for index, frame in enumerate(frames):
        assert frame.detections is None
        # JPEG and WebP change colors by a few steps, more beside the edge of the bar.
        wanted = making.picture(index)[:, 2 * index + 12 :].astype(int)
        assert np.abs(frame.image[:, 2 * index + 12 :] - wanted).max() <= 6


def test_times_of_pictures_stand_in_a_file_beside_them(tmp_path):
    making.write_images(tmp_path, ["0.png", "1.png", "2.png"])
    assert [frame.is_timed for frame in open_source(tmp_path)] == [False] * 3
    (tmp_path / "times.txt").write_text("0.5\n0.75\n1.5\n0.1\n")  # of one that was not written
    found = [(frame.time_s, frame.is_timed) for frame in open_source(tmp_path)]
    assert found == [(0.5, True), (0.75, True), (1.5, True)]
    assert [frame.time_s for frame in open_source(tmp_path / "1.png")] == [0.75]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("0\n1\n", "2 lines, its folder 3 pictures"),
        ("0\n1\n2\n3\n4\n", "5 lines, its folder 3 pictures"),
        ("0\nnan\n2\n", "line 2 .* 'nan'"),
        ("0 0.0\n1 0.5\n2 1.0\n", "line 1 .* '0 0.0'"),
        ("0\n2\n1\n", "line 3 .* before"),
    ],
    ids=["too few", "too many", "no number", "columns", "backward"],
)
def test_times_that_are_not_those_of_the_pictures_are_refused(tmp_path, text, said):
    making.write_images(tmp_path, ["0.png", "1.png", "2.png"])
    (tmp_path / "times.txt").write_text(text)
    with pytest.raises(SourceError, match=said):
        open_source(tmp_path)


def test_corrupt_image_is_skipped_and_reported(tmp_path):
    making.write_images(tmp_path, [f"{i}.jpg" for i in range(5)])
    (tmp_path / "2.jpg").write_bytes(b"\xff\xd8 no image")
    (tmp_path / "3.jpg").write_bytes(b"")
    source = open_source(tmp_path)
    found = [(f.index, f.source_index, f.name) for f in source]
    assert found == [(0, 0, "0.jpg"), (1, 1, "1.jpg"), (2, 4, "4.jpg")]
    assert [s.name for s in source.skipped] == ["2.jpg", "3.jpg"]
    assert len(list(source)) == 3
    assert len(source.skipped) == 2, "a second pass starts to count anew"


@pytest.mark.parametrize("suffix", ["jpg", "png", "bmp", "webp", "tif"])
@pytest.mark.parametrize("kept", [0.3, 0.9])
def test_truncated_image_is_skipped(tmp_path, suffix, kept):
    noise = np.random.default_rng(0).integers(0, 255, (*making.SIZE, 3), np.uint8)
    for name in ("0", "1"):
        making.write_image(tmp_path / f"{name}.{suffix}", noise)
    whole = (tmp_path / f"1.{suffix}").read_bytes()
    (tmp_path / f"1.{suffix}").write_bytes(whole[: int(len(whole) * kept)])
    source = open_source(tmp_path)
    assert len(list(source)) == 1
    assert source.skipped[0].name == f"1.{suffix}"


def test_end_of_a_preview_is_not_the_end_of_the_image():
    whole = making.jpg(0)
    preview = b"\xff\xe1" + (len(whole) + 2).to_bytes(2, "big") + whole
    with_preview = whole[:2] + preview + whole[2:]
    np.testing.assert_array_equal(decode_image(with_preview), decode_image(whole))
    np.testing.assert_array_equal(decode_image(whole + b"maker's notes"), decode_image(whole))
    with pytest.raises(UnreadableFrame, match="cut off"):
        decode_image(with_preview[:-2])


def test_telephone_image_is_turned_upright(tmp_path):
    """EXIF orientation 6: the first row of the picture is its right side."""
    flat = making.jpg(0)
    entry = b"\x12\x01\x03\x00\x01\x00\x00\x00\x06\x00\x00\x00"
    exif = b"Exif\0\0II*\0\x08\0\0\0\x01\x00" + entry + bytes(4)
    turned = flat[:2] + b"\xff\xe1" + (len(exif) + 2).to_bytes(2, "big") + exif + flat[2:]
    np.testing.assert_array_equal(decode_image(turned), np.rot90(decode_image(flat), -1))


def test_changing_size_is_skipped_and_reported(tmp_path):
    making.write_images(tmp_path, ["0.png", "1.png", "3.png"])
    making.write_image(tmp_path / "2.png", making.picture(2, (20, 24)))
    source = open_source(tmp_path)
    assert [f.name for f in source] == ["0.png", "1.png", "3.png"]
    (skipped,) = source.skipped
    assert skipped.name == "2.png"
    assert "24x20" in skipped.reason
    assert "48x32" in skipped.reason
    allowing = open_source(tmp_path, allow_size_change=True)
    assert [f.size for f in allowing] == [(32, 48), (32, 48), (20, 24), (32, 48)]


def test_missing_folder_suggests_the_nearest(tmp_path):
    (tmp_path / "kitchen").mkdir()
    with pytest.raises(SourceError, match="did you mean 'kitchen'"):
        open_source(tmp_path / "kitchn")


def test_hidden_and_other_files_are_no_frames(tmp_path):
    making.write_images(tmp_path, ["0.jpg", "._0.jpg"])
    (tmp_path / "notes.txt").write_text("hello")
    assert [f.name for f in open_source(tmp_path)] == ["0.jpg"]


def test_pictures_of_other_kinds_are_told(tmp_path):
    making.write_image(tmp_path / "0.png", making.picture(0))
    for name in ("1.HEIC", "2.heic", "3.dng"):
        (tmp_path / name).touch()
    source = open_source(tmp_path)
    assert len(list(source)) == 1
    (skipped,) = source.skipped
    assert (skipped.name, skipped.count) == ("1.HEIC", 3)
    assert skipped.reason.startswith("pictures of the kind .HEIC are not read; convert them to")


def test_unchosen_images_are_not_read(tmp_path):
    making.write_images(tmp_path, [f"{i}.jpg" for i in range(4)])
    (tmp_path / "1.jpg").write_bytes(b"damaged, but not asked for")
    source = open_source(tmp_path, sampling=Sampling(stride=2))
    assert [f.source_index for f in source] == [0, 2]
    assert source.num_frames == 2
    assert source.fps == 5.0
    assert source.skipped == []


def test_numbers_in_names():
    names = ["b1", "a10", "a2", "A1", "a", "10", "9"]
    assert sorted(names, key=natural_key) == ["9", "10", "a", "A1", "a2", "a10", "b1"]
    names = ["frame_000610.png", "DSC01752.JPG", "a/b7.jpg", "x.mp4"]
    assert [last_number(name) for name in names] == [610, 1752, 7, None]
