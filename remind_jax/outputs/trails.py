"""The ways that objects came, as lines through the centers of their boxes in earlier frames."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.decision import NO_ID
from remind_jax.outputs.drawing import identity_color
from remind_jax.tracks import Tracks

_SUBPIXEL_BITS = 4


def find_trails(tracks: Tracks, earlier: Sequence[Tracks]) -> dict[int, list[list[np.ndarray]]]:
    """Centers of the objects in view through earlier frames, oldest first.

    A way ends where the object was not in the next frame that is given, so that no line leads
    across an absence.

    Args:
      tracks: The frame that is looked at.
      earlier: Frames in order; those that are not before it are left out.

    Returns:
      By object, the pieces of its way; each is a list of centers, column and row in pixels.
    """
    before = [one for one in earlier if one.frame_index < tracks.frame_index]
    pieces: dict[int, list[list[np.ndarray]]] = {i: [] for i in _centers(tracks)}
    last_seen: dict[int, int] = {}
    for number, one in enumerate([*before, tracks]):
        for object_id, center in _centers(one).items():
            if object_id not in pieces:
                continue
            if last_seen.get(object_id) != number - 1:
                pieces[object_id].append([])
            pieces[object_id][-1].append(center)
            last_seen[object_id] = number
    return pieces


def draw_trails(
    canvas: UInt8[np.ndarray, "H W 3"], tracks: Tracks, earlier: Sequence[Tracks]
) -> None:
    """Draws the ways of the objects in view onto a picture, in place."""
    line_px = max(2, round(canvas.shape[0] / 320))
    for object_id, pieces in find_trails(tracks, earlier).items():
        lines = [_fixed_point(piece) for piece in pieces if len(piece) > 1]
        for color, width in (((16, 18, 22), line_px + 2), (identity_color(object_id), line_px)):
            cv2.polylines(canvas, lines, False, color, width, cv2.LINE_AA, _SUBPIXEL_BITS)


def _centers(tracks: Tracks) -> dict[int, Float[np.ndarray, "2"]]:
    """Center of the box of every identity in a frame."""
    centers = (tracks.boxes[:, :2] + tracks.boxes[:, 2:]) / 2
    return {
        int(object_id): center
        for object_id, center in zip(tracks.object_id, centers, strict=True)
        if object_id != NO_ID
    }


def _fixed_point(centers: Sequence[np.ndarray]) -> np.ndarray:
    """Pixels in the units of OpenCV, whose pixel centers are whole numbers."""
    return np.rint((np.array(centers) - 0.5) * (1 << _SUBPIXEL_BITS)).astype(np.int32)
