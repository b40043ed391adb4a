"""Unannotated things: furniture that carries objects, and the shell of a room."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from remind_jax.synthetic import textures
from remind_jax.synthetic.scene import Furniture, Room
from remind_jax.synthetic.surfaces import Part, Surface, box, disc, quad

TEXELS_PER_M = 200
LAMP_GLOW = 2.5
WINDOW_GLOW = 2.0
_BOARD_M = 0.03
_WOODS = ((196, 158, 108), (158, 112, 70), (112, 76, 50), (214, 190, 150), (134, 106, 82))
_WALLS = ((206, 198, 180), (176, 190, 196), (190, 200, 176), (204, 184, 178), (190, 182, 204))


@dataclasses.dataclass(frozen=True)
class Support:
    """A level of a piece of furniture on which objects can stand, in its own frame."""

    height_m: float
    half_width_m: float
    half_depth_m: float
    clearance_m: float  # up to what is above


@dataclasses.dataclass(frozen=True)
class Kind:
    """A kind of furniture: nominal size, levels, and how to build one."""

    size_m: tuple[float, float, float]  # width, depth, height
    supports: Callable[[tuple[float, float, float]], list[Support]]
    build: Callable[[np.random.Generator, tuple[float, float, float]], list[Part]]


def build_furniture(furniture: Furniture) -> list[Part]:
    """The parts of a piece of furniture at its place in the world."""
    rng = np.random.default_rng([furniture.texture_seed, 3])
    parts = KINDS[furniture.kind].build(rng, furniture.size_m)
    return [part.moved(furniture.position_m, furniture.yaw_rad) for part in parts]


def build_room(room: Room, is_corridor: bool) -> list[Part]:
    """Floor, ceiling, walls with their openings and trims, lamp and window."""
    rng = np.random.default_rng([room.texture_seed, 4])
    (x0, x1), (y0, y1), height = room.x_m, room.y_m, room.height_m
    wall_color = _pick(rng, _WALLS)
    floor_pattern = textures.tiles if is_corridor or rng.integers(3) == 0 else textures.planks
    floor_color = (150, 142, 132) if floor_pattern is textures.tiles else _pick(rng, _WOODS)
    floor = _paint(rng, floor_pattern, x1 - x0, y1 - y0, [floor_color])
    ceiling = _paint(rng, textures.plain, 1, 1, [(228, 226, 220)])
    wall_seed = int(rng.integers(2**31))

    def wall(width: float, tall: float) -> textures.Image:
        """A strip of the same wallpaper, cut at the top where the wall does not reach the floor."""
        image = _paint(
            np.random.default_rng(wall_seed), textures.wallpaper, width, height, [wall_color]
        )
        return image[: max(8, round(tall * TEXELS_PER_M))] if tall < height else image

    lamp_x, lamp_y, _ = room.lamp_m
    lamp = disc((lamp_x, lamp_y, height - 0.03), 0.22, np.full((16, 16, 3), 250, np.uint8), "down")
    surfaces = [
        quad((x0, y1, 0), (x1 - x0, 0, 0), (0, y0 - y1, 0), floor),
        quad((x0, y0, height), (x1 - x0, 0, 0), (0, y1 - y0, 0), ceiling),
        quad((x0, y1, height), (x1 - x0, 0, 0), (0, 0, -height), wall(x1 - x0, height)),
        quad((x1, y0, height), (x0 - x1, 0, 0), (0, 0, -height), wall(x1 - x0, height)),
        dataclasses.replace(lamp, glow=LAMP_GLOW),
    ]
    for side in ("west", "east"):
        surfaces += _end_wall(room, side, wall)
    if room.window is not None:
        surfaces.append(_window(room, rng))
    nowhere = np.zeros(3)
    parts = [Part((surface,), nowhere, nowhere) for surface in surfaces]
    return parts + _door_frames(room)


def _end_wall(
    room: Room, side: str, wall: Callable[[float, float], textures.Image]
) -> list[Surface]:
    """The west or east wall, in up to three pieces around its opening."""
    (y0, y1), height = room.y_m, room.height_m
    x = room.x_m[0] if side == "west" else room.x_m[1]
    opening = next((o for o in room.openings if o.wall == side), None)
    if opening is None:
        spans = [(y0, y1, 0.0)]
    else:
        low, high = opening.center_m - opening.width_m / 2, opening.center_m + opening.width_m / 2
        spans = [(y0, low, 0.0), (low, high, opening.height_m), (high, y1, 0.0)]
    surfaces = []
    for low, high, bottom in spans:
        if high - low < 1e-6 or height - bottom < 1e-6:
            continue
        start, step = (low, high - low) if side == "west" else (high, low - high)
        image = wall(high - low, height - bottom)
        surfaces.append(quad((x, start, height), (0, step, 0), (0, 0, bottom - height), image))
    return surfaces


def _door_frames(room: Room) -> list[Part]:
    trim = np.full((24, 24, 3), (206, 200, 190), np.uint8)
    parts = []
    for opening in room.openings:
        x = room.x_m[0] if opening.wall == "west" else room.x_m[1]
        for sign in (-1, 1):
            y = opening.center_m + sign * (opening.width_m / 2 + 0.02)
            center = (x, y, opening.height_m / 2)
            parts.append(box((0.14, 0.08, opening.height_m), {"rest": trim}, center))
        lintel = (x, opening.center_m, opening.height_m + 0.03)
        parts.append(box((0.14, opening.width_m + 0.12, 0.08), {"rest": trim}, lintel))
    return parts


def _window(room: Room, rng: np.random.Generator) -> Surface:
    assert room.window is not None
    (x, z), (width, height) = room.window.center_m, room.window.size_m
    image = _paint(rng, textures.view_outside, width, height, [])
    corner = (x + width / 2, room.y_m[0] + 0.01, z + height / 2)
    return quad(corner, (-width, 0, 0), (0, 0, -height), image, glow=WINDOW_GLOW)


def _table(rng: np.random.Generator, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    leg = 0.06
    color = _pick(rng, _WOODS)
    top = _paint(rng, textures.wood, w, d, [color])
    edge = _paint(rng, textures.wood, w, 0.12, [color])
    parts = [box((w, d, 0.04), {"rest": edge, "top": top}, (0, 0, h - 0.02))]
    for x in (-1, 1):
        for y in (-1, 1):
            foot = (x * (w / 2 - leg), y * (d / 2 - leg), (h - 0.04) / 2)
            parts.append(box((leg, leg, h - 0.04), {"rest": edge}, foot))
    return parts


def _sideboard(rng: np.random.Generator, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    color = _pick(rng, _WOODS) if rng.integers(2) else (205, 202, 194)
    front = _paint(rng, textures.wood, w, h, [color])
    dark = tuple(0.45 * np.array(color))
    num_doors = max(2, round(w / 0.5))
    for door in range(num_doors):
        left = round(door / num_doors * front.shape[1])
        front[:, left : left + 3] = dark
        knob = left + round(front.shape[1] / num_doors * 0.85)
        front[front.shape[0] // 2 - 5 : front.shape[0] // 2 + 5, knob : knob + 4] = (60, 60, 62)
    front[:3] = front[-12:] = dark
    side = _paint(rng, textures.wood, d, h, [color])
    top = _paint(rng, textures.wood, w, d, [color])
    return [box(size, {"front": front, "rest": side, "top": top}, (0, 0, h / 2))]


def _shelf(rng: np.random.Generator, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    color = _pick(rng, _WOODS)
    board = _paint(rng, textures.wood, w, d, [color])
    edge = _paint(rng, textures.wood, w, 0.12, [color])
    back = _paint(rng, textures.wood, w, h, [tuple(0.8 * np.array(color))])
    parts = [box((w, 0.02, h), {"front": back, "rest": edge}, (0, d / 2 - 0.01, h / 2))]
    for x in (-1, 1):
        upright = (x * (w / 2 - _BOARD_M / 2), 0, h / 2)
        parts.append(box((_BOARD_M, d, h), {"rest": edge}, upright))
    for support in _shelf_levels(size):
        level = (0, 0, support.height_m - _BOARD_M / 2)
        images = {"rest": edge, "top": board, "bottom": board}
        parts.append(box((w - 2 * _BOARD_M, d - 0.01, _BOARD_M), images, level))
    return parts


def _rug(rng: np.random.Generator, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    image = _paint(rng, textures.rug, w, d, textures.draw_palette(rng))
    part = box(size, {"top": image, "rest": image[:8]}, (0, 0, h / 2))
    return [dataclasses.replace(part, half_m=np.zeros(3))]


def _one_level(size: tuple[float, float, float]) -> list[Support]:
    w, d, h = size
    return [Support(h, w / 2 - 0.04, d / 2 - 0.04, 0.8)]


def _shelf_levels(size: tuple[float, float, float]) -> list[Support]:
    w, d, h = size
    step = (h - 0.3) / 2
    half = w / 2 - _BOARD_M - 0.03, d / 2 - 0.04
    lower = [Support(0.3 + step * level, *half, step - _BOARD_M) for level in range(2)]
    return [*lower, Support(h, *half, 0.8)]


def _pick(rng: np.random.Generator, shades: Sequence[textures.Color]) -> textures.Color:
    return shades[int(rng.integers(len(shades)))]


def _paint(
    rng: np.random.Generator,
    pattern: textures.Pattern,
    width_m: float,
    height_m: float,
    colors: list[tuple[float, float, float]],
) -> textures.Image:
    height, width = max(8, round(height_m * TEXELS_PER_M)), max(8, round(width_m * TEXELS_PER_M))
    return pattern(rng, height, width, colors)


KINDS: dict[str, Kind] = {
    "table": Kind((1.4, 0.6, 0.74), _one_level, _table),
    "sideboard": Kind((1.3, 0.45, 0.8), _one_level, _sideboard),
    "shelf": Kind((1.2, 0.36, 1.3), _shelf_levels, _shelf),
    "rug": Kind((1.6, 1.1, 0.008), lambda size: [], _rug),
}
