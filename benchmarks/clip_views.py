"""Clips of `realvideo.py` as other cameras and detectors would give them, the truth still known.

    python benchmarks/clip_views.py CLIPS OUT [KIND ...]   writes a set of clips into OUT per kind
    python benchmarks/realvideo.py OUT/walk                as any set of clips

A window that pans (curve, curve_2, walk, steps), or nears and withdraws (zoom, zoom_fast); a camera
that rolls, shakes, or lies on its side; half of the resolution; every second, third or fifth frame;
a detector with rough masks, that misses things, that sees some that are not there, or that confuses
names. Detections are cut off with what is seen, and left out where little is left of them.
"""

from __future__ import annotations

import argparse
import gzip
import json
import random
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from hotcoco import mask as coco
from jaxtyping import Float, UInt8

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.clip_orders import pictures
from benchmarks.clips import Clip, find_clips
from remind_jax.masks.run_length import encode_masks

LEAST_PX, LEAST_SHARE = 40, 0.04  # of a detection that is left: pixels, and part of what was seen
NAMES = ("person", "chair", "bottle", "tv", "cup")
STRIDES = {"every_second": 2, "every_third": 3, "every_fifth": 5}

# Where the pixels of a frame come to lie, `[2, 3]`, and the width and height of what is seen.
View = tuple[Float[np.ndarray, "2 3"], tuple[int, int]]
Shown = list[tuple[dict[str, Any], int]]  # detections and their true objects


def window(size: tuple[int, int], x: float, y: float, width: float) -> View:
    """A part of the frame about a point, in shares of the frame, as large as the frame."""
    across, down = size
    left = min(max(x - width / 2, 0.0), 1.0 - width) * across
    top = min(max(y - width / 2, 0.0), 1.0 - width) * down
    scale = 1.0 / width
    return np.array([[scale, 0.0, -left * scale], [0.0, scale, -top * scale]]), size


def column(size: tuple[int, int], x: float) -> View:
    """Half of the width about a place, in shares of the frame."""
    width = size[0] // 2
    return np.array([[1.0, 0.0, width / 2 - x * size[0]], [0.0, 1.0, 0.0]]), (width, size[1])


def turned(size: tuple[int, int], degrees: float, shift: Any = 0.0, zoom: float = 1.0) -> View:
    """The frame turned about its middle."""
    matrix = cv2.getRotationMatrix2D((size[0] / 2, size[1] / 2), degrees, zoom)
    matrix[:, 2] += shift
    return matrix, size


def wave(turns: float) -> float:
    return float(np.sin(2 * np.pi * turns))


def step_to(part: float) -> tuple[float, float]:
    """From point to point with a rest at each."""
    chance = random.Random(5)
    points = [(chance.uniform(0.3, 0.7), chance.uniform(0.3, 0.7)) for _ in range(9)]
    number = min(int(part * 8), 7)
    along = min(1.0, max(0.0, (part * 8 - number) * 2 - 0.5))
    along *= along * (3 - 2 * along)
    here, there = np.array(points[number]), np.array(points[number + 1])
    x, y = (here + (there - here) * along).tolist()
    return x, y


# By kind: what is seen of a frame of a size at a part of the clip.
VIEWS: dict[str, Callable[[tuple[int, int], float, np.random.Generator], View]] = {
    "curve": lambda size, t, _: window(
        size, 0.5 + 0.2 * wave(2 * t), 0.5 + 0.2 * wave(1.3 * t + 0.16), 0.6
    ),
    "curve_2": lambda size, t, _: window(
        size, 0.5 + 0.2 * wave(3.1 * t + 0.32), 0.5 + 0.2 * wave(1.7 * t + 0.25), 0.6
    ),
    "walk": lambda size, t, _: column(size, 0.5 - 0.25 * wave(2 * t + 0.25)),
    "steps": lambda size, t, _: window(size, *step_to(t), 0.6),
    "zoom": lambda size, t, _: window(
        size, 0.5 + 0.2 * wave(1.3 * t), 0.5, 0.725 + 0.275 * wave(2.5 * t + 0.25)
    ),
    "zoom_fast": lambda size, t, _: window(
        size, 0.5 + 0.25 * wave(2.3 * t), 0.5, 0.7 + 0.3 * wave(6 * t + 0.25)
    ),
    "roll": lambda size, t, _: turned(size, 15 * wave(3 * t)),
    "shake": lambda size, _, rng: turned(
        size, rng.normal(0, 0.8), rng.normal(0, 0.012 * size[0], 2), 1.06
    ),
    "on_its_side": lambda size, *_: (
        np.array([[0.0, -1.0, size[1] - 1.0], [1.0, 0.0, 0.0]]), (size[1], size[0])
    ),
    "half": lambda size, *_: (np.eye(2, 3) / 2, (size[0] // 2, size[1] // 2)),
}  # fmt: skip


def see(view: View, shown: Shown) -> Shown:
    """The detections as far as they are seen."""
    matrix, size = view
    scale = abs(np.linalg.det(matrix[:, :2]))
    found = []
    for one, label in shown:
        mask = decode(one)
        seen = cv2.warpAffine(255 * mask, matrix, size) > 127
        if seen.sum() >= max(LEAST_PX * min(1.0, scale), LEAST_SHARE * mask.sum() * scale):
            found.append((with_mask(one, seen), label))
    return found


def roughen(shown: Shown, chance: random.Random) -> Shown:
    """Masks that are up to five pixels too large or too small."""
    found = []
    for one, label in shown:
        radius = chance.randint(-5, 5)
        brush = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * abs(radius) + 1,) * 2)
        mask = (cv2.dilate if radius > 0 else cv2.erode)(decode(one), brush)
        found.append((with_mask(one, mask > 0) if mask.sum() >= LEAST_PX else one, label))
    return found


