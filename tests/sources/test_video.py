import multiprocessing
import struct
import warnings

import av
import numpy as np
import pytest

from remind_jax.errors import SourceError
from remind_jax.sources import Sampling, open_source
from tests.sources import making

COLOR_SLACK = 14  # lossy codecs and the YUV 4:2:0 color space change colors by a few steps


@pytest.mark.parametrize(
    ("name", "codec"),
    [
        ("a.mp4", "libx264"),
        ("a.mov", "libx264"),
        ("a.mkv", "libx264"),
        ("a.webm", "libvpx-vp9"),
        ("a.avi", "mpeg4"),
    ],
)
def test_every_frame_once_with_its_time_in_rgb(tmp_path, name, codec):
    making.write_video(tmp_path / name, 12, codec)
    source = open_source(tmp_path / name)
    frames = list(source)
    assert len(frames) == source.num_frames == 12
    assert source.fps == 10
    assert [f.index for f in frames] == [f.source_index for f in frames] == list(range(12))
    np.testing.assert_allclose([f.time_s for f in frames], np.arange(12) / 10, atol=1e-3)
    for frame in frames:
        assert frame.image.dtype == np.uint8
        edge = 2 * frame.index + 2
        red = frame.image[:, edge + 3 :]
        wanted = np.broadcast_to((200, 30, 30), red.shape)
        np.testing.assert_allclose(red, wanted, atol=COLOR_SLACK)
    assert source.skipped == []


def test_sampling_keeps_the_clock_of_the_source(tmp_path):
    making.write_video(tmp_path / "a.mp4")
    frames = list(open_source(tmp_path / "a.mp4", sampling=Sampling(fps=5, start=3, end=9)))
    assert [f.source_index for f in frames] == [3, 5, 7]
    assert [f.index for f in frames] == [0, 1, 2]
    np.testing.assert_allclose([f.time_s for f in frames], [0.3, 0.5, 0.7], atol=1e-3)


