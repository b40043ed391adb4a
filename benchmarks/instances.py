"""What the host does for frames of very many instances: CPU seconds and memory, from file to step.

python benchmarks/instances.py [--counts 500 1000] [--sizes 640x480 1280x720]

Each row is a process of its own: an instance map of 16 bits is read and taken apart, its masks are
reduced to what a step needs, and encoded as the result repeats them; likewise COCO codes.
"""

from __future__ import annotations

import argparse
import itertools
import json
import math
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

CHILD = "--as-one"


def draw_map(num: int, width: int, height: int):
    """As many ellipses of different sizes, beside each other."""
    import cv2
    import numpy as np

    columns = math.ceil(math.sqrt(num * width / height))
    rows = math.ceil(num / columns)
    labels, rng = np.zeros((height, width), np.uint16), np.random.default_rng(0)
    for instance in range(num):
        row, column = divmod(instance, columns)
        center = int((column + 0.5) * width / columns), int((row + 0.5) * height / rows)
        most = max(1, width // columns // 2), max(1, height // rows // 2)
        axes = tuple(int(rng.integers(max(1, side // 2), side + 1)) for side in most)
        cv2.ellipse(labels, center, axes, 0, 0, 360, instance + 1, -1)
    return labels


def write_inputs(folder: Path, num: int, width: int, height: int) -> None:
    """A picture, its map and the same masks as COCO codes."""
    import cv2
    import numpy as np

    from remind_jax.masks.run_length import encode_label_map

    for name in ("images", "masks"):
        (folder / name).mkdir()
    image = np.random.default_rng(1).integers(0, 255, (height, width, 3), np.uint8)
    cv2.imwrite(str(folder / "images" / "0000.png"), image)
    labels = draw_map(num, width, height)
    cv2.imwrite(str(folder / "masks" / "0000.png"), labels)
    rows = [
        {
            "image_id": 0,
            "category_id": 1,
            "segmentation": {"size": rle["size"], "counts": rle["counts"].decode()},
            "score": 1.0,
        }
        for rle in encode_label_map(labels).values()
    ]
    (folder / "masks.json").write_text(json.dumps(rows))


def read_one(folder: Path, masks: str) -> dict[str, float]:
    """CPU seconds of reading, reducing and encoding, and the memory that it took, in MB."""
    import remind_jax as rj
    from remind_jax.config import load_config
    from remind_jax.method import get_method
    from remind_jax.session.answers import outline
    from remind_jax.session.preparation import FramePreparer

    config = load_config("default")
    preparer = FramePreparer(get_method(config.tracker), 16)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    times = [time.process_time()]
    (frame,) = rj.open_source(folder / "images", masks=folder / masks)
    times.append(time.process_time())
    prepared = preparer.prepare(frame, config)
    times.append(time.process_time())
    outlines = outline(prepared.detections.masks)
    times.append(time.process_time())
    assert len(outlines.rles) == len(prepared.detections)
    taken = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before
    spent = [later - earlier for earlier, later in itertools.pairwise(times)]
    names = ("read_s", "reduce_s", "encode_s")
    return {**dict(zip(names, spent, strict=True)), "taken_mb": taken * 1024 / 1e6}


def measure(num: int, size: tuple[int, int], masks: str) -> dict[str, float]:
    """One row, in a process of its own."""
    with tempfile.TemporaryDirectory() as folder:
        write_inputs(Path(folder), num, *size)
        done = subprocess.run(
            [sys.executable, __file__, CHILD, folder, masks],
            capture_output=True,
            text=True,
            check=True,
        )
    return json.loads(done.stdout)


def main() -> None:
    """Prints a table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--counts", type=int, nargs="+", default=[500, 1000])
    parser.add_argument("--sizes", nargs="+", default=["640x480", "1280x720"])
    options = parser.parse_args()
    print("| masks | size | instances | read | reduce | encode | memory |")
    print("| --- | --- | ---: | ---: | ---: | ---: | ---: |")
    for masks in ("masks", "masks.json"):
        for size in options.sizes:
            for num in options.counts:
                width, height = map(int, size.split("x"))
                row = measure(num, (width, height), masks)
                times = " | ".join(
                    f"{row[name]:.2f} s" for name in ("read_s", "reduce_s", "encode_s")
                )
                print(f"| {masks} | {size} | {num} | {times} | {row['taken_mb']:.0f} MB |")


if __name__ == "__main__":
    if sys.argv[1:2] == [CHILD]:
        print(json.dumps(read_one(Path(sys.argv[2]), sys.argv[3])))
    else:
        main()
