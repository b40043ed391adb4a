"""Light on every surface, once per arrangement of the world: all is matt and stands still.

Two channels: what a lamp at full level gives and what a window gives.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.synthetic.scene import Room
from remind_jax.synthetic.surfaces import Part, Surface, turn

_AMBIENT_REACH_M = 0.35
_WINDOW_GAIN = 2.2
_AMBIENT_DIRECTIONS = np.array(
    [[0, 0, 0], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1]], float
)
_LAMP_SPREAD_M = np.array([[0.12, 0, 0], [-0.06, 0.1, 0], [-0.06, -0.1, 0]])


@dataclasses.dataclass(frozen=True, eq=False)
class _Texels:
    """Points of all light images of a room."""

    position_m: Float[np.ndarray, "M 3"]
    normal: Float[np.ndarray, "M 3"]
    part: Int[np.ndarray, "M"]

    def select(self, rows: Int[np.ndarray, "K"]) -> _Texels:
        return _Texels(self.position_m[rows], self.normal[rows], self.part[rows])


def bake_light(
    parts: Sequence[Part],
    rooms: Sequence[Room],
    part_rooms: Sequence[int],
    texels_m: Sequence[float],
) -> list[Float[np.ndarray, "h w 2"]]:
    """Light on all surfaces, in order: from lamp and window, each 1 on a well-lit wall."""
    layers: list[list[Float[np.ndarray, "h w 2"]]] = [[] for _ in parts]
    for room_index, room in enumerate(rooms):
        members = [index for index, owner in enumerate(part_rooms) if owner == room_index]
        grids = [
            (index, surface, *_texel_grid(surface, texels_m[index]))
            for index in members
            for surface in parts[index].surfaces
        ]
        texels = _Texels(
            np.concatenate([points.reshape(-1, 3) for _, _, points, _ in grids]),
            np.concatenate([normals.reshape(-1, 3) for _, _, _, normals in grids]),
            np.repeat([g[0] for g in grids], [g[2].shape[0] * g[2].shape[1] for g in grids]),
        )
        blocks = [(index, parts[index]) for index in members if parts[index].half_m.any()]
        light = _light_room(room, texels, blocks)
        at = 0
        for index, surface, points, _ in grids:
            height, width = points.shape[:2]
            layer = light[at : at + height * width].reshape(height, width, 2)
            at += height * width
            layers[index].append(_glow(surface, layer))
    return [layer for part_layers in layers for layer in part_layers]


def _glow(surface: Surface, layer: Float[np.ndarray, "h w 2"]) -> np.ndarray:
    """Replaces received light by own light on lamps and windows."""
    if surface.glow == 0.0:
        return cv2.GaussianBlur(layer, (3, 3), 0.8, borderType=cv2.BORDER_REPLICATE)
    is_lamp = surface.outline is not None
    own = (surface.glow, 0.0) if is_lamp else (0.0, surface.glow * _WINDOW_GAIN)
    return np.broadcast_to(np.array(own, np.float32), layer.shape).copy()


def _texel_grid(
    surface: Surface, texel_m: float
) -> tuple[Float[np.ndarray, "h w 3"], Float[np.ndarray, "h w 3"]]:
    """Positions and normals at the middles of a surface's light texels."""
    points = surface.points
    down_m = np.linalg.norm(np.diff(points, axis=0), axis=2).sum(0).mean()
    right_m = np.linalg.norm(np.diff(points, axis=1), axis=2).sum(1).mean()
    height, width = (int(np.clip(round(side / texel_m), 2, 128)) for side in (down_m, right_m))
    rows, columns = points.shape[:2]
    y, x = np.meshgrid(
        (np.arange(height) + 0.5) / height * (rows - 1),
        (np.arange(width) + 0.5) / width * (columns - 1),
        indexing="ij",
    )
    return _interpolate(points, y, x), _interpolate(_grid_normals(points), y, x)


def _interpolate(grid: np.ndarray, y: np.ndarray, x: np.ndarray) -> np.ndarray:
    row = np.minimum(y.astype(int), grid.shape[0] - 2)
    column = np.minimum(x.astype(int), grid.shape[1] - 2)
    fy, fx = (y - row)[..., None], (x - column)[..., None]
    upper = (1 - fx) * grid[row, column] + fx * grid[row, column + 1]
    lower = (1 - fx) * grid[row + 1, column] + fx * grid[row + 1, column + 1]
    return (1 - fy) * upper + fy * lower


