"""Procedural textures: uint8 RGB images, each a pure function of a generator and a size.

Colors are display values (gamma 2), so that light enters as a factor of its square root.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import cv2
import numpy as np
from jaxtyping import Float, UInt8

Image = UInt8[np.ndarray, "h w 3"]
Color = tuple[float, float, float]
Pattern = Callable[[np.random.Generator, int, int, Sequence[Color]], Image]


def draw_palette(rng: np.random.Generator) -> list[Color]:
    """A main color and partners that contrast with it in hue or in brightness."""
    hue = rng.uniform(0, 180)
    saturation, value = rng.uniform(90, 215), rng.uniform(110, 225)
    colors = [_from_hsv(hue, saturation, value)]
    for index in range(3):
        partner_hue = hue + rng.choice([0.0, 25.0, 80.0, 95.0]) + rng.uniform(-8, 8)
        bright = value > 165
        partner_value = (
            rng.uniform(35, 110) if (index % 2 == 0) == bright else rng.uniform(180, 245)
        )
        colors.append(_from_hsv(partner_hue, rng.uniform(20, 220), partner_value))
    return colors


def shift_hue(image: Image, shift_deg: float) -> Image:
    """Turns all hues by an angle; grays stay gray."""
    if shift_deg == 0.0:
        return image
    hsv = cv2.cvtColor(image, cv2.COLOR_RGB2HSV_FULL).astype(np.int32)
    hsv[..., 0] = (hsv[..., 0] + round(shift_deg / 360 * 256)) % 256
    return cv2.cvtColor(hsv.astype(np.uint8), cv2.COLOR_HSV2RGB_FULL)


def fractal_noise(
    rng: np.random.Generator, height: int, width: int, cells: float, octaves: int = 4
) -> Float[np.ndarray, "h w"]:
    """Smooth noise of mean about 0 and range about [-1, 1]; `cells` bumps along the long side."""
    total = np.zeros((height, width), np.float32)
    amplitude = 0.6
    for octave in range(octaves):
        step = cells * 2**octave / max(height, width)
        size = (max(2, round(width * step) + 1), max(2, round(height * step) + 1))
        grid = rng.uniform(-1, 1, size[::-1]).astype(np.float32)
        total += amplitude * cv2.resize(grid, (width, height), interpolation=cv2.INTER_CUBIC)
        amplitude *= 0.5
    return total


def plain(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """One color with slight wear."""
    return _wear(rng, _fill(height, width, colors[0]), 7)


def stripes(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Bands of irregular width, along or across."""
    image = _fill(height, width, colors[0])
    across = bool(rng.integers(2))
    length = width if across else height
    at = rng.uniform(0, 0.1) * length
    while at < length:
        band = rng.uniform(0.05, 0.16) * length
        color = colors[int(rng.integers(1, len(colors)))]
        span = slice(int(at), int(at + band))
        if across:
            image[:, span] = color
        else:
            image[span] = color
        at += band + rng.uniform(0.05, 0.2) * length
    return _wear(rng, image, 6)


