"""`PlusStatic`: what fixes the shape of the compiled program of REMIND plus."""

from __future__ import annotations

import dataclasses

from remind_jax.config.static import GROWTH_STEP

MISSED_FRAMES = 3  # a tracklet survives this many frames without a detection


@dataclasses.dataclass(frozen=True)
class PlusStatic:
    """Capacities; equal values share one compiled program.

    Capacities of detections and objects never change results: they grow and the frame is repeated.
    """

    num_detections: int = 16  # detection slots of a frame; grows
    num_objects: int = 64  # object slots of the memory; grows
    feature_dim: int = 0  # width of the patch features; 0: taken from the backbone
    compared_dim: int = 64  # looks are compared in at most this many principal directions
    bank_slots: int = 8  # remembered looks per object
    num_candidates: int = 8  # objects that an open tracklet is compared with at length
    num_rounds: int = 5  # of mean field

    @property
    def num_tracklets(self) -> int:
        """Those of this frame and all that may still resume."""
        return (1 + MISSED_FRAMES) * self.num_detections

    @property
    def white_dim(self) -> int:
        """Directions that looks are compared in."""
        return min(self.feature_dim, self.compared_dim)

    def grow(self, **needed: int) -> PlusStatic:
        """Doubles the named capacities until they hold what is needed."""
        grown = {}
        for name, count in needed.items():
            capacity = getattr(self, name)
            while capacity < count:
                capacity *= GROWTH_STEP
            grown[name] = capacity
        return dataclasses.replace(self, **grown)
