"""Rooms in a row, furniture along their walls, objects on the furniture, floor and walls."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from remind_jax.errors import ConfigError
from remind_jax.synthetic.furniture import KINDS, Support
from remind_jax.synthetic.options import LookalikeGroup, SceneOptions
from remind_jax.synthetic.scene import (
    Furniture,
    Look,
    Opening,
    Placement,
    Room,
    SceneObject,
    Window,
)
from remind_jax.synthetic.shapes import CLASSES
from remind_jax.synthetic.surfaces import turn

ROOM_WIDTH_M = 4.0
ROOM_DEPTH_M = 3.6
CORRIDOR_LENGTH_M = 0.9
DOOR_Y_M = 1.1
_HEIGHT_M = 2.5
_TRIES = 200
_OVERHANG_M = 0.06  # leaves and shades may stand out over an edge
_SOUTH_YAW_RAD = 3.0


def room_offset_m(room_number: int) -> float:
    """X of a room's west wall."""
    return room_number * (ROOM_WIDTH_M + CORRIDOR_LENGTH_M)


def lay_out_rooms(options: SceneOptions, rng: np.random.Generator) -> tuple[Room, ...]:
    """The rooms 0, 1, ..., then the corridors; a single room has one corridor to go to."""
    num = options.num_rooms
    num_corridors = max(1, num - 1)
    door = {"center_m": DOOR_Y_M, "width_m": 0.95, "height_m": 2.05}
    rooms = []
    for number in range(num):
        x = room_offset_m(number)
        openings = [Opening("west", **door)] if number else []
        if number < num_corridors:
            openings.append(Opening("east", **door))
        window_x = x + ROOM_WIDTH_M / 2 + float(rng.uniform(-0.3, 0.3))
        window = Window("south", (window_x, 1.55), (1.2, 1.0))
        seed = int(rng.integers(2**31))
        span = (x, x + ROOM_WIDTH_M), (0.0, ROOM_DEPTH_M)
        rooms.append(Room(chr(ord("A") + number), *span, _HEIGHT_M, seed, tuple(openings), window))
    for number in range(num_corridors):
        x = room_offset_m(number) + ROOM_WIDTH_M
        is_closed = number + 1 == num
        length = 2.6 if is_closed else CORRIDOR_LENGTH_M
        wide = Opening("west", DOOR_Y_M, 1.3, 2.4)
        openings = (wide,) if is_closed else (wide, dataclasses.replace(wide, wall="east"))
        span = (x, x + length), (DOOR_Y_M - 0.65, DOOR_Y_M + 0.65)
        seed = int(rng.integers(2**31))
        rooms.append(Room(f"corridor {number + 1}", *span, 2.4, seed, openings))
    return tuple(rooms)


def furnish(options: SceneOptions, rng: np.random.Generator) -> tuple[Furniture, ...]:
    """Six pieces per room: two along the north wall, one each west, east and south, and a rug."""
    furniture = []
    quarter = np.pi / 2
    for room in range(options.num_rooms):
        x0 = room_offset_m(room)
        kinds = rng.permutation(["table", "shelf"]).tolist()
        sides = rng.permutation(["sideboard", "table"]).tolist()
        slots = [
            (kinds[0], 1.15, ROOM_DEPTH_M, 0.0),
            (kinds[1], 2.8, ROOM_DEPTH_M, 0.0),
            (sides[0], 0.0, 2.3, quarter),
            (sides[1], ROOM_WIDTH_M, 2.4, -quarter),
            ("sideboard", 2.0, 0.0, 2 * quarter),
            ("rug", 2.0, 1.7, 0.0),
        ]
        for kind, x, y, yaw in slots:
            width, depth, height = KINDS[kind].size_m
            if yaw in (quarter, -quarter):
                width = min(width, 1.15)
            depth_m = min(depth, 0.4) if y == 0.0 else depth
            size = (width * float(rng.uniform(0.96, 1.04)), depth_m, height)
            into_room = turn(np.array([0.0, -depth_m / 2 - 0.02, 0.0]), yaw)
            shift = into_room if kind != "rug" else np.zeros(3)
            position = (x0 + x + float(shift[0]), y + float(shift[1]), 0.0)
            furniture.append(Furniture(kind, size, position, yaw, room, int(rng.integers(2**31))))
    return tuple(furniture)


