"""Objects that fly about before the camera, cross, leave, and come back elsewhere."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from remind_jax.synthetic.scene import CameraPath, Placement, Point, Pose, SceneObject

_DEPTHS_M = (1.1, 2.7)  # from the camera
_HEIGHTS_M = (0.5, 1.9)
_MARGIN_RAD = np.radians(8.0)  # beyond the sides of the field of view
_VISIT_FRAMES = (25, 60)
_ABSENCE_FRAMES = (12, 70)
_MOST_TURN_RAD = np.radians(1.5)  # per frame
_MOST_CURVE_M = 0.5  # by which the middle of a way is off the straight line


def set_roaming(
    objects: Sequence[SceneObject], path: CameraPath, share: float, rng: np.random.Generator
) -> list[SceneObject]:
    """Sends a share of the objects of the first room on ways of their own, as long as the tour.

    They cross the field of view that the camera has at their entry, from one side to the other.
    """
    here = [index for index, item in enumerate(objects) if item.placements[0].room == 0]
    chosen = rng.permutation(here)[: round(share * len(here))]
    changed = list(objects)
    for index in sorted(int(i) for i in chosen):
        changed[index] = dataclasses.replace(
            objects[index], placements=tuple(_draw_ways(path, rng))
        )
    return changed


def _draw_ways(path: CameraPath, rng: np.random.Generator) -> list[Placement]:
    """Visits and absences in turn, until the end of the tour."""
    last = path.poses[-1].source_index
    starts = {pose.source_index: pose for pose in path.poses}
    at = int(rng.integers(0, min(_ABSENCE_FRAMES[1], last // 2 + 1)))
    placements: list[Placement] = []
    while at <= last:
        end = at + int(rng.integers(*_VISIT_FRAMES))
        pose = starts[min(starts, key=lambda frame, at=at: abs(frame - at))]
        placements += _draw_way(pose, path.horizontal_fov_rad, at, end, rng)
        at = end + int(rng.integers(*_ABSENCE_FRAMES))
    return placements


def _draw_way(
    pose: Pose, fov_rad: float, start: int, end: int, rng: np.random.Generator
) -> list[Placement]:
    """A bent way across the view of a camera: two straight pieces."""
    side = rng.choice([-1.0, 1.0]) * (fov_rad / 2 + _MARGIN_RAD)
    ends = []
    for angle in (side, -side):
        depth = rng.uniform(*_DEPTHS_M)
        yaw = pose.yaw_rad + angle
        x, y = np.array(pose.position_m[:2]) + depth * np.array([np.cos(yaw), np.sin(yaw)])
        ends.append(np.array([x, y, rng.uniform(*_HEIGHTS_M)]))
    middle = (ends[0] + ends[1]) / 2 + rng.uniform(-1, 1, 3) * _MOST_CURVE_M * (1, 1, 0.6)
    half = (start + end) // 2
    yaw, turn = float(rng.uniform(-0.6, 0.6)), float(rng.uniform(-1, 1) * _MOST_TURN_RAD)
    pieces = []
    for first, last, begin, finish in (
        (ends[0], middle, start, half),
        (middle, ends[1], half, end),
    ):
        step = (last - first) / (finish - begin)
        yaw_now = yaw + turn * (begin - start)
        pieces.append(Placement(_as_point(first), yaw_now, 0, begin, finish, _as_point(step), turn))
    return pieces


def _as_point(values: Float[np.ndarray, "3"]) -> Point:
    x, y, z = (float(value) for value in values)
    return (x, y, z)
