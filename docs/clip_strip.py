"""Draws frames of a real clip with the identities of the default tracker, side by side.

    python docs/clip_strip.py CLIP docs/figures/bottles.webp 20 70 110 150 190 250 285

CLIP: a folder as `benchmarks/realvideo.py` reads them; then the picture and the frames. Frames that
are shown beyond this repository need a license that allows it, and their attribution.
"""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

import cv2
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import remind_jax as rj
from benchmarks.realvideo import ANNOUNCE_AFTER, find_clips

WIDTH_PX = 300
QUALITY = 60
BORDER_PX = 4


def main() -> None:
    """Writes the picture."""
    folder, target = Path(sys.argv[1]), Path(sys.argv[2])
    shown = [int(word) for word in sys.argv[3:]]
    (clip,) = find_clips(folder.parent, [folder.name])
    with tempfile.TemporaryDirectory() as scratch:
        source = clip.open(Path(scratch))
        images = {frame.index: np.asarray(frame.image) for frame in source if frame.index in shown}
        result = rj.run(clip.open(Path(scratch)), announce_after=ANNOUNCE_AFTER, progress=False)
    parts = []
    for index in shown:
        drawn = rj.draw(images[index], result.tracks[index])
        height = round(WIDTH_PX * drawn.shape[0] / drawn.shape[1])
        small = cv2.resize(drawn, (WIDTH_PX, height), interpolation=cv2.INTER_AREA)
        cv2.putText(small, str(index), (6, height - 8), 0, 0.5, (255, 255, 255), 1, cv2.LINE_AA)
        parts += [small, np.full((height, BORDER_PX, 3), 255, np.uint8)]
    strip = np.concatenate(parts[:-1], axis=1)[..., ::-1]
    cv2.imwrite(str(target), strip, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    print(f"{target}: {target.stat().st_size / 1000:.0f} kB, {strip.shape[1]}x{strip.shape[0]}")


if __name__ == "__main__":
    main()
