"""What fixes the shape of the compiled program of REMIND plus, and how much memory that takes.

Beside the capacities that all trackers share; docs/performance.md#crowds.
"""

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

NUMBER = 4  # bytes
# Numbers that are held at once, of the memory and of what a frame needs for the time being.
PAIR_OF_OBJECTS = 9  # six are kept
OF_OBJECT_AND_DETECTION = BANK_SLOTS + 2  # cosines with each kept look, and what is made of them
PAIR_OF_FEATURES = 6  # two scatters, and what three frames add to one
PAIR_OF_DETECTIONS = 12  # each detection with the four tracklets of each slot


def num_tracklets(static: Static) -> int:
    """Tracklets of a frame and all those that may still resume."""
    return (1 + WAITING) * static.num_detections


def white_dim(static: Static) -> int:
    """Directions that looks are compared in."""
    return min(static.feature_dim, COMPARED_DIM)


def count_bytes(static: Static) -> int:
    """Bytes of the memory and of a step, estimated before anything is made; widths are known.

    Grows with objects times objects, objects times detections, and, by little, with detections
    times detections.
    """
    objects, detections, dim = static.num_objects, static.num_detections, static.feature_dim
    per_object = 2 * BANK_SLOTS * (dim + white_dim(static))
    per_detection = 30 * dim + 4 * NUM_WITNESSES * NUM_CANDIDATES**2
    return NUMBER * (
        PAIR_OF_OBJECTS * objects**2
        + per_object * objects
        + OF_OBJECT_AND_DETECTION * objects * detections
        + per_detection * detections
        + PAIR_OF_DETECTIONS * detections**2
        + PAIR_OF_FEATURES * dim**2
    )
