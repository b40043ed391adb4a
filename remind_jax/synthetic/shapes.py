"""The classes of annotated objects: what they are built of and where they are found."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from remind_jax.synthetic import textures
from remind_jax.synthetic.scene import Look
from remind_jax.synthetic.surfaces import Part, Surface, both_sides, box, disc, revolve, tube

TEXELS_PER_M = 480
_DECORATIONS = (
    textures.stripes,
    textures.dots,
    textures.checks,
    textures.blotches,
    textures.flowers,
)


@dataclasses.dataclass(frozen=True)
class ObjectClass:
    """A class of objects: nominal size, habitat, and how to build one."""

    size_m: tuple[float, float, float]  # width, depth, height
    place: str  # "surface" (on furniture), "floor" or "wall"
    build: Callable[[_Paint, tuple[float, float, float]], list[Part]]


class _Paint:
    """Makes the images of one object: one palette, one stream of pattern choices."""

    def __init__(self, look: Look):
        self.rng = np.random.default_rng([look.pattern_seed, 1])
        self.colors = textures.draw_palette(np.random.default_rng([look.palette_seed, 2]))
        self.hue_shift_deg = look.hue_shift_deg
        self.decoration = _DECORATIONS[int(self.rng.integers(len(_DECORATIONS)))]

    def image(self, pattern: textures.Pattern, width_m: float, height_m: float) -> textures.Image:
        """A patterned image for a face of that size."""
        height = int(np.clip(height_m * TEXELS_PER_M, 24, 400))
        width = int(np.clip(width_m * TEXELS_PER_M, 24, 400))
        image = pattern(self.rng, height, width, self.colors)
        return textures.shift_hue(image, self.hue_shift_deg)

    def plain(self, color_index: int = 0, factor: float = 1.0) -> textures.Image:
        """A small image of nearly one color."""
        red, green, blue = (factor * channel for channel in self.colors[color_index])
        image = textures.plain(self.rng, 24, 24, [(red, green, blue)])
        return textures.shift_hue(image, self.hue_shift_deg)


def build_object(label: str, look: Look, scale: float) -> list[Part]:
    """An instance in its own frame: origin in the middle of its foot, front towards -y.

    Equal arguments give equal geometry and images.
    """
    kind = CLASSES[label]
    width, depth, height = kind.size_m
    return kind.build(_Paint(look), (scale * width, scale * depth, scale * height))


def _solid(surfaces: list[Surface], size: tuple[float, float, float], fill: float = 0.85) -> Part:
    """One part whose shadow is that of a slightly shrunk block of the given size."""
    w, d, h = size
    half = np.array([fill * w / 2, fill * d / 2, 0.95 * h / 2])
    return Part(tuple(surfaces), np.array([0.0, 0.0, h / 2]), half)


def _arc(
    center: tuple[float, float], radii: tuple[float, float], degrees: tuple[float, float]
) -> Float[np.ndarray, "8 3"]:
    """Points of an ellipse in the plane y = 0, angles from +x towards +z."""
    angle = np.radians(np.linspace(*degrees, 8))
    x, z = center[0] + radii[0] * np.cos(angle), center[1] + radii[1] * np.sin(angle)
    return np.stack([x, np.zeros_like(x), z], 1)


def _sphere(radius: float, height: float, image: Any, sides: int = 14, rows: int = 8) -> Surface:
    polar = np.linspace(0, np.pi, rows)
    profile = zip(radius * np.sin(polar), height / 2 * (1 + np.cos(polar)), strict=True)
    return revolve(list(profile), image, sides)


def _mug(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = 0.38 * w
    flare = float(paint.rng.uniform(0.86, 1.0))
    skin = paint.image(paint.decoration, 2 * np.pi * r, h)
    inner, foot = paint.plain(0, 0.9), 0.06 * h
    surfaces = [
        revolve([(r, h), (0.5 * (1 + flare) * r, 0.5 * h), (flare * r, 0.0)], skin),
        revolve([(0.9 * flare * r, foot), (0.92 * r, h)], inner),
        revolve([(0.92 * r, h), (r, h)], inner),
        disc((0, 0, foot), 0.92 * flare * r, paint.plain(0, 0.7)),
        tube(_arc((0.97 * r, 0.52 * h), (0.45 * r, 0.3 * h), (100, -100)), 0.1 * r, inner),
    ]
    return [_solid(surfaces, (2 * r, 2 * r, h))]


def _box(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    front = paint.image(textures.label, w, h)
    side = paint.image(textures.label, d, h)
    images = {"front": front, "back": front, "left": side, "right": side}
    return [box(size, {**images, "top": paint.plain(1), "bottom": paint.plain(0)}, (0, 0, h / 2))]


def _book(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    pages = paint.plain(3, 1.1)
    images = {"front": paint.image(textures.cover, w, h), "back": paint.plain(0), "right": pages}
    images |= {"left": paint.image(textures.stripes, d, h), "top": pages, "bottom": pages}
    return [box(size, images, (0, 0, h / 2))]


def _can(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    metal = textures.plain(paint.rng, 24, 24, [(176, 178, 182)])
    skin = paint.image(textures.label, 2 * np.pi * r, 0.9 * h)
    surfaces = [
        revolve([(r, 0.95 * h), (r, 0.05 * h)], skin),
        revolve([(0.9 * r, h), (r, 0.95 * h)], metal),
        revolve([(r, 0.05 * h), (0.92 * r, 0.0)], metal),
        disc((0, 0, h), 0.9 * r, metal),
    ]
    return [_solid(surfaces, size)]


def _bottle(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    glass = paint.plain(0, 0.75)
    shoulder = float(paint.rng.uniform(0.55, 0.68))
    surfaces = [
        revolve([(0.32 * r, 0.9 * h), (0.36 * r, 0.78 * h), (r, shoulder * h)], glass),
        revolve([(r, shoulder * h), (r, 0.15 * h)], paint.image(textures.label, 3 * w, 0.5 * h)),
        revolve([(r, 0.15 * h), (0.94 * r, 0.0)], glass),
        revolve([(0.4 * r, h), (0.4 * r, 0.9 * h)], paint.plain(1), 10),
        disc((0, 0, h), 0.4 * r, paint.plain(1), sides=10),
    ]
    return [_solid(surfaces, size, 0.75)]


def _bowl(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    skin = paint.image(paint.decoration, np.pi * r, h)
    inner = paint.image(textures.blotches, np.pi * r, h)
    outside = [(r, h), (0.88 * r, 0.55 * h), (0.62 * r, 0.2 * h), (0.45 * r, 0.0)]
    inside = [(0.3 * r, 0.12 * h), (0.6 * r, 0.25 * h), (0.84 * r, 0.58 * h), (0.95 * r, h)]
    surfaces = [
        revolve(outside, skin, 18),
        revolve(inside, inner, 18),
        revolve([(0.95 * r, h), (r, h)], paint.plain(0), 18),
        disc((0, 0, 0.12 * h), 0.32 * r, paint.plain(1)),
    ]
    return [_solid(surfaces, size, 0.8)]


def _vase(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    belly, neck = paint.rng.uniform(0.28, 0.6), paint.rng.uniform(0.4, 0.6)
    height = np.linspace(1, 0, 8)
    swell = np.exp(-(((height - belly) / 0.3) ** 2))
    radius = r * np.clip(neck + (1 - neck) * swell + 0.25 * (height > 0.97), 0.3, 1.0)
    skin = paint.image(paint.decoration, 2 * np.pi * r, h)
    rim = float(radius[0])
    surfaces = [
        revolve(list(zip(radius, height * h, strict=True)), skin),
        revolve([(0.7 * rim, 0.8 * h), (rim, h)], paint.plain(0, 0.5)),
        disc((0, 0, 0.8 * h), 0.72 * rim, paint.plain(0, 0.25)),
    ]
    return [_solid(surfaces, size, 0.7)]


def _plant(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r, pot = 0.3 * w, 0.36 * h
    rng = paint.rng
    green = [(rng.uniform(40, 95), rng.uniform(105, 165), rng.uniform(40, 80))]
    earth = textures.blotches(rng, 24, 24, [(70, 52, 40), (92, 70, 50), (50, 38, 30)])
    surfaces = [
        revolve([(r, pot), (0.72 * r, 0.0)], paint.image(paint.decoration, 2 * np.pi * r, pot)),
        disc((0, 0, 0.96 * pot), 0.97 * r, earth),
    ]
    num = int(rng.integers(8, 12))
    for index in range(num):
        angle = 2 * np.pi * index / num + rng.uniform(-0.3, 0.3)
        reach, rise = rng.uniform(0.28, 0.5) * w, rng.uniform(0.6, 1.0) * (h - pot)
        step = np.linspace(1, 0, 4)
        spine = np.stack([0.05 * w + reach * step**1.4, 0 * step, pot + rise * step**0.8], 1)
        half = 0.16 * w * np.array([0.12, 0.8, 1.0, 0.25])
        sheet = np.stack([spine, spine], 1)
        sheet[:, 0, 1], sheet[:, 1, 1] = -half, half
        leaf = Surface(
            sheet, textures.stripes(rng, 48, 24, [green[0], (60, 120, 55), (95, 150, 80)])
        )
        surfaces.extend(both_sides(leaf.moved((0, 0, 0), angle)))
    return [_solid(surfaces, size, 0.6)]


def _lamp(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    shade = paint.image(paint.decoration, np.pi * w, 0.45 * h)
    surfaces = [
        revolve([(0.62 * r, h), (r, 0.55 * h)], shade),
        revolve([(0.98 * r, 0.55 * h), (0.6 * r, h)], paint.plain(3)),
        disc((0, 0, 0.98 * h), 0.61 * r, paint.plain(0)),
        revolve([(0.1 * r, 0.75 * h), (0.12 * r, 0.08 * h), (0.6 * r, 0.05 * h)], paint.plain(1)),
        revolve([(0.6 * r, 0.05 * h), (0.62 * r, 0.0)], paint.plain(2)),
    ]
    return [_solid(surfaces, size, 0.6)]


def _ball(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    return [_solid([_sphere(w / 2, h, paint.image(paint.decoration, 1.5 * w, h))], size, 0.75)]


def _teapot(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = 0.31 * w
    skin = paint.image(paint.decoration, 2 * np.pi * r, h)
    body = [(0.45, 0.8), (0.8, 0.68), (1.0, 0.42), (0.9, 0.16), (0.6, 0.0)]
    spout = np.array([[1.55, 0, 0.78], [1.3, 0, 0.55], [0.85, 0, 0.3]]) * (r, 1, h)
    surfaces = [
        revolve([(r * x, h * z) for x, z in body], skin),
        revolve([(0.0, 0.9 * h), (0.3 * r, 0.86 * h), (0.5 * r, 0.79 * h)], paint.plain(1)),
        _sphere(0.14 * r, 0.12 * h, paint.plain(2), 8, 5).moved((0, 0, 0.88 * h), 0),
        tube(spout, np.array([0.1, 0.14, 0.24]) * r, paint.plain(0)),
        tube(_arc((-0.9 * r, 0.42 * h), (0.6 * r, 0.27 * h), (75, 285)), 0.1 * r, paint.plain(1)),
    ]
    return [_solid(surfaces, (2 * r, 2 * r, h))]


def _monitor(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    shell = textures.plain(paint.rng, 24, 24, [(44, 45, 48)])
    panel = box(
        (w, 0.22 * d, 0.78 * h),
        {"front": paint.image(textures.screen, w, 0.78 * h), "rest": shell},
        (0, 0, 0.61 * h),
    )
    neck = box((0.12 * w, 0.2 * d, 0.3 * h), {"rest": shell}, (0, 0.12 * d, 0.17 * h))
    return [panel, neck, box((0.42 * w, d, 0.03 * h), {"rest": shell}, (0, 0, 0.015 * h))]


def _toy_cube(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    sides = ("front", "back", "left", "right", "top")
    images = {side: paint.image(textures.cube_faces, size[0], size[2]) for side in sides}
    return [box(size, images, (0, 0, size[2] / 2))]


def _picture(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    edge = 0.07 * min(w, h)
    frame = paint.plain(1)
    panel = box(size, {"front": frame, "rest": frame}, (0, -d / 2, 0))
    canvas = box(
        (w - 2 * edge, d, h - 2 * edge),
        {"front": paint.image(textures.painting, w, h)},
        (0, -d / 2 - 0.004, 0),
    )
    return [Part(panel.surfaces + canvas.surfaces, panel.center_m, panel.half_m)]


def _clock(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, _ = size
    rim = revolve([(w / 2, d), (w / 2, 0.0)], paint.plain(0), 20)
    points = rim.points @ np.array([[1.0, 0, 0], [0, 0, 1.0], [0, -1.0, 0]])
    face = disc((0, -d, 0), w / 2, paint.image(textures.clock_face, w, w), "front", 20)
    surfaces = (dataclasses.replace(rim, points=points), face)
    return [Part(surfaces, np.array([0, -d / 2, 0]), np.array([0.4 * w, d / 2, 0.4 * w]))]


def _chair(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, d, h = size
    leg, seat = 0.05, 0.5 * h
    wood = paint.image(textures.wood, 0.3, 0.1)
    cloth = paint.image(paint.decoration, w, d)
    parts = [box((w, d, 0.05), {"rest": wood, "top": cloth}, (0, 0, seat))]
    back = {"rest": wood, "front": paint.image(paint.decoration, w, 0.3 * h)}
    parts.append(box((w, 0.035, 0.34 * h), back, (0, d / 2 - 0.02, 0.83 * h)))
    for x in (-1, 1):
        for y in (-1, 1):
            top = h if y > 0 else seat
            foot = (x * (w - leg) / 2, y * (d - leg) / 2, top / 2)
            parts.append(box((leg, leg, top), {"rest": wood}, foot))
    return parts


def _bin(paint: _Paint, size: tuple[float, float, float]) -> list[Part]:
    w, _, h = size
    r = w / 2
    surfaces = [
        revolve([(r, h), (0.76 * r, 0.0)], paint.image(paint.decoration, np.pi * w, h), 18),
        revolve([(0.74 * r, 0.04 * h), (0.96 * r, h)], paint.plain(0, 0.6), 18),
        revolve([(0.96 * r, h), (r, h)], paint.plain(1), 18),
        disc((0, 0, 0.04 * h), 0.76 * r, paint.plain(0, 0.4)),
    ]
    return [_solid(surfaces, size)]


CLASSES: dict[str, ObjectClass] = {
    "mug": ObjectClass((0.15, 0.11, 0.13), "surface", _mug),
    "box": ObjectClass((0.2, 0.1, 0.28), "surface", _box),
    "book": ObjectClass((0.19, 0.045, 0.27), "surface", _book),
    "can": ObjectClass((0.11, 0.11, 0.16), "surface", _can),
    "bottle": ObjectClass((0.11, 0.11, 0.33), "surface", _bottle),
    "bowl": ObjectClass((0.24, 0.24, 0.11), "surface", _bowl),
    "vase": ObjectClass((0.17, 0.17, 0.32), "surface", _vase),
    "plant": ObjectClass((0.34, 0.34, 0.42), "surface", _plant),
    "lamp": ObjectClass((0.24, 0.24, 0.44), "surface", _lamp),
    "ball": ObjectClass((0.2, 0.2, 0.2), "surface", _ball),
    "teapot": ObjectClass((0.3, 0.19, 0.2), "surface", _teapot),
    "monitor": ObjectClass((0.5, 0.18, 0.4), "surface", _monitor),
    "toy_cube": ObjectClass((0.12, 0.12, 0.12), "surface", _toy_cube),
    "picture": ObjectClass((0.55, 0.03, 0.42), "wall", _picture),
    "clock": ObjectClass((0.32, 0.05, 0.32), "wall", _clock),
    "chair": ObjectClass((0.44, 0.44, 0.9), "floor", _chair),
    "bin": ObjectClass((0.3, 0.3, 0.36), "floor", _bin),
}
