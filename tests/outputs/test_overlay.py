import errno
import os
from pathlib import Path

import av
import numpy as np
import pytest

import remind_jax as rj
from remind_jax.decision import Outcome
from remind_jax.errors import OutputError, SourceError
from remind_jax.outputs import overlay
from remind_jax.outputs.drawing import identity_color
from remind_jax.outputs.overlay import OverlayVideo, draw_for_video, draw_overlay, is_playable
from remind_jax.tracks import Tracks
from tests.outputs.fake_run import make_tracks


def one_square(**row) -> Tracks:
    mask = np.zeros((1, 200, 200), bool)
    mask[0, 80:160, 40:160] = True
    return make_tracks(0, mask, [row])


def read_video(path):
    with av.open(str(path)) as container:
        stream = container.streams.video[0]
        frames = [frame.to_ndarray(format="rgb24") for frame in container.decode(video=0)]
        return frames, stream.codec_context.name, stream.codec_context.pix_fmt, stream.average_rate


def test_masks_are_tinted_towards_the_color_of_the_identity():
    tracks = one_square(object_id=4)
    image = np.full((200, 200, 3), 100, np.uint8)
    drawn = draw_overlay(image, tracks)
    inside = drawn[120, 100].astype(int)
    color = np.array(identity_color(4))
    assert (np.sign(inside - 100) == np.sign(color - 100)).all()
    assert (image == 100).all()  # the input is not written to
    assert (drawn[180:, :] == 100).all()


@pytest.mark.parametrize("outcome", [Outcome.AMBIGUOUS, Outcome.PROVISIONAL_NEW])
def test_undecided_detections_are_colorless(outcome):
    tracks = one_square(object_id=-1, outcome=outcome, candidates=[(1, 0.8), (2, 0.7)])
    drawn = draw_overlay(np.full((200, 200, 3), 100, np.uint8), tracks).astype(int)
    spread = drawn.max(-1) - drawn.min(-1)
    assert spread.max() <= 12  # the palette's grays lean to blue by at most that much
    assert drawn[120, 100].min() > 130


def test_discarded_detections_are_only_outlined():
    tracks = one_square(object_id=-1, outcome=Outcome.DROPPED)
    drawn = draw_overlay(np.full((200, 200, 3), 60, np.uint8), tracks)
    assert (drawn[100:140, 60:140] == 60).all()
    assert (drawn[80, 60:140] != 60).all()
    assert (drawn[:78] == 60).all()  # no label


@pytest.mark.parametrize("image", [None, np.full((200, 200, 3), 100, np.uint8)])
def test_a_large_frame_is_drawn_smaller_in_videos(image, monkeypatch):
    tracks = one_square(object_id=4)
    np.testing.assert_array_equal(draw_for_video(image, tracks), draw_overlay(image, tracks))
    monkeypatch.setattr(overlay, "MAX_PIXELS", 5000)
    drawn = draw_for_video(image, tracks).astype(int)
    assert drawn.shape == (70, 70, 3)
    ground, color = drawn[65, 65], np.array(identity_color(4))
    assert (np.sign(drawn[40, 35] - ground) == np.sign(color - ground)).all()
    assert (drawn[63:] == ground).all()


@pytest.mark.parametrize("size", [(4, 4), (1, 50), (60, 3)])
def test_tiny_frames_and_masks_at_the_rim_are_drawn(size):
    masks = np.zeros((3, *size), bool)
    masks[0] = True
    masks[1, -1, -1] = True  # masks[2] stays empty
    rows = [{"object_id": i} for i in range(3)]
    assert draw_overlay(None, make_tracks(0, masks, rows)).shape == (*size, 3)


def test_labels_do_not_hide_each_other():
    masks = np.zeros((2, 120, 300), bool)
    masks[:, 60:100, 50:90] = True
    both = draw_overlay(None, make_tracks(0, masks, [{"object_id": 0}, {"object_id": 1}]))
    for object_id in (0, 1):
        # The box of a label is filled with the plain color; outlines have far fewer pixels.
        assert (both == identity_color(object_id)).all(-1).sum() > 250


def test_video_is_h264_that_browsers_play(tmp_path):
    path = tmp_path / "overlay.mp4"
    shades = [20, 120, 220]
    with OverlayVideo(path, 7.5) as video:
        for shade in shades:
            video.add(np.full((49, 63, 3), shade, np.uint8))
        video.add(np.full((96, 80, 3), 120, np.uint8))  # of another size: it is fitted
    frames, codec, pixels, rate = read_video(path)
    assert (codec, pixels) == ("h264", "yuv420p")
    assert float(rate or 0) == 7.5
    assert [frame.shape for frame in frames] == [(50, 64, 3)] * 4
    # H.264 is lossy; a flat frame keeps its shade within a few levels.
    np.testing.assert_allclose([frame.mean() for frame in frames], [*shades, 120], atol=4)
    content = path.read_bytes()
    assert content.index(b"moov") < content.index(b"mdat")  # plays before it is loaded whole


def test_a_broken_video_is_not_playable(tmp_path):
    path = tmp_path / "overlay.mp4"
    assert not is_playable(path)
    path.write_bytes(b"\0" * 100)
    assert not is_playable(path)


def test_a_video_that_cannot_be_written_is_named(tmp_path):
    with (
        pytest.raises(OutputError, match=r"cannot write '.*overlay\.mp4': No such file"),
        OverlayVideo(tmp_path / "none" / "overlay.mp4", 10) as video,
    ):
        video.add(np.zeros((48, 64, 3), np.uint8))


def test_a_video_that_cannot_be_ended_gives_its_room_back(tmp_path, monkeypatch):
    video = OverlayVideo(tmp_path / "overlay.mp4", 10)
    video.add(np.zeros((48, 64, 3), np.uint8))

    def fail(self, target):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "replace", fail)
    with pytest.raises(OutputError, match="No space left"):
        video.close()
    assert not [*tmp_path.iterdir()]


IMAGE = np.full((200, 200, 3), 100, np.uint8)


@pytest.mark.parametrize(
    ("call", "sentence"),
    [
        (
            lambda: rj.draw(IMAGE[:60], one_square(object_id=3)),
            "image is 200x60, its tracks .* 200x200",
        ),
        (lambda: rj.draw(IMAGE / 255, one_square(object_id=3)), "the frame is float64"),
        (lambda: rj.draw("a", one_square(object_id=3)), "the frame is"),
        (lambda: rj.draw(IMAGE, None), "tracks are of type NoneType"),
    ],
)
def test_other_things_are_refused(call, sentence):
    with pytest.raises(SourceError, match=sentence):
        call()
