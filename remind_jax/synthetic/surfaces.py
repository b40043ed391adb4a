"""Textured surfaces and the solid primitives made of them.

A surface is a grid of points; its image is stretched over the grid. Seen from the side that it is
visible from, grid rows run downwards and columns to the right, as in the image.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from remind_jax.synthetic.textures import Image


@dataclasses.dataclass(frozen=True, eq=False)
class Surface:
    """A grid of `R x C` points, meters, with an image over it."""

    points: Float[np.ndarray, "R C 3"]
    image: Image
    outline: Float[np.ndarray, "K 2"] | None = None  # in [0, 1]^2 of a 2 x 2 grid: what to keep
    glow: float = 0.0  # own light, relative to a lamp-lit wall; 0: lit by others

    def moved(self, position_m: Sequence[float], yaw_rad: float) -> Surface:
        """The surface turned about the vertical, then shifted."""
        points = turn(self.points, yaw_rad) + np.asarray(position_m)
        return dataclasses.replace(self, points=points)


@dataclasses.dataclass(frozen=True, eq=False)
class Part:
    """Surfaces that together throw the shadow of one upright block."""

    surfaces: tuple[Surface, ...]
    center_m: Float[np.ndarray, "3"]
    half_m: Float[np.ndarray, "3"]  # half the block's size; zeros: throws no shadow
    yaw_rad: float = 0.0

    def moved(self, position_m: Sequence[float], yaw_rad: float) -> Part:
        """The part turned about the vertical through the origin, then shifted."""
        return Part(
            tuple(surface.moved(position_m, yaw_rad) for surface in self.surfaces),
            turn(self.center_m, yaw_rad) + np.asarray(position_m),
            self.half_m,
            self.yaw_rad + yaw_rad,
        )


def turn(points: Float[np.ndarray, "*n 3"], yaw_rad: float) -> Float[np.ndarray, "*n 3"]:
    """Turns points counter-clockwise about the vertical."""
    cos, sin = np.cos(yaw_rad), np.sin(yaw_rad)
    return np.asarray(points) @ np.array([[cos, sin, 0.0], [-sin, cos, 0.0], [0.0, 0.0, 1.0]])


def quad(
    corner: Sequence[float],
    right: Sequence[float],
    down: Sequence[float],
    image: Image,
    glow: float = 0.0,
) -> Surface:
    """A parallelogram from its upper left corner and two edges, as seen from its front."""
    upper = np.array([corner, np.add(corner, right)], float)
    return Surface(np.stack([upper, upper + np.array(down)]), image, glow=glow)


def box(
    size_m: Sequence[float], images: Mapping[str, Image], center_m: Sequence[float] = (0, 0, 0)
) -> Part:
    """A block; `images` by side (`front`, `back`, `left`, `right`, `top`, `bottom`, or `rest`)."""
    w, d, h = size_m
    x, y, z = np.array(center_m) + np.array(size_m) / 2
    sides = {
        "front": ((x - w, y - d, z), (w, 0, 0), (0, 0, -h)),
        "back": ((x, y, z), (-w, 0, 0), (0, 0, -h)),
        "right": ((x, y - d, z), (0, d, 0), (0, 0, -h)),
        "left": ((x - w, y, z), (0, -d, 0), (0, 0, -h)),
        "top": ((x - w, y, z), (w, 0, 0), (0, -d, 0)),
        "bottom": ((x - w, y - d, z - h), (w, 0, 0), (0, d, 0)),
    }
    rest = images.get("rest")
    surfaces = [
        quad(corner, right, down, image)
        for side, (corner, right, down) in sides.items()
        if (image := images.get(side, rest)) is not None
    ]
    return Part(tuple(surfaces), np.array(center_m, float), np.array(size_m, float) / 2)


def revolve(
    profile_m: Sequence[tuple[float, float]],
    image: Image,
    num_sides: int = 16,
) -> Surface:
    """A surface of revolution about a vertical axis.

    Args:
      profile_m: Pairs of radius and height. Listed from the top down the outside is visible, from
        the bottom up the inside.
    """
    radius, z = np.array(profile_m, float).T
    angle = np.pi / 2 + np.linspace(0, 2 * np.pi, num_sides + 1)
    x, y = radius[:, None] * np.cos(angle), radius[:, None] * np.sin(angle)
    return Surface(np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], -1), image)


def disc(
    center_m: Sequence[float], radius_m: float, image: Image, facing: str = "up", sides: int = 16
) -> Surface:
    """A flat round face; `facing` is `up`, `down` or `front`."""
    x, y, z = center_m
    r = radius_m
    square = {
        "up": ((x - r, y + r, z), (2 * r, 0, 0), (0, -2 * r, 0)),
        "down": ((x - r, y - r, z), (2 * r, 0, 0), (0, 2 * r, 0)),
        "front": ((x - r, y, z + r), (2 * r, 0, 0), (0, 0, -2 * r)),
    }[facing]
    angle = np.linspace(0, 2 * np.pi, sides, endpoint=False)
    outline = 0.5 + 0.5 * np.stack([np.cos(angle), np.sin(angle)], 1)
    corner, right, down = square
    return dataclasses.replace(quad(corner, right, down, image), outline=outline)


def tube(
    path_m: Float[np.ndarray, "R 3"],
    radius_m: Float[np.ndarray, "R"] | float,
    image: Image,
) -> Surface:
    """A round tube along a path in a vertical plane `y = const` (handles, spouts, stems)."""
    path = np.asarray(path_m, float)
    along = np.gradient(path, axis=0)
    along /= np.linalg.norm(along, axis=1, keepdims=True)
    aside = np.array([0.0, 1.0, 0.0])
    other = np.cross(aside, along)
    angle = np.linspace(0, 2 * np.pi, 7)[None, :, None]
    ring = np.cos(angle) * aside + np.sin(angle) * other[:, None]
    radius = np.broadcast_to(np.asarray(radius_m, float), len(path))
    return Surface(path[:, None] + radius[:, None, None] * ring, image)


def both_sides(surface: Surface) -> tuple[Surface, Surface]:
    """A thin sheet: the surface and its reverse."""
    reverse = dataclasses.replace(
        surface, points=surface.points[:, ::-1], image=np.ascontiguousarray(surface.image[:, ::-1])
    )
    return surface, reverse
