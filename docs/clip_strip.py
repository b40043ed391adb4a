"""Draws frames of a real clip with the identities of the default tracker.

    python docs/clip_strip.py CLIP docs/figures/bottles.webp 20 60 110 150 250 285

CLIP: a folder as `benchmarks/realvideo.py` reads them; then the picture and the frames. Frames that
are shown beyond this repository need a license that allows it, and their attribution.
"""

from __future__ import annotations

import dataclasses
import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import UInt8

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import remind_jax as rj
from benchmarks.clips import find_clips
from benchmarks.realvideo import ANNOUNCE_AFTER
from remind_jax.masks.run_length import encode_masks

WIDTH_PX = 320
COLUMNS = 3
QUALITY = 75


def draw_small(image: UInt8[np.ndarray, "H W 3"], tracks: rj.Tracks) -> UInt8[np.ndarray, "h w 3"]:
    """The overlay of a frame, made small first so that its words stay large."""
    scale = WIDTH_PX / image.shape[1]
    size = WIDTH_PX, round(scale * image.shape[0])
    masks = [cv2.resize(mask.astype(np.uint8), size).astype(bool) for mask in tracks.masks]
    small = dataclasses.replace(
        tracks,
        rles=tuple(encode_masks(np.array(masks).reshape(-1, *size[::-1]))),
        boxes=scale * tracks.boxes,
        frame_size=size[::-1],
    )
    drawn = rj.draw(cv2.resize(image, size, interpolation=cv2.INTER_AREA), small)
    place = 6, size[1] - 8
    cv2.putText(drawn, f"frame {tracks.frame_index}", place, 0, 0.4, (255,) * 3, 1, cv2.LINE_AA)
    return np.pad(drawn, ((0, 4), (0, 4), (0, 0)), constant_values=255)


def main() -> None:
    """Writes the picture."""
    folder, target = Path(sys.argv[1]), Path(sys.argv[2])
    shown = [int(word) for word in sys.argv[3:]]
    (clip,) = find_clips(folder.parent, [folder.name])
    with tempfile.TemporaryDirectory() as scratch:
        source = clip.open(Path(scratch))
        images = {frame.index: np.asarray(frame.image) for frame in source if frame.index in shown}
        result = rj.run(clip.open(Path(scratch)), announce_after=ANNOUNCE_AFTER, progress=False)
    parts = [draw_small(images[index], result.tracks[index]) for index in shown]
    lines = [np.hstack(parts[at : at + COLUMNS]) for at in range(0, len(parts), COLUMNS)]
    strip = np.vstack(lines)[..., ::-1]
    cv2.imwrite(str(target), strip, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    print(f"{target}: {target.stat().st_size / 1000:.0f} kB, {strip.shape[1]}x{strip.shape[0]}")


if __name__ == "__main__":
    main()