def cast_objects(
    options: SceneOptions, rng: np.random.Generator
) -> list[tuple[str, Look, float, str, int]]:
    """Which objects there are: class, look, scale, look-alike group and room of each."""
    cast = []
    for number, group in enumerate(options.lookalikes):
        name = f"{group.label} {group.kind} {number + 1}"
        scale = float(rng.uniform(1.05, 1.25))
        for member, look in enumerate(_similar_looks(group, rng)):
            room = group.rooms[member % len(group.rooms)]
            cast.append((group.label, look, scale, name, room))
    taken = {group.label for group in options.lookalikes}
    for room in range(options.num_rooms):
        free = options.objects_per_room - sum(member[4] == room for member in cast)
        if free < 0:
            raise ConfigError(
                f"objects_per_room={options.objects_per_room} is less than the "
                f"{options.objects_per_room - free} look-alikes of room {room}; give more"
            )
        # Classes not used by look-alikes come first, so that few objects differ most.
        order = rng.permutation(len(options.classes))
        pool = sorted((options.classes[i] for i in order), key=lambda label: label in taken)
        for index in range(free):
            label = pool[index % len(pool)]
            look = Look(int(rng.integers(2**31)), int(rng.integers(2**31)))
            cast.append((label, look, float(rng.uniform(1.05, 1.3)), "", room))
    return cast


def _similar_looks(group: LookalikeGroup, rng: np.random.Generator) -> list[Look]:
    pattern, palette = int(rng.integers(2**31)), int(rng.integers(2**31))
    start = float(rng.uniform(0, 360))
    looks = []
    for member in range(group.members):
        if group.kind == "tint":
            looks.append(Look(pattern, palette, 20.0 * member))
        elif group.kind == "glaze":
            looks.append(Look(pattern, palette, start + 360.0 * member / group.members))
        elif group.kind == "pattern":
            looks.append(Look(int(rng.integers(2**31)), palette))
        else:
            looks.append(Look(pattern, palette))
    return looks


class Places:
    """Finds free places for objects; remembers what is taken, in the order of asking."""

    def __init__(self, options: SceneOptions, furniture: Sequence[Furniture]):
        self._gap_m = options.gap_m
        self._furniture = furniture
        self._taken: list[tuple[float, float, float, float]] = []  # x, y, z, radius

    def find(
        self, label: str, scale: float, room: int, rng: np.random.Generator, start_frame: int = 0
    ) -> Placement:
        """A free place for an object of a class in a room.

        Raises:
          ConfigError: If the room is full.
        """
        kind = CLASSES[label]
        width, depth, height = (scale * side for side in kind.size_m)
        radius = 0.5 * max(width, depth) if kind.place == "wall" else 0.25 * (width + depth)
        for crowding in (1.0, 0.5, 0.0):
            for attempt in range(_TRIES):
                # The south wall is behind the camera for most of the tour: a last resort.
                anywhere = crowding < 1.0 and attempt >= _TRIES // 2
                spot = self._draw(kind.place, room, (width, depth, height), anywhere, rng)
                if spot is None:
                    continue
                x, y, z, yaw = spot
                if self._is_free(x, y, z, radius + crowding * self._gap_m / 2, crowding):
                    self._taken.append((x, y, z, radius + crowding * self._gap_m / 2))
                    return Placement((x, y, z), yaw, room, start_frame)
        raise ConfigError(
            f"no room is left for another {label!r} in room {room}; "
            "give fewer objects_per_room, more rooms or a smaller gap_m"
        )

    def _is_free(self, x: float, y: float, z: float, radius: float, crowding: float) -> bool:
        return all(
            abs(z - other_z) > 0.12
            or np.hypot(x - other_x, y - other_y) > radius + other_radius * (0.6 + 0.4 * crowding)
            for other_x, other_y, other_z, other_radius in self._taken
        )

    def _emptiness(self, piece: Furniture) -> float:
        """Weight of a piece in the draw: its room for objects, much less once it is used."""
        width, depth, _ = piece.size_m
        levels = KINDS[piece.kind].supports(piece.size_m)
        x0, y0, _ = piece.position_m
        near = 0.5 * max(width, depth)
        used = sum(np.hypot(x - x0, y - y0) < near for x, y, *_ in self._taken)
        # The camera turns away from the east wall first and comes back to it last.
        liking = 0.4 if piece.yaw_rad < 0 else 1.0
        return liking * width * len(levels) ** 0.5 / (1.0 + used) ** 1.5

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
            return _draw_on_floor(room, rng)
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
        slack_x = support.half_width_m - width / 2
        slack_y = support.half_depth_m - depth / 2
        if slack_x < 0 or slack_y < -_OVERHANG_M or height > support.clearance_m:
            return None
        offset = np.array([rng.uniform(-slack_x, slack_x), rng.uniform(-1, 1) * max(slack_y, 0), 0])
        x, y, z = np.array(piece.position_m) + turn(offset, piece.yaw_rad)
        yaw = piece.yaw_rad + float(rng.uniform(-0.5, 0.5))
        return float(x), float(y), float(z) + support.height_m, yaw


