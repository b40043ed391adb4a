"""Free places for objects on furniture, floor and walls, such that nothing touches."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from remind_jax.errors import ConfigError
from remind_jax.synthetic.floor_plan import ROOM_DEPTH_M, ROOM_WIDTH_M, room_offset_m
from remind_jax.synthetic.furniture import KINDS, Support
from remind_jax.synthetic.options import SceneOptions
from remind_jax.synthetic.scene import Furniture, Placement
from remind_jax.synthetic.shapes import CLASSES
from remind_jax.synthetic.surfaces import turn

_TRIES = 200
_FLOOR_NORTH_M = (2.15, ROOM_DEPTH_M)  # y of the floor that the camera does not walk on
_FLOOR_SOUTH_M = (0.0, 0.6)
_NORTH_SHARE = 0.8
_OVERHANG_M = 0.06  # leaves and shades may stand out over an edge
_NUM_CHOICES = 6
_SOUTH_YAW_RAD = 3.0


@dataclasses.dataclass(frozen=True, eq=False)
class _Block:
    """The upright block that an object fills."""

    center_m: Float[np.ndarray, "2"]  # x, y
    half_m: Float[np.ndarray, "2"]  # half of width and depth
    yaw_rad: float
    z_m: tuple[float, float]  # lower and upper end

    def touches(self, other: _Block, gap_m: float) -> bool:
        """Whether two blocks come closer than a gap."""
        if self.z_m[0] >= other.z_m[1] or other.z_m[0] >= self.z_m[1]:
            return False
        way = other.center_m - self.center_m
        # Two rectangles are apart if they are so along a side of one of them.
        for axis in (*self._axes(), *other._axes()):
            reach = sum(np.abs(block._axes() @ axis) @ block.half_m for block in (self, other))
            if abs(way @ axis) > reach + gap_m:
                return False
        return True

    def _axes(self) -> Float[np.ndarray, "2 2"]:
        cos, sin = np.cos(self.yaw_rad), np.sin(self.yaw_rad)
        return np.array([[cos, sin], [-sin, cos]])


class Places:
    """Finds free places for objects; remembers what is taken, in the order of asking."""

    def __init__(self, options: SceneOptions, furniture: Sequence[Furniture]):
        self._gap_m = options.gap_m
        self._furniture = furniture
        self._taken: list[_Block] = []

    def find(
        self,
        label: str,
        scale: float,
        room: int,
        rng: np.random.Generator,
        start_frame: int = 0,
        away_from: Sequence[Placement] = (),
    ) -> Placement:
        """A free place for an object of a class in a room; gaps shrink as the room fills up.

        Args:
          away_from: If given, the best of several places far from these is taken.

        Raises:
          ConfigError: If the room is full.
        """
        num_wanted = _NUM_CHOICES if away_from else 1
        found: list[tuple[Placement, _Block]] = []
        for gap_m in (self._gap_m, self._gap_m / 2, 0.0):
            for attempt in range(_TRIES):
                # The south wall is behind the camera for most of the tour: a last resort.
                anywhere = gap_m < self._gap_m and attempt >= _TRIES // 2
                spot = self._try(label, scale, room, gap_m, anywhere, rng)
                if spot is not None:
                    found.append(spot)
                if len(found) == num_wanted:
                    break
            if found:
                placement, block = max(found, key=lambda spot: _distance_m(spot[0], away_from))
                self._taken.append(block)
                return dataclasses.replace(placement, start_frame=start_frame)
        raise ConfigError(
            f"no room is left for another {label!r} in room {room}; "
            "give fewer objects_per_room, more rooms or a smaller gap_m"
        )

    def _try(
        self,
        label: str,
        scale: float,
        room: int,
        gap_m: float,
        anywhere: bool,
        rng: np.random.Generator,
    ) -> tuple[Placement, _Block] | None:
        """One random place, or None if the object does not fit or touches another there."""
        kind = CLASSES[label]
        width, depth, height = (scale * side for side in kind.size_m)
        spot = self._draw(kind.place, room, (width, depth, height), anywhere, rng)
        if spot is None:
            return None
        x, y, z, yaw = spot
        foot = z - height / 2 if kind.place == "wall" else z
        half = np.array([width, depth]) / 2
        block = _Block(np.array([x, y]), half, yaw, (foot, foot + height))
        if any(block.touches(other, gap_m) for other in self._taken):
            return None
        return Placement((x, y, z), yaw, room), block

    def _emptiness(self, piece: Furniture) -> float:
        """Weight of a piece in the draw: its room for objects, much less once it is used."""
        width, depth, _ = piece.size_m
        levels = KINDS[piece.kind].supports(piece.size_m)
        x0, y0, _ = piece.position_m
        near = 0.5 * max(width, depth)
        used = sum(np.hypot(*(block.center_m - (x0, y0))) < near for block in self._taken)
        # The camera turns away from the east wall first and comes back to it last.
        liking = 0.4 if piece.yaw_rad < 0 else 1.0
        return liking * width * len(levels) ** 0.5 / (1.0 + used) ** 2

    def _draw(
        self,
        place: str,
        room: int,
        size: tuple[float, float, float],
        anywhere: bool,
        rng: np.random.Generator,
    ) -> tuple[float, float, float, float] | None:
        """A random x, y, z, yaw of the habitat, or None if it does not fit there."""
        if place == "wall":
            return _draw_on_wall(room, size, rng)
        if place == "floor":
            return _draw_on_floor(room, size, self._furniture, rng)
        pieces = [
            piece
            for piece in self._furniture
            if piece.room == room
            and piece.kind != "rug"
            and (anywhere or abs(piece.yaw_rad) < _SOUTH_YAW_RAD)
        ]
        emptiness = np.array([self._emptiness(piece) for piece in pieces])
        piece = pieces[int(rng.choice(len(pieces), p=emptiness / emptiness.sum()))]
        supports: list[Support] = KINDS[piece.kind].supports(piece.size_m)
        support = supports[int(rng.integers(len(supports)))]
        width, depth, height = size
        twist = float(rng.uniform(-0.5, 0.5))
        cos, sin = np.cos(twist), abs(np.sin(twist))
        slack_x = support.half_width_m - (width * cos + depth * sin) / 2
        slack_y = support.half_depth_m - (width * sin + depth * cos) / 2
        if slack_x < 0 or slack_y < -_OVERHANG_M or height > support.clearance_m:
            return None
        offset = np.array([rng.uniform(-slack_x, slack_x), rng.uniform(-1, 1) * max(slack_y, 0), 0])
        x, y, z = np.array(piece.position_m) + turn(offset, piece.yaw_rad)
        return float(x), float(y), float(z) + support.height_m, piece.yaw_rad + twist


def _draw_on_floor(
    room: int,
    size: tuple[float, float, float],
    furniture: Sequence[Furniture],
    rng: np.random.Generator,
) -> tuple[float, float, float, float] | None:
    """A spot before the northern furniture or along the south wall, off the camera's way."""
    width, depth, _ = size
    radius = 0.5 * max(width, depth)
    north = rng.random() < _NORTH_SHARE
    x = float(rng.uniform(radius, ROOM_WIDTH_M - radius))
    low, high = _FLOOR_NORTH_M if north else _FLOOR_SOUTH_M
    y = float(rng.uniform(low + radius, max(low + radius, high - radius)))
    x += room_offset_m(room)
    for piece in furniture:
        if piece.room != room or piece.kind == "rug":
            continue
        turned = abs(abs(piece.yaw_rad) - np.pi / 2) < 0.1
        half = np.array(piece.size_m[1::-1] if turned else piece.size_m[:2]) / 2
        gap = np.abs(np.array(piece.position_m[:2]) - (x, y)) - half
        if (gap < radius).all():
            return None
    facing = 0.0 if north else np.pi
    return x, y, 0.0, facing + float(rng.uniform(-1.2, 1.2))


def _draw_on_wall(
    room: int, size: tuple[float, float, float], rng: np.random.Generator
) -> tuple[float, float, float, float]:
    """A spot above the furniture on the north, west or east wall."""
    x0, half = room_offset_m(room), size[0] / 2
    side = rng.choice(["north", "north", "west", "east"])
    z = float(rng.uniform(1.62, 1.85))
    if side == "north":
        x = float(rng.uniform(0.1 + half, ROOM_WIDTH_M - 0.1 - half))
        return x0 + x, ROOM_DEPTH_M - 0.003, z, 0.0
    y = float(rng.uniform(1.75 + half, ROOM_DEPTH_M - 0.2 - half))
    if side == "west":
        return x0 + 0.003, y, z, np.pi / 2
    return x0 + ROOM_WIDTH_M - 0.003, y, z, -np.pi / 2


def _distance_m(placement: Placement, others: Sequence[Placement]) -> float:
    """Distance to the nearest of some other places, infinite if there are none."""
    gaps = np.array([other.position_m for other in others]).reshape(-1, 3) - placement.position_m
    return float(np.linalg.norm(gaps, axis=1).min(initial=np.inf))