def _grid_normals(points: Float[np.ndarray, "R C 3"]) -> Float[np.ndarray, "R C 3"]:
    """Smooth unit normals; the poles of a ball take those of the next ring."""
    down, right = np.gradient(points, axis=0), np.gradient(points, axis=1)
    if points.shape[1] > 2 and np.allclose(points[:, 0], points[:, -1]):
        right[:, 0] = right[:, -1] = (points[:, 1] - points[:, -2]) / 2
    normal = np.cross(down, right)
    length = np.linalg.norm(normal, axis=2, keepdims=True)
    if length.shape[0] > 2:
        for pole, ring in ((0, 1), (-1, -2)):
            if length[pole].max() < 1e-12:
                normal[pole], length[pole] = normal[ring], length[ring]
    return normal / np.maximum(length, 1e-12)


def _light_room(
    room: Room, texels: _Texels, blocks: Sequence[tuple[int, Part]]
) -> Float[np.ndarray, "M 2"]:
    """Direct light with shadows, and light from all around dimmed in nooks."""
    openness = np.zeros(len(texels.position_m))
    for direction in _AMBIENT_DIRECTIONS:
        way = texels.normal + 0.9 * direction
        way /= np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-6)
        ends = texels.position_m + _AMBIENT_REACH_M * way
        openness += ~_blocked(texels, ends, blocks, _AMBIENT_REACH_M)
    openness /= len(_AMBIENT_DIRECTIONS)
    ambient = openness * (0.8 + 0.2 * texels.normal[:, 2])
    lamp = np.zeros(len(openness))
    for shift in _LAMP_SPREAD_M:
        lamp += _direct(texels, np.array(room.lamp_m) + shift, blocks) / len(_LAMP_SPREAD_M)
    window = 0.0
    for point in _window_points(room):
        to_window = point - texels.position_m
        facing = np.clip(-to_window[:, 1] / np.linalg.norm(to_window, axis=1), 0, 1)
        window = window + 0.5 * facing**0.5 * _direct(texels, point, blocks)
    window = _WINDOW_GAIN * (0.7 * np.asarray(window) + 0.22 * ambient)
    return np.stack([0.85 * lamp + 0.42 * ambient, window], 1).astype(np.float32)


def _window_points(room: Room) -> list[Float[np.ndarray, "3"]]:
    """Two points that stand for a window, which shines towards +y."""
    if room.window is None:
        return []
    (x, z), (width, height) = room.window.center_m, room.window.size_m
    shift = np.array([width / 4, 0, height / 6])
    return [np.array([x, room.y_m[0], z]) + sign * shift for sign in (-1, 1)]


def _direct(
    texels: _Texels, source: Float[np.ndarray, "3"], blocks: Sequence[tuple[int, Part]]
) -> Float[np.ndarray, "M"]:
    """Lambert's law with a softened fall-off, zero in shadow."""
    to_source = source - texels.position_m
    distance = np.linalg.norm(to_source, axis=1)
    slant = np.einsum("mi,mi->m", texels.normal, to_source) / distance
    facing = np.flatnonzero(slant > 0)
    ends = np.broadcast_to(source, (len(facing), 3))
    lit = facing[~_blocked(texels.select(facing), ends, blocks, np.inf)]
    light = np.zeros(len(slant))
    light[lit] = slant[lit] / (0.4 + 0.22 * distance[lit] ** 2)
    return light


def _blocked(
    texels: _Texels,
    ends: Float[np.ndarray, "M 3"],
    blocks: Sequence[tuple[int, Part]],
    reach_m: float,
) -> Bool[np.ndarray, "M"]:
    """Whether the way from a texel to its end meets a block other than the texel's own part."""
    blocked = np.zeros(len(ends), bool)
    for index, block in blocks:
        near = ~blocked & (texels.part != index)
        if np.isfinite(reach_m):
            radius = reach_m + float(np.linalg.norm(block.half_m))
            for axis in range(3):
                near &= np.abs(texels.position_m[:, axis] - block.center_m[axis]) < radius
        rows = np.flatnonzero(near)
        start = turn(texels.position_m[rows] - block.center_m, -block.yaw_rad)
        way = turn(ends[rows] - block.center_m, -block.yaw_rad) - start
        first, last = np.full(len(rows), -np.inf), np.full(len(rows), np.inf)
        for axis in range(3):
            step = way[:, axis]
            step = np.where(np.abs(step) < 1e-9, 1e-9, step)
            middle = -start[:, axis] / step
            half = np.abs(block.half_m[axis] / step)
            np.maximum(first, middle - half, out=first)
            np.minimum(last, middle + half, out=last)
        # The small margin keeps a face that merely touches a block from being shaded by it.
        blocked[rows] = (first < last) & (last > 2e-3) & (first < 1.0)
    return blocked
