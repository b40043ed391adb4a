"""`Static`: everything that fixes the shape of the compiled program. Hashable, never traced."""

from __future__ import annotations

import dataclasses
from typing import Any, Literal

import numpy as np

from remind_jax.settings.ranges import check_fields
from remind_jax.settings.record import setting

MOST_OBJECTS = 32_768
MOST_DETECTIONS = 8192
GROWTH_STEP = 2  # capacities double when they overflow
# Slots for objects per detection slot: each may be open in one frame, and be an object beside a new
# one in the next.
OBJECTS_PER_DETECTION = 2

_MORE = "as relations of all pairs would not fit into memory"
_CAPACITY = "more memory and time, the same results; grows by itself"
# fmt: off


@dataclasses.dataclass(frozen=True)
class NoSwitches:
    """Of a method that has none."""


@dataclasses.dataclass(frozen=True)
class Static:
    """Capacities, and the switches of the method; equal values share one compiled program.

    Capacities never change results: when one overflows, it grows and the frame is repeated. Where
    a method has objects at rest, slots for objects are its working set instead: results may depend
    on them once more objects are known than there are slots.
    """

    num_detections: int = setting(16, "detection slots of a frame; grows", "detections",
        more=_CAPACITY, most=MOST_DETECTIONS, why=_MORE)
    num_objects: int = setting(64,
        "object slots of the memory; grows, or other objects rest (plus)", "objects",
        more=_CAPACITY, most=MOST_OBJECTS, why=_MORE)
    num_pending: int = setting(32, "slots of ambiguous and of provisional tracks each; grows",
        "tracks", more=_CAPACITY, most=8192, why=_MORE)
    feature_dim: int = setting(0, "width of the patch features; 0: taken from the backbone",
        "numbers", more="must be what the backbone gives", least=0)
    num_candidates: int = setting(5, "candidates shown per detection in the decisions",
        "candidates", more="more of them in the outputs; decisions are the same")
    first_object_id: int = setting(0, "id of the first object", "id", more="ids start there",
        least=0, key="memory.start_object_id")

    precision: Literal["float32", "float64"] = setting("float32", "of scores and qualities")
    solver: Literal["host", "jax"] = setting("jax",
        "in-graph twins, or SciPy and NumPy by callbacks")
    switches: Any = NoSwitches()  # of the method: a hashable record of its own

    # fmt: on

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if isinstance(value, np.integer):  # as `ids.max() + 1` gives
                object.__setattr__(self, name, int(value))
        check_fields(self, "static")

    @property
    def scalar(self) -> np.dtype:
        """Type of scores, qualities and thresholds."""
        return np.dtype(self.precision)

    def grow(self, **needed: int) -> Static:
        """Doubles the named capacities until they hold what is needed."""
        grown = {}
        for name, count in needed.items():
            capacity = getattr(self, name)
            while capacity < count:
                capacity *= GROWTH_STEP
            grown[name] = capacity
        return dataclasses.replace(self, **grown)