def test_a_forked_process_reads_videos_as_well(tmp_path):
    """As workers of a data loader do, whose parent has looked at a first frame."""
    making.write_video(tmp_path / "a.mp4")
    assert list(open_source(tmp_path / "a.mp4"))
    worker = multiprocessing.get_context("fork").Process(
        target=lambda: list(open_source(tmp_path / "a.mp4"))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of JAX and Python about forks
        worker.start()
    worker.join(timeout=60)
    worker.kill()
    assert worker.exitcode == 0


def test_truncated_video_keeps_what_was_decoded(tmp_path):
    making.write_video(tmp_path / "a.mp4", movflags="faststart")
    whole = (tmp_path / "a.mp4").read_bytes()
    (tmp_path / "cut.mp4").write_bytes(
        whole[: len(whole) - (len(whole) - whole.find(b"mdat")) // 5]
    )
    source = open_source(tmp_path / "cut.mp4")
    frames = list(source)
    assert 0 < len(frames) < 20
    assert len(frames) + sum(s.count for s in source.skipped) == 20
    assert "ends early" in source.skipped[-1].reason


@pytest.mark.parametrize("pts", [[0, 1, 5, 6, 20, 21], [50, 51, 52, 53]], ids=["vfr", "late"])
def test_a_video_of_few_frames_for_its_length_is_whole(tmp_path, pts):
    making.write_video(tmp_path / "a.mkv", len(pts), times=pts)
    source = open_source(tmp_path / "a.mkv")
    assert [frame.time_s for frame in source] == pytest.approx([(p - pts[0]) / 10 for p in pts])
    assert source.skipped == []


def test_missing_frames_of_a_cut_video_are_counted_by_the_rate_of_those_that_are_there(tmp_path):
    making.write_video(tmp_path / "a.mkv", 60, times=[10 * (i // 2) + i % 2 for i in range(60)])
    whole = (tmp_path / "a.mkv").read_bytes()
    (tmp_path / "cut.mkv").write_bytes(whole[: len(whole) // 2])
    source = open_source(tmp_path / "cut.mkv")
    seen = len(list(source))
    assert seen < 50
    assert sum(s.count for s in source.skipped) == pytest.approx(60 - seen, abs=3)


def test_damaged_middle_is_reported(tmp_path):
    making.write_video(tmp_path / "a.mp4", 40)
    data = bytearray((tmp_path / "a.mp4").read_bytes())
    middle = data.find(b"mdat") + (data.find(b"moov") - data.find(b"mdat")) // 2
    data[middle : middle + 60] = bytes(60)
    (tmp_path / "a.mp4").write_bytes(data)
    source = open_source(tmp_path / "a.mp4")
    frames = list(source)
    assert 20 < len(frames) < 40
    assert len(frames) + sum(s.count for s in source.skipped) == 40
    assert frames[-1].source_index == 39


@pytest.mark.parametrize("content", [b"", b"not a video", None], ids=["empty", "text", "no index"])
def test_unreadable_video_is_one_sentence(tmp_path, content):
    making.write_video(tmp_path / "a.mp4")
    whole = (tmp_path / "a.mp4").read_bytes()
    cut = whole[: whole.find(b"moov") - 4]  # its index comes last
    (tmp_path / "a.mp4").write_bytes(cut if content is None else content)
    with pytest.raises(SourceError, match=r"a\.mp4' cannot be opened as a video"):
        open_source(tmp_path / "a.mp4")


def test_video_without_one_readable_frame(tmp_path):
    making.write_video(tmp_path / "a.mp4")
    data = bytearray((tmp_path / "a.mp4").read_bytes())
    start, end = data.find(b"mdat") + 4, data.find(b"moov") - 4
    data[start:end] = bytes(end - start)
    (tmp_path / "a.mp4").write_bytes(data)
    with pytest.raises(SourceError, match="no frame of the video"):
        open_source(tmp_path / "a.mp4")


def test_sound_is_no_video(tmp_path):

    with av.open(str(tmp_path / "a.wav"), "w") as container:
        stream = container.add_stream("pcm_s16le", rate=8000)
        sound = av.AudioFrame.from_ndarray(np.zeros((1, 800), np.int16), "s16", "mono")
        sound.sample_rate = 8000
        container.mux(stream.encode(sound))  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(SourceError, match="no video track"):
        open_source(tmp_path / "a.wav")


@pytest.mark.parametrize(
    ("matrix", "upright"),
    [
        ((0, 1, -1, 0), lambda image: np.rot90(image, -1)),
        ((0, -1, 1, 0), lambda image: np.rot90(image)),
        ((-1, 0, 0, -1), lambda image: np.rot90(image, 2)),
        ((-1, 0, 0, 1), lambda image: image[:, ::-1]),
        ((1, 0, 0, -1), lambda image: image[::-1]),
        ((0, 1, 1, 0), lambda image: image.swapaxes(0, 1)),
    ],
)
def test_telephone_video_is_turned_upright_and_mirrored(tmp_path, matrix, upright):
    """Sets the display matrix in the track header, of which the first is a turn clockwise."""
    making.write_video(tmp_path / "a.mp4", 3)
    flat = next(iter(open_source(tmp_path / "a.mp4"))).image
    data = bytearray((tmp_path / "a.mp4").read_bytes())
    at = data.find(b"tkhd") + 44
    one = 1 << 16
    assert struct.unpack(">9I", data[at : at + 36]) == (one, 0, 0, 0, one, 0, 0, 0, 1 << 30)
    a, b, c, d = (one * value for value in matrix)
    data[at : at + 36] = struct.pack(">9i", a, b, 0, c, d, 0, 0, 0, 1 << 30)
    (tmp_path / "a.mp4").write_bytes(data)
    turned = next(iter(open_source(tmp_path / "a.mp4"))).image
    np.testing.assert_array_equal(turned, upright(flat))
