"""Clips of `realvideo.py` in other orders and light: new recordings of which the truth is known.

    python benchmarks/clip_orders.py CLIPS OUT        writes the sets below into OUT
    python benchmarks/realvideo.py OUT/interleaved    as any set of clips

backwards: the last frame first. shuffled: five parts in another order, in two ways. interleaved:
the first half of a clip and that of another one, then the rest of both, with gray frames between,
for every two clips of one frame size: who comes back was away in another scene. light: each fifth
in a light of its own, of another color, brightness and contrast.
"""

from __future__ import annotations

import argparse
import gzip
import itertools
import json
import random
import sys
from collections.abc import Sequence
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.clips import Clip, find_clips

PARTS, SEEDS = 5, (1, 2)
# Of the lights: brightness, what each color has beside it, and contrast.
BRIGHTNESS, TINT, CONTRAST = (0.6, 1.2), (0.75, 1.2), (0.75, 1.4)
GRAY_FRAMES, GRAY = 15, 128
_LABELS = 1000  # objects of a clip have numbers below

# A stretch of a clip: its frames in order; None stands for gray frames.
Stretch = tuple[Clip, Sequence[int]] | None


def main() -> None:
    """Parses the command line and writes all sets."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("clips", type=Path, metavar="CLIPS")
    parser.add_argument("out", type=Path, metavar="OUT")
    options = parser.parse_args()
    clips, out = find_clips(options.clips), options.out
    for clip in clips:
        num = len(clip.lines)
        write(out / "backwards" / f"{clip.name}_backwards", [(clip, range(num)[::-1])])
        for seed in SEEDS:
            bounds = [num * part // PARTS for part in range(PARTS + 1)]
            parts = [range(*pair) for pair in itertools.pairwise(bounds)]
            random.Random(seed).shuffle(parts)
            name = f"{clip.name}_shuffled_{seed}"
            write(out / "shuffled" / name, [(clip, part) for part in parts])
            folder = out / "light" / f"{clip.name}_light_{seed}"
            write(folder, [(clip, range(num))])
            relight(folder, random.Random(seed))
    for one, other in itertools.permutations(clips, 2):
        if frame_size(one) == frame_size(other):
            first, last = zip(halves(one), halves(other), strict=True)
            stretches = [first[0], None, first[1], None, last[0], None, last[1]]
            write(out / "interleaved" / f"{one.name}_{other.name}", stretches)


def pictures(clip: Clip) -> list[Path]:
    """Its frames as files."""
    return sorted((clip.folder / "JPEGImages" / clip.name).iterdir())


def frame_size(clip: Clip) -> tuple[int, ...]:
    """Height and width."""
    image = cv2.imread(str(pictures(clip)[0]))
    assert image is not None
    return image.shape[:2]


def halves(clip: Clip) -> tuple[Stretch, Stretch]:
    """The frames of each half."""
    num = len(clip.lines)
    return (clip, range(num // 2)), (clip, range(num // 2, num))


def write(folder: Path, stretches: Sequence[Stretch]) -> None:
    """A clip of stretches of others, with links to their frames."""
    images = folder / "JPEGImages" / folder.name
    images.mkdir(parents=True)
    clips = list({one[0].name: one[0] for one in stretches if one is not None}.values())
    offset = {clip.name: _LABELS * number for number, clip in enumerate(clips)}
    lines: list[dict[str, object]] = []
    labels: list[list[int]] = []
    for stretch in stretches:
        if stretch is None:
            gray = np.full((*frame_size(clips[0]), 3), GRAY, np.uint8)
            for _ in range(GRAY_FRAMES):
                cv2.imwrite(str(images / f"{len(lines):05d}.jpg"), gray)
                lines.append({"frame": len(lines), "detections": []})
                labels.append([])
            continue
        clip, frames = stretch
        files = pictures(clip)
        for index in frames:
            (images / f"{len(lines):05d}.jpg").symlink_to(files[index].resolve())
            lines.append({**clip.lines[index], "frame": len(lines)})
            labels.append([one and one + offset[clip.name] for one in clip.labels[index]])
    classes = {
        number + offset[clip.name]: name for clip in clips for number, name in clip.class_of.items()
    }
    packed = gzip.compress("\n".join(map(json.dumps, lines)).encode(), mtime=0)
    (folder / "detections.jsonl.gz").write_bytes(packed)
    told = {"labels_of_detections": labels, "id_to_class": classes}
    (folder / "metadata.json").write_text(json.dumps(told))


def relight(folder: Path, chance: random.Random) -> None:
    """Replaces the links to frames by these in other lights, the first one as it is."""
    files = sorted((folder / "JPEGImages" / folder.name).iterdir())
    lights = [(np.ones(3), 1.0)]
    for _ in range(PARTS - 1):
        brightness = chance.uniform(*BRIGHTNESS)
        colors = np.array([brightness * chance.uniform(*TINT) for _ in range(3)])
        lights.append((colors, chance.uniform(*CONTRAST)))
    for number, file in enumerate(files):
        colors, contrast = lights[number * PARTS // len(files)]
        image = cv2.imread(str(file))
        assert image is not None
        seen = np.clip((image / 255.0) ** contrast * colors, 0.0, 1.0)
        file.unlink()
        cv2.imwrite(str(file), np.round(255 * seen).astype(np.uint8))


if __name__ == "__main__":
    main()
