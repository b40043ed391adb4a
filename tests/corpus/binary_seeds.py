"""Small valid pictures, videos and networks."""

from collections.abc import Callable
from pathlib import Path

import numpy as np

from remind_jax.detectors import as_detector
from tests.cli import scenes
from tests.detectors.onnx_bytes import write_fixed_answer
from tests.sources import making

NUM_FRAMES = 3
_SIDE_PX = 96


def pictures(suffix: str) -> Callable[[Path], Path]:
    """A folder of pictures of a kind; the first is changed."""

    def write(folder: Path) -> Path:
        for index in range(NUM_FRAMES):
            path = folder / "images" / f"{index:04d}{suffix}"
            making.write_image(path, scenes.picture(index)[0])
        return folder / "images" / f"0000{suffix}"

    return write


def video(name: str, codec: str, pixels: str) -> Callable[[Path], Path]:
    """A video of a kind."""

    def make(index: int) -> np.ndarray:
        return np.ascontiguousarray(scenes.picture(index)[0][:_SIDE_PX, :_SIDE_PX])

    def write(folder: Path) -> Path:
        making.write_video(folder / name, NUM_FRAMES, codec, make=make, pixels=pixels)
        return folder / name

    return write


def detector(folder: Path) -> Path:
    """A YOLO-seg network that finds one thing wherever it looks."""
    rows = np.zeros((1, 4 + 2 + 4, 84), np.float32)
    rows[0, :4, 0], rows[0, 4, 0], rows[0, 6:, 0] = (32, 32, 20, 20), 0.9, 1
    answers = {"output0": rows, "output1": np.ones((1, 4, 16, 16), np.float32)}
    metadata = {"names": "{0: 'cup', 1: 'tv'}", "imgsz": "[64, 64]", "stride": "32"}
    return write_fixed_answer(folder / "network.onnx", answers, (1, 3, 64, 64), metadata)


def detect(path: Path) -> None:
    """Finds things in one frame."""
    as_detector(path)(scenes.picture(0)[0])
