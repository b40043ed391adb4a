"""What fixes the shape of the compiled program of REMIND plus, beside the shared capacities."""

from __future__ import annotations

from remind_jax.static import Static

WAITING = 3  # tracklets that may wait for one, per detection slot; the latest of them
COMPARED_DIM = 64  # looks are compared in at most this many main directions
BANK_SLOTS = 16  # remembered looks per object
NUM_CANDIDATES = 8  # objects that an open tracklet is compared with at length
NAME_ROWS = 96  # rows of what is learned of confused class names; classes beyond share rows
CLASS_ROWS = 32  # rows of what is learned class by class; classes beyond share rows
REFRESH_FRAMES = 3  # the whitening is renewed every so many frames
OBJECTS_BLOCK = 8  # object slots that are worked on at once
LOOKS_BLOCK = 16  # looks that are whitened at once
NUM_WITNESSES = 64  # other detections that one is weighed together with, the nearest of a crowd


def num_tracklets(static: Static) -> int:
    """Tracklets of a frame and all those that may still resume."""
    return (1 + WAITING) * static.num_detections


def white_dim(static: Static) -> int:
    """Directions that looks are compared in."""
    return min(static.feature_dim, COMPARED_DIM)
