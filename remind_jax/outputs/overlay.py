"""Pictures with every detection tinted in the color of its identity, and `overlay.mp4` of them."""

from __future__ import annotations

import contextlib
import dataclasses
import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.error import FFmpegError
from jaxtyping import Int, UInt8

from remind_jax.crops import Crops, nearest_places
from remind_jax.decision import NO_ID, Outcome
from remind_jax.errors import SourceError
from remind_jax.files import writing
from remind_jax.frame import UNTIMED_FPS, Rle, frame_of
from remind_jax.masks.run_length import cut_masks, encode_masks
from remind_jax.outputs import drawing
from remind_jax.tracks import Tracks

OVERLAY_NAME = "overlay.mp4"
_TINT = 0.42
# Of a frame of the video; larger ones are drawn smaller: what an encoder takes goes by the pixels.
MAX_PIXELS = 4096 * 2304
# A seek decodes from the last key frame on: one per second keeps clicks in the report quick.
_KEY_FRAME_EVERY_S = 1.0


_Rectangle = tuple[int, int, int, int]  # left, top, right, bottom


def draw(image: Any, tracks: Tracks) -> UInt8[np.ndarray, "H W 3"]:
    """A picture of a frame with masks, outlines and names.

    Identities have their own color, the same in every frame and output; undecided detections are
    white with their candidates.

    Raises:
      SourceError: If the image is none or has another size than the frame, or tracks are none.
    """
    if not isinstance(tracks, Tracks):
        raise SourceError(
            f"tracks are of type {type(tracks).__name__}; give what 'Tracker.update' returned"
        )
    if image is not None:
        image = frame_of(image, 0).image
        if image.shape[:2] != tracks.frame_size:
            raise SourceError(
                f"the image is {image.shape[1]}x{image.shape[0]}, its tracks are of a frame of "
                f"{tracks.frame_size[1]}x{tracks.frame_size[0]} (width x height); give the frame"
            )
    return draw_overlay(image, tracks)


def draw_overlay(
    image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks
) -> UInt8[np.ndarray, "H W 3"]:
    """As `draw`, of an image of any size, gray without one; what is discarded is outlined only."""
    height, width = tracks.frame_size
    if image is None:
        canvas = np.full((height, width, 3), drawing.NO_IMAGE_GRAY, np.uint8)
    else:
        canvas = drawing.fit_image(image, height, width).copy()
    size_px = int(np.clip(round(height / 34), 11, 40))
    largest_first = np.argsort(-tracks.areas, kind="stable")
    for row in largest_first:
        color, thin = detection_color(tracks, row), _is_discarded(tracks, row)
        _draw_mask(canvas, tracks.rles[row], color, thin)
    placed: list[_Rectangle] = []
    for row in largest_first[::-1]:
        if not _is_discarded(tracks, row):
            _draw_label(canvas, tracks, int(row), size_px, placed)
    return canvas


def draw_for_video(
    image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks
) -> UInt8[np.ndarray, "h w 3"]:
    """As `draw_overlay`, at most `MAX_PIXELS` large."""
    height, width = tracks.frame_size
    if height * width <= MAX_PIXELS:
        return draw_overlay(image, tracks)
    scale = math.sqrt(MAX_PIXELS / (height * width))
    size = max(1, int(scale * height)), max(1, int(scale * width))
    if image is not None:
        image = cv2.resize(image, size[::-1], interpolation=cv2.INTER_AREA)
    return draw_overlay(image, _smaller(tracks, size))


def _smaller(tracks: Tracks, size: tuple[int, int]) -> Tracks:
    """The tracks as if the frame had this size."""
    (height, width), (rows, columns) = tracks.frame_size, size
    masks = cut_masks(tracks.rles, tracks.frame_size)
    masks = masks.sampled(nearest_places(height, rows), nearest_places(width, columns))
    factors = np.array([columns / width, rows / height] * 2, np.float32)
    return dataclasses.replace(
        tracks, frame_size=size, boxes=tracks.boxes * factors, rles=encode_masks(masks)
    )


def detection_color(tracks: Tracks, row: int) -> drawing.Color:
    """Color of a detection: its identity's, white if ambiguous, light gray if provisional."""
    if tracks.object_id[row] != NO_ID:
        return drawing.identity_color(int(tracks.object_id[row]))
    if _is_discarded(tracks, row):
        return drawing.DISCARDED
    return drawing.AMBIGUOUS if tracks.outcome[row] == Outcome.AMBIGUOUS else drawing.PROVISIONAL


def _is_discarded(tracks: Tracks, row: int) -> bool:
    return tracks.object_id[row] == NO_ID and tracks.outcome[row] in (
        Outcome.EMPTY,
        Outcome.UNASSIGNED,
        Outcome.DROPPED,
    )


def _draw_mask(canvas: np.ndarray, rle: Rle, ink: drawing.Color, thin: bool) -> None:
    """Tints the mask unless it is only to be outlined, and draws its outline with a dark rim."""
    crops = cut_masks([rle], (canvas.shape[0], canvas.shape[1]))
    (left, top), mask = crops.corners[0], crops.windows[0]
    height, width = mask.shape
    if not thin and mask.size:
        region = canvas[top : top + height, left : left + width]
        tinted = (region * (1 - _TINT) + np.multiply(ink, _TINT)).astype(np.uint8)
        np.copyto(region, tinted, where=mask[..., None])
    contours = find_contours(crops)
    line_px = 1 if thin else max(2, round(canvas.shape[0] / 320))
    if not thin:
        cv2.drawContours(canvas, contours, -1, (16, 18, 22), line_px + 2, cv2.LINE_AA)
    cv2.drawContours(canvas, contours, -1, ink, line_px, cv2.LINE_AA)


