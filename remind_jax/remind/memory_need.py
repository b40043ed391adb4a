"""How much memory the paper's tracker takes at given capacities (docs/performance.md#crowds)."""

from __future__ import annotations

from remind_jax.static import Static

NUMBER = 4  # bytes
BESIDE = 20  # numbers that are kept of a prototype beside its embedding
TRIPLE_OF_OBJECTS = 2  # numbers: which of two objects is nearer to a third, and by how much
PAIR_OF_OBJECTS = 30  # numbers: distances and company
OF_PROTOTYPE_AND_DETECTION = 3  # numbers that are held at once to compare them
OF_DETECTION = 10_000  # numbers


def count_bytes(static: Static) -> int:
    """Bytes of the memory and of a step, estimated before anything is made; widths are known.

    Grows with the third power of the objects, and with objects times detections.
    """
    objects, detections = static.num_objects, static.num_detections
    slots = objects + static.num_pending
    banks = [static.appearance_slots] * 2 + [static.part_slots] * len(static.part_channels)
    banks += [static.inner_ring_slots, static.outer_ring_slots]
    if static.ring_prototypes:
        banks += [static.inner_prototype_slots, static.outer_prototype_slots]
    prototypes = sum(work + stable for work, stable in banks)
    return NUMBER * (
        TRIPLE_OF_OBJECTS * objects**3
        + PAIR_OF_OBJECTS * objects**2
        + (static.feature_dim + BESIDE) * prototypes * slots
        + OF_PROTOTYPE_AND_DETECTION * prototypes * objects * detections
        + OF_DETECTION * detections
    )
