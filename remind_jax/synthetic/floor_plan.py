"""Rooms in a row with corridors between them, and furniture along their walls."""

from __future__ import annotations

import dataclasses

import numpy as np

from remind_jax.synthetic.furniture import KINDS
from remind_jax.synthetic.options import SceneOptions
from remind_jax.synthetic.scene import Furniture, Opening, Room, Window
from remind_jax.synthetic.surfaces import turn

ROOM_WIDTH_M = 4.0
ROOM_DEPTH_M = 3.6
CORRIDOR_LENGTH_M = 0.9
DOOR_Y_M = 1.1
_HEIGHT_M = 2.5


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
        window = Window((window_x, 1.55), (1.2, 1.0))
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