def dots(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Staggered dots."""
    image = _fill(height, width, colors[0])
    pitch = rng.uniform(0.18, 0.3) * min(height, width)
    radius = max(2, round(pitch * rng.uniform(0.22, 0.36)))
    for row, y in enumerate(np.arange(pitch / 2, height, pitch)):
        for x in np.arange(pitch / 2 * (1 + row % 2), width + pitch, pitch):
            color = colors[1 + row % (len(colors) - 1)]
            cv2.circle(image, (round(x), round(y)), radius, color, -1, cv2.LINE_AA)
    return _wear(rng, image, 6)


def checks(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A woven check of see-through bands."""
    image = _fill(height, width, colors[0]).astype(np.float32)
    pitch = max(6, round(rng.uniform(0.2, 0.34) * min(height, width)))
    share = rng.uniform(0.35, 0.55)
    columns = np.arange(width) % pitch < share * pitch
    rows = np.arange(height) % pitch < share * pitch
    image[:, columns] = 0.45 * image[:, columns] + 0.55 * np.asarray(colors[1], np.float32)
    image[rows] = 0.45 * image[rows] + 0.55 * np.asarray(colors[2], np.float32)
    return _wear(rng, image.astype(np.uint8), 6)


def blotches(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A running glaze: two colors divided by a noisy border, with specks."""
    noise = fractal_noise(rng, height, width, rng.uniform(3, 6))
    image = _fill(height, width, colors[0])
    image[noise > 0.08] = colors[1]
    image[np.abs(noise - 0.08) < 0.04] = colors[2]
    return _wear(rng, image, 8)


def flowers(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Scattered five-petalled blossoms."""
    image = _fill(height, width, colors[0])
    side = min(height, width)
    for _ in range(max(6, int(14 * width / height))):
        center = rng.uniform(0, (width, height))
        radius = side * rng.uniform(0.06, 0.13)
        color = colors[int(rng.integers(1, len(colors)))]
        for angle in np.arange(5) * 2 * np.pi / 5 + rng.uniform(0, 2):
            petal = center + radius * np.array([np.cos(angle), np.sin(angle)])
            cv2.circle(image, _pixel(petal), max(1, round(radius * 0.62)), color, -1, cv2.LINE_AA)
        core = max(1, round(radius * 0.5))
        cv2.circle(image, _pixel(center), core, colors[0][::-1], -1, cv2.LINE_AA)
    return _wear(rng, image, 6)


def label(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Packaging: a field, an emblem, a big word and lines of small print."""
    image = _fill(height, width, colors[0])
    band = rng.uniform(0.08, 0.5)
    depth = rng.uniform(0.18, 0.34)
    image[int(band * height) : int((band + depth) * height)] = colors[1]
    emblem = (round(rng.uniform(0.3, 0.7) * width), round(rng.uniform(0.5, 0.78) * height))
    axes = (round(rng.uniform(0.14, 0.28) * width), round(rng.uniform(0.09, 0.18) * height))
    tilt = rng.uniform(-30, 30)
    cv2.ellipse(image, emblem, axes, tilt, 0, 360, colors[2], -1, cv2.LINE_AA)
    inner = (axes[0] // 2, axes[1] // 2)
    cv2.ellipse(image, emblem, inner, tilt, 0, 360, colors[3], -1, cv2.LINE_AA)
    _write_lines(rng, image, (band + 0.2 * depth) * height, 0.6 * depth * height, colors[3], 1)
    _write_lines(rng, image, 0.86 * height, 0.03 * height, colors[2], 3)
    return _wear(rng, image, 6)


def cover(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A book cover: picture, title, author."""
    image = _fill(height, width, colors[0])
    top = int(rng.uniform(0.3, 0.4) * height)
    inset = int(0.1 * width)
    picture = painting(rng, height - top - inset, width - 2 * inset, colors)
    image[top : height - inset, inset : width - inset] = picture
    _write_lines(rng, image, 0.1 * height, 0.09 * height, colors[1], 2)
    return _wear(rng, image, 5)


def painting(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A landscape or an abstract of overlapping shapes."""
    image = _fill(height, width, colors[0])
    if rng.integers(2):
        blend = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
        image[:] = (1 - blend) * np.asarray(colors[3], np.float32) + blend * np.asarray(
            colors[0], np.float32
        )
        sun = (round(rng.uniform(0.2, 0.8) * width), round(rng.uniform(0.15, 0.4) * height))
        cv2.circle(image, sun, max(2, round(0.1 * width)), colors[2], -1, cv2.LINE_AA)
        for ridge in range(3):
            color = tuple(np.array(colors[1 + ridge % 3]) * (0.9 - 0.2 * ridge))
            level = (0.45 + 0.2 * ridge) * height
            crest = level + 0.15 * height * fractal_noise(rng, 1, width, rng.uniform(2, 5))[0]
            points = np.stack([np.arange(width), crest], 1)
            outline = np.concatenate([points, [[width, height], [0, height]]]).astype(np.int32)
            cv2.fillPoly(image, [outline], color)
    else:
        for _ in range(9):
            corners = rng.uniform(0, (width, height)) + rng.uniform(-0.35, 0.35, (4, 2)) * width
            color = colors[int(rng.integers(1, len(colors)))]
            cv2.fillConvexPoly(image, cv2.convexHull(corners.astype(np.int32)), color, cv2.LINE_AA)
    return _wear(rng, image, 8)


def cube_faces(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Three by three stickers on black."""
    image = _fill(height, width, (18, 18, 18))
    pitch_y, pitch_x = height / 3, width / 3
    bright = [*colors, (235, 235, 230), (230, 190, 40)]
    for row in range(3):
        for column in range(3):
            y, x = int((row + 0.1) * pitch_y), int((column + 0.1) * pitch_x)
            color = bright[int(rng.integers(len(bright)))]
            image[y : int((row + 0.92) * pitch_y), x : int((column + 0.92) * pitch_x)] = color
    return image


def screen(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A monitor with windows on it."""
    image = _fill(height, width, tuple(0.35 * np.array(colors[0])))
    for _ in range(3):
        x, y = int(rng.uniform(0, 0.6) * width), int(rng.uniform(0, 0.6) * height)
        w, h = int(rng.uniform(0.25, 0.45) * width), int(rng.uniform(0.25, 0.5) * height)
        image[y : y + h, x : x + w] = tuple(0.8 * np.array(colors[3]))
        image[y : y + max(2, h // 8), x : x + w] = colors[1]
        _write_lines(rng, image[y : y + h, x : x + w], 0.25 * h, 0.05 * h, colors[2], 5)
    edge = max(2, width // 40)
    image[:edge] = image[-edge:] = image[:, :edge] = image[:, -edge:] = (12, 12, 13)
    return image


def clock_face(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A dial with twelve marks and two hands."""
    image = _fill(height, width, colors[0])
    center, radius = np.array([width, height]) / 2, min(height, width) / 2
    cv2.circle(image, _pixel(center), round(radius * 0.86), (238, 236, 228), -1, cv2.LINE_AA)
    for mark in range(12):
        way = np.array([np.cos(mark * np.pi / 6), np.sin(mark * np.pi / 6)])
        ends = center + 0.68 * radius * way, center + 0.8 * radius * way
        cv2.line(image, _pixel(ends[0]), _pixel(ends[1]), (30, 30, 30), 2, cv2.LINE_AA)
    for length, thickness in ((0.4, 4), (0.62, 2)):
        angle = rng.uniform(0, 2 * np.pi)
        tip = center + length * radius * np.array([np.cos(angle), np.sin(angle)])
        cv2.line(image, _pixel(center), _pixel(tip), (25, 25, 30), thickness, cv2.LINE_AA)
    return image


def wood(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Grain along the long side."""
    turned = height > width
    if turned:
        height, width = width, height
    across = np.linspace(0, rng.uniform(10, 18), height, dtype=np.float32)[:, None]
    bend = 1.6 * fractal_noise(rng, height, width, 2, 2)
    rings = np.sin(across + bend + 0.8 * fractal_noise(rng, height, width, 9, 2))
    fiber = cv2.resize(rng.uniform(-1, 1, (height, max(2, width // 14))), (width, height))
    factor = 1 + 0.09 * rings + 0.06 * fiber
    image = np.clip(np.asarray(colors[0], np.float32) * factor[..., None], 0, 255).astype(np.uint8)
    return np.ascontiguousarray(image.swapaxes(0, 1)) if turned else image


def planks(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """A floor of staggered boards; 200 texels are a meter."""
    image = np.zeros((height, width, 3), np.uint8)
    board = 28
    for y in range(0, height, board):
        x = -int(rng.integers(0, 160))
        while x < width:
            length = int(rng.integers(150, 260))
            shade = tuple(np.array(colors[0]) * rng.uniform(0.82, 1.12))
            piece = wood(rng, board, length, [shade])
            piece[0] = piece[:, 0] = (np.float32(piece[0, 0]) * 0.55).astype(np.uint8)
            left, right = max(x, 0), min(x + length, width)
            rows = min(board, height - y)
            if right > left:
                image[y : y + rows, left:right] = piece[:rows, left - x : right - x]
            x += length
    return image


def tiles(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Square floor tiles with joints; 200 texels are a meter."""
    pitch = int(rng.integers(62, 90))
    shape = (height // pitch + 1, width // pitch + 1)
    shades = 1 + rng.uniform(-0.07, 0.07, shape).astype(np.float32)
    factor = cv2.resize(shades, None, fx=pitch, fy=pitch, interpolation=cv2.INTER_NEAREST)
    factor = factor[:height, :width] * (1 + 0.05 * fractal_noise(rng, height, width, 14))
    image = np.clip(np.asarray(colors[0], np.float32) * factor[..., None], 0, 255).astype(np.uint8)
    joint = tuple(0.62 * np.array(colors[0]))
    for at in range(0, max(height, width), pitch):
        image[at : at + 2] = joint
        image[:, at : at + 2] = joint
    return image


def wallpaper(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Plaster, broad stripes or a small motif, with a skirting board at the foot."""
    image = _fill(height, width, colors[0])
    other = tuple(0.9 * np.array(colors[0]))
    style = int(rng.integers(3))
    pitch = int(rng.integers(36, 60))
    if style == 1:
        for x in range(0, width, 2 * pitch):
            image[:, x : x + pitch] = other
    elif style == 2:
        for row, y in enumerate(range(pitch // 2, height, pitch)):
            for x in range(pitch // 2 * (1 + row % 2), width, pitch):
                cv2.ellipse(image, (x, y), (5, 9), 0, 0, 360, other, -1, cv2.LINE_AA)
    mottled = image * (1 + 0.045 * fractal_noise(rng, height, width, 16))[..., None]
    image = np.clip(mottled, 0, 255).astype(np.uint8)
    image[-18:] = (214, 210, 202)
    image[-19] = (120, 116, 110)
    return image


def rug(rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]) -> Image:
    """Nested frames around a field."""
    image = _fill(height, width, colors[0])
    for ring in range(1, 7):
        inset = int(ring * 0.065 * min(height, width))
        image[inset : height - inset, inset : width - inset] = colors[ring % len(colors)]
    return _wear(rng, image, 18)


def view_outside(
    rng: np.random.Generator, height: int, width: int, colors: Sequence[Color]
) -> Image:
    """Sky over a line of trees, behind a window cross."""
    sky = np.linspace(0, 1, height, dtype=np.float32)[:, None, None]
    image = np.broadcast_to((150, 185, 235) + sky * (70, 50, 15), (height, width, 3)).astype(
        np.uint8
    )
    crest = (0.66 + 0.08 * fractal_noise(rng, 1, width, 8)[0]) * height
    image[np.arange(height)[:, None] > crest] = (70, 105, 62)
    bar = max(2, width // 40)
    for at in (0, width // 2 - bar // 2, width - bar):
        image[:, at : at + bar] = (225, 225, 222)
    for at in (0, height // 2 - bar // 2, height - bar):
        image[at : at + bar] = (225, 225, 222)
    return image


def _fill(height: int, width: int, color: Color) -> Image:
    return np.full((height, width, 3), np.clip(color, 0, 255), np.uint8)


def _wear(rng: np.random.Generator, image: Image, strength: float) -> Image:
    """Slow and fine variation of brightness, in gray levels."""
    height, width = image.shape[:2]
    noise = strength * fractal_noise(rng, height, width, 5, 5)[..., None]
    return np.clip(image + noise, 0, 255).astype(np.uint8)


def _write_lines(
    rng: np.random.Generator, image: Image, top: float, size: float, color: Color, num: int
) -> None:
    """Draws words of box-like letters; `top` and `size` in texels."""
    height, width = image.shape[:2]
    size = max(size, 2.0)
    for line in range(num):
        y0, y1 = int(top + 1.6 * line * size), int(top + 1.6 * line * size + size)
        x, end = 0.1 * width, rng.uniform(0.6, 0.92) * width
        while x < end and y1 < height:
            letter = size * rng.uniform(0.35, 0.75)
            rise = int(rng.integers(0, max(1, (y1 - y0) // 3) + 1))
            image[y0 + rise : y1, int(x) : int(min(x + letter, end))] = color
            x += letter + size * (0.2 if rng.uniform() < 0.8 else 0.7)


def _from_hsv(hue_half_deg: float, saturation: float, value: float) -> Color:
    hsv = [round(hue_half_deg) % 180, min(max(saturation, 0), 255), value]
    pixel = np.array(hsv).astype(np.uint8).reshape(1, 1, 3)
    red, green, blue = cv2.cvtColor(pixel, cv2.COLOR_HSV2RGB)[0, 0].tolist()
    return (red, green, blue)


def _pixel(point: Float[np.ndarray, "2"]) -> tuple[int, int]:
    return (round(float(point[0])), round(float(point[1])))
