"""Makes `docs/demo.webp`, the moving picture of the README, from the overlay of `remind demo`.

python docs/demo_picture.py [remind_demo/overlay.mp4]
"""

from __future__ import annotations

import sys
from pathlib import Path

import av
import cv2

SIZE_PX = (400, 300)
FRAME_MS = 140
QUALITY = 40
# Before it leaves, the other room in passing, and the return in the dark.
SHOWN = (*range(2, 34, 2), *range(50, 66, 4), *range(86, 120, 2))


def main() -> None:
    """Writes the picture."""
    video = Path(sys.argv[1] if len(sys.argv) > 1 else "remind_demo/overlay.mp4")
    with av.open(str(video)) as container:
        frames = [frame.to_ndarray(format="bgr24") for frame in container.decode(video=0)]
    animation = cv2.Animation()
    animation.frames = [
        cv2.resize(frames[index], SIZE_PX, interpolation=cv2.INTER_AREA) for index in SHOWN
    ]
    animation.durations = [FRAME_MS] * len(SHOWN)
    target = Path(__file__).with_name("demo.webp")
    cv2.imwriteanimation(str(target), animation, [cv2.IMWRITE_WEBP_QUALITY, QUALITY])
    print(f"{target}: {target.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    main()