def rename(shown: Shown, chance: random.Random) -> Shown:
    """One of seven detections has any name."""
    return [
        ({**one, "label": chance.choice(NAMES)} if chance.random() < 0.15 else one, label)
        for one, label in shown
    ]


def add_false(shown: Shown, chance: random.Random) -> Shown:
    """In a third of the frames something is seen that is not there."""
    if chance.random() > 0.3 or not shown:
        return shown
    height, width = shown[0][0]["segmentation"]["size"]
    mask = np.zeros((height, width), np.uint8)
    center = chance.randint(40, width - 50), chance.randint(40, height - 50)
    cv2.ellipse(mask, center, (chance.randint(12, 40), chance.randint(12, 40)), 0, 0, 360, 1, -1)
    false = {"label": chance.choice(NAMES), "score": 0.3, "segmentation": None}
    return [*shown, (with_mask(false, mask > 0), 0)]


def misses(chance: random.Random) -> Callable[[Shown, random.Random], Shown]:
    """A detector that now and then misses a thing for up to eight frames."""
    left: dict[int, int] = {}

    def miss(shown: Shown, _: random.Random) -> Shown:
        found = []
        for one, label in shown:
            if left.get(label, 0):
                left[label] -= 1
            elif chance.random() < 0.06:
                left[label] = chance.randint(0, 7)
            else:
                found.append((one, label))
        return found

    return miss


DETECTORS: dict[str, Callable[[random.Random], Callable[[Shown, random.Random], Shown]]] = {
    "rough": lambda _: roughen,
    "names": lambda _: rename,
    "false": lambda _: add_false,
    "missing": misses,
}
KINDS = (*VIEWS, *STRIDES, *DETECTORS)


def decode(one: dict[str, Any]) -> UInt8[np.ndarray, "H W"]:
    code = one["segmentation"]
    return np.asarray(
        coco.decode({"size": code["size"], "counts": code["counts"].encode()}), np.uint8
    )


def with_mask(one: dict[str, Any], mask: np.ndarray) -> dict[str, Any]:
    (code,) = encode_masks(mask[None])
    return {**one, "segmentation": {"size": code["size"], "counts": code["counts"].decode()}}


def frames_of(clip: Clip, kind: str) -> Iterator[tuple[Path | np.ndarray, Shown]]:
    """Frames, as files where they stay what they are, with their detections."""
    files, chance, rng = pictures(clip), random.Random(7), np.random.default_rng(7)
    change = DETECTORS[kind](chance) if kind in DETECTORS else None
    kept = range(0, len(files), STRIDES.get(kind, 1))
    for place, index in enumerate(kept):
        shown = [*zip(clip.lines[index]["detections"], clip.labels[index], strict=True)]
        if kind not in VIEWS:
            yield files[index], shown if change is None else change(shown, chance)
            continue
        image = cv2.imread(str(files[index]))
        assert image is not None
        view = VIEWS[kind]((image.shape[1], image.shape[0]), place / len(kept), rng)
        if kind == "half":
            yield cv2.resize(image, view[1], interpolation=cv2.INTER_AREA), see(view, shown)
        else:
            image = cv2.warpAffine(image, *view, borderMode=cv2.BORDER_REFLECT)
            yield image, see(view, shown)


def write(clip: Clip, kind: str, folder: Path) -> None:
    """A clip as of a kind, with links to frames that stay what they are."""
    images = folder / "JPEGImages" / folder.name
    images.mkdir(parents=True)
    lines, labels = [], []
    for number, (image, shown) in enumerate(frames_of(clip, kind)):
        file = images / f"{number:05d}.jpg"
        if isinstance(image, Path):
            file.symlink_to(image.resolve())
        else:
            cv2.imwrite(str(file), image, [cv2.IMWRITE_JPEG_QUALITY, 85])
        lines.append({"frame": number, "detections": [one for one, _ in shown]})
        labels.append([label for _, label in shown])
    packed = gzip.compress("\n".join(map(json.dumps, lines)).encode(), mtime=0)
    (folder / "detections.jsonl.gz").write_bytes(packed)
    told = {"labels_of_detections": labels, "id_to_class": clip.class_of}
    (folder / "metadata.json").write_text(json.dumps(told))


def main() -> None:
    """Parses the command line and writes the sets."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("clips", type=Path, metavar="CLIPS")
    parser.add_argument("out", type=Path, metavar="OUT")
    parser.add_argument(
        "kinds", nargs="*", metavar="KIND", help=f"of {', '.join(KINDS)}; all if none"
    )
    options = parser.parse_args()
    if unknown := set(options.kinds) - {*KINDS}:
        parser.error(f"unknown kinds: {', '.join(sorted(unknown))}; choose from {', '.join(KINDS)}")
    for kind in options.kinds or KINDS:
        for clip in find_clips(options.clips):
            write(clip, kind, options.out / kind / f"{clip.name}_{kind}")


if __name__ == "__main__":
    main()
