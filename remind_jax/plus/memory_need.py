"""How much memory REMIND plus takes at given capacities (docs/performance.md#crowds)."""

from __future__ import annotations

from remind_jax.plus.static import BANK_SLOTS, NUM_CANDIDATES, NUM_WITNESSES, white_dim
from remind_jax.static import Static

NUMBER = 4  # bytes
# Numbers that are held at once, of the memory and of what a frame needs for the time being.
PAIR_OF_OBJECTS = 9  # six are kept
OF_OBJECT_AND_DETECTION = BANK_SLOTS + 2  # cosines with each kept look, and what is made of them
PAIR_OF_FEATURES = 6  # two scatters, and what three frames add to one
PAIR_OF_DETECTIONS = 12  # each detection with the four tracklets of each slot


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
