"""Small valid pictures, videos, arrays, archives and networks."""

import json
from collections.abc import Callable
from pathlib import Path

import av
import cv2
import numpy as np

from remind_jax.detectors import as_detector
from tests.cli import scenes
from tests.detectors.onnx_bytes import write_fixed_answer

NUM_FRAMES = 3
_SIDE_PX = 96


def pictures(suffix: str) -> Callable[[Path], Path]:
    """A folder of pictures of a kind; the first is changed."""

    def write(folder: Path) -> Path:
        images = folder / "images"
        images.mkdir()
        for index in range(NUM_FRAMES):
            image = cv2.cvtColor(scenes.picture(index)[0], cv2.COLOR_RGB2BGR)
            cv2.imwrite(str(images / f"{index:04d}{suffix}"), image)
        return images / f"0000{suffix}"

    return write


def video(name: str, codec: str, pixels: str) -> Callable[[Path], Path]:
    """A video of a kind."""

    def write(folder: Path) -> Path:
        path = folder / name
        with av.open(str(path), "w") as container:
            stream = container.add_stream(codec, rate=10)
            stream.width = stream.height = _SIDE_PX  # pyright: ignore[reportAttributeAccessIssue]
            stream.pix_fmt = pixels  # pyright: ignore[reportAttributeAccessIssue]
            for index in range(NUM_FRAMES):
                image = np.ascontiguousarray(scenes.picture(index)[0][:_SIDE_PX, :_SIDE_PX])
                frame = av.VideoFrame.from_ndarray(image, format="rgb24")
                container.mux(stream.encode(frame))  # pyright: ignore[reportAttributeAccessIssue]
            container.mux(stream.encode())  # pyright: ignore[reportAttributeAccessIssue]
        return path

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
    found = as_detector(path)
    assert found is not None
    found(scenes.picture(0)[0])


def polygons(folder: Path) -> Path:
    """A COCO data set with polygons and boxes."""
    scenes.write_scene(folder / "scene", NUM_FRAMES)
    outline = [[8.0, 8.0, 60.0, 8.5, 60.0, 60.0, 8.0, 60.0]]
    annotations = [
        {"id": 2 * image, "image_id": image, "category_id": 1, "segmentation": outline}
        for image in range(NUM_FRAMES)
    ]
    annotations += [
        {"id": 2 * image + 1, "image_id": image, "category_id": 2, "bbox": [100, 20, 50, 60.5]}
        for image in range(NUM_FRAMES)
    ]
    content = {
        "images": [{"id": i, "file_name": f"{i:04d}.png"} for i in range(NUM_FRAMES)],
        "categories": [{"id": 1, "name": "cup"}, {"id": 2, "name": "book"}],
        "annotations": annotations,
    }
    path = folder / "dataset.json"
    path.write_text(json.dumps(content))
    return path


def categories(folder: Path) -> Path:
    """Names of categories, beside results that need them."""
    scenes.write_scene(folder / "scene", NUM_FRAMES)
    rows = [
        {"image_id": i, "category_id": 1, "bbox": [8, 8, 50, 50], "score": 0.5}
        for i in range(NUM_FRAMES)
    ]
    (folder / "results.json").write_text(json.dumps(rows))
    path = folder / "categories.json"
    path.write_text(json.dumps({"categories": [{"id": 1, "name": "cup"}]}))
    return path