def find_contours(masks: Crops) -> list[Int[np.ndarray, "P 1 2"]]:
    """The outline of each part of one mask, as corners (column, row in pixels)."""
    (corner,), (window,) = masks.corners, masks.windows
    if not window.size:
        return []
    mode, method = cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    found, _ = cv2.findContours(window.view(np.uint8), mode, method, offset=corner)
    return list(found)


def _draw_label(
    canvas: np.ndarray, tracks: Tracks, row: int, size_px: int, placed: list[_Rectangle]
) -> None:
    """Writes the name on a filled box above the detection, out of the way of earlier labels."""
    text = tracks.display_name(row)
    pad = max(2, size_px // 4)
    box_height = size_px + 2 * pad
    box_width = drawing.text_width(text, size_px) + 2 * pad
    spot = _free_spot(canvas.shape[:2], tracks.boxes[row], box_width, box_height, placed)
    placed.append(spot)
    left, top, right, bottom = spot
    color = detection_color(tracks, row)
    rim = (left - 1, top - 1), (right, bottom)
    cv2.rectangle(canvas, *rim, (16, 18, 22), 1, cv2.LINE_AA)
    canvas[top:bottom, left:right] = color
    baseline = top + pad + round(0.86 * size_px)
    drawing.put_text(canvas, text, left + pad, baseline, size_px, drawing.ink_on(color))


def _free_spot(
    frame_size: tuple[int, int], box: np.ndarray, width: int, height: int, placed: list[_Rectangle]
) -> _Rectangle:
    """Where a label goes: above the box, else inside, else below, else down the column."""
    frame_height, frame_width = frame_size
    left = int(np.clip(box[0], 0, max(frame_width - width, 0)))
    lowest = max(frame_height - height, 0)
    tops = [box[1] - height, box[1], box[3]]
    tops += [box[1] + step * (height + 1) for step in range(1, 5)]
    spots = [
        (left, top, min(left + width, frame_width), min(top + height, frame_height))
        for top in (int(np.clip(t, 0, lowest)) for t in tops)
    ]
    free = (spot for spot in spots if not any(_overlap(spot, other) for other in placed))
    return next(free, spots[0])


def _overlap(one: _Rectangle, other: _Rectangle) -> bool:
    across = max(one[0], other[0]) < min(one[2], other[2])
    return across and max(one[1], other[1]) < min(one[3], other[3])


def is_playable(path: Path) -> bool:
    """Whether a video is there, a file, and was closed properly."""
    if not path.is_file():  # a pipe would be waited for
        return False
    try:
        with av.open(str(path)) as container:
            return bool(container.streams.video)
    except (OSError, FFmpegError):
        return False


def shown_fps(fps: float) -> float:
    """The rate of the video: that of the run, if players can show it frame by frame."""
    return fps if 1 <= fps <= 240 else UNTIMED_FPS


class OverlayVideo(contextlib.AbstractContextManager):
    """Writes an H.264 video frame by frame; browsers play it and seek in it.

    All frames get the size of the first one, made even as yuv420p needs. A video that was there is
    replaced when this one is closed, unless an error ends it.
    """

    def __init__(self, path: Path, fps: float) -> None:
        self._path, self._partial = path, path.with_name(f"{path.name}.part")
        self._rate = Fraction(shown_fps(fps)).limit_denominator(1001)
        options = {"movflags": "+faststart"}
        with writing(path, FFmpegError):
            self._container = av.open(str(self._partial), "w", format="mp4", options=options)
        self._stream: Any = None
        self._size = (0, 0)

    def add(self, image: UInt8[np.ndarray, "H W 3"]) -> None:
        """Appends one RGB frame."""
        with writing(self._path, FFmpegError):
            stream = self._stream or self._start(image.shape[0], image.shape[1])
            image = drawing.fit_image(image, *self._size)
            height, width = self._size
            even = np.pad(image, ((0, height % 2), (0, width % 2), (0, 0)), mode="edge")
            frame = av.VideoFrame.from_ndarray(even, format="rgb24")
            for packet in stream.encode(frame):
                self._container.mux(packet)

    def close(self) -> None:
        """Writes what the encoder still holds and closes the file; it plays afterwards."""
        with writing(self._path, FFmpegError), contextlib.ExitStack() as ending:
            # Where the disk is full, that makes room for what says how far the run came.
            ending.callback(self._partial.unlink, missing_ok=True)
            try:
                if self._stream is not None:
                    for packet in self._stream.encode(None):
                        self._container.mux(packet)
            finally:
                self._container.close()
            if self._stream is None:
                self._path.unlink(missing_ok=True)
            elif self._partial.exists():
                self._partial.replace(self._path)

    def _start(self, height: int, width: int) -> Any:
        key_frame_every = max(1, round(_KEY_FRAME_EVERY_S * float(self._rate)))
        stream: Any = self._container.add_stream("libx264", rate=self._rate)
        stream.width, stream.height = width + width % 2, height + height % 2
        stream.pix_fmt = "yuv420p"
        stream.options = {"crf": "21", "preset": "veryfast", "g": str(key_frame_every)}
        self._stream, self._size = stream, (height, width)
        return stream

    def __exit__(self, kind: type[BaseException] | None, *raised: object) -> None:
        if kind is None:
            self.close()
        else:
            self._container.close()
            self._partial.unlink(missing_ok=True)