def _draw_on_floor(room: int, rng: np.random.Generator) -> tuple[float, float, float, float]:
    """A corner or a spot before the furniture, off the way of the camera."""
    x, y, yaw = (
        (0.4, 0.45, 2.4),
        (3.55, 0.4, -2.4),
        (0.45, 3.15, 0.8),
        (3.55, 3.25, -0.8),
        (1.97, 3.2, 0.0),
        (1.1, 2.6, 0.3),
        (2.9, 2.65, -0.3),
    )[int(rng.integers(7))]
    x, y = x + float(rng.uniform(-0.08, 0.08)), y + float(rng.uniform(-0.08, 0.08))
    return room_offset_m(room) + x, y, 0.0, yaw + float(rng.uniform(-0.6, 0.6))


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


def place_objects(
    options: SceneOptions, furniture: Sequence[Furniture], rng: np.random.Generator
) -> tuple[list[SceneObject], Places]:
    """All objects at their first places, numbered from 1."""
    places = Places(options, furniture)
    cast = cast_objects(options, rng)
    # Large things first: small ones still fit between them.
    order = sorted(range(len(cast)), key=lambda index: -max(CLASSES[cast[index][0]].size_m))
    placements = {}
    for index in order:
        label, _, scale, _, room = cast[index]
        placements[index] = places.find(label, scale, room, rng)
    objects = [
        SceneObject(index + 1, label, look, scale, (placements[index],), group)
        for index, (label, look, scale, group, _) in enumerate(cast)
    ]
    return objects, places


def change_objects(
    objects: list[SceneObject],
    places: Places,
    options: SceneOptions,
    source_frame: int,
    rng: np.random.Generator,
) -> list[SceneObject]:
    """Moves, removes, swaps and adds objects of the first room at a frame."""
    here = [index for index, item in enumerate(objects) if item.placements[0].room == 0]
    counts = [round(share * len(here)) for share in (options.moved, options.removed)]
    num_pairs = round(options.swapped * len(here) / 2)
    shuffled = [int(index) for index in rng.permutation(here)]
    moved, removed = shuffled[: counts[0]], shuffled[counts[0] : sum(counts)]
    rest = shuffled[sum(counts) :]
    changed = list(objects)
    for index in moved:
        item = objects[index]
        changed[index] = _replace_from(
            item, places.find(item.label, item.scale, 0, rng, source_frame), source_frame
        )
    for index in removed:
        changed[index] = _replace_from(objects[index], None, source_frame)
    for first, second in _swappable(objects, rest)[:num_pairs]:
        for one, other in ((first, second), (second, first)):
            spot = dataclasses.replace(objects[other].placements[0], start_frame=source_frame)
            changed[one] = _replace_from(objects[one], spot, source_frame)
    for _ in range(round(options.added * len(here))):
        label = options.classes[int(rng.integers(len(options.classes)))]
        look = Look(int(rng.integers(2**31)), int(rng.integers(2**31)))
        scale = float(rng.uniform(1.05, 1.3))
        placement = places.find(label, scale, 0, rng, source_frame)
        changed.append(SceneObject(len(changed) + 1, label, look, scale, (placement,)))
    return changed


def _swappable(objects: Sequence[SceneObject], indices: Sequence[int]) -> list[tuple[int, int]]:
    """Disjoint pairs that can take each other's place: same habitat, nearest in height."""
    pairs = []
    for place in ("surface", "wall", "floor"):
        fitting = [index for index in indices if CLASSES[objects[index].label].place == place]
        fitting.sort(key=lambda index: CLASSES[objects[index].label].size_m[2])
        pairs += list(zip(fitting[::2], fitting[1::2], strict=False))
    return pairs


def _replace_from(item: SceneObject, new: Placement | None, source_frame: int) -> SceneObject:
    ended = dataclasses.replace(item.placements[0], end_frame=source_frame)
    placements = (ended,) if new is None else (ended, new)
    return dataclasses.replace(item, placements=placements)
