"""The original tracker as a process that times one frame per line it reads; for `step.py`.

    python benchmarks/original_peer.py WORK_TREE GOLDEN_FOLDER SEQUENCE

The first line read is JSON: overrides of its configuration, and the classes in order of their ids.
Each further line steps one frame and is answered by its milliseconds per stage. Its code runs
unmodified, but for the network and the reading of annotations: features and masks are given.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
import types
from pathlib import Path
from typing import Any

for threads in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(threads, "1")

import numpy as np  # noqa: E402  (reads the number of threads)

# In place of this folder, whose modules would hide packages of the original.
sys.path[0] = str(Path(__file__).resolve().parent.parent)

from tests.golden import load  # noqa: E402

STAGES = ("perception", "association", "update")
# Stages of its perception that are replaced here, and so are not its time.
GIVEN_STAGES = ("detector", "dino")
QUIET: dict[str, Any] = {"timing": {"enabled": False}, "runtime": {"device": "cpu"}}


def stand_in_for_network_libraries() -> None:
    """Lets the original be imported where neither PyTorch nor transformers is installed."""

    def pass_through(*args: Any, **kwargs: Any) -> Any:
        return lambda function: function

    for name in ("torch", "transformers"):
        try:
            __import__(name)
        except ImportError:
            module = types.ModuleType(name)
            vars(module).update(inference_mode=pass_through, AutoImageProcessor=0, AutoModel=0)
            sys.modules[name] = module


def find_geometry(mask: np.ndarray) -> tuple[list[int], dict[str, Any]]:
    """Box (right and bottom excluded), mean position and area, as the original takes them."""
    rows, columns = np.nonzero(mask)
    box = [int(columns.min()), int(rows.min()), int(columns.max()) + 1, int(rows.max()) + 1]
    return box, {"center": (float(columns.mean()), float(rows.mean())), "area": len(rows)}


class GivenMasks:
    """A segmenter that answers with the masks of the sequence."""

    def __init__(self, classes: list[str]):
        from detection.detection import Detection  # pyright: ignore[reportMissingImports]

        self.class_id_to_name = dict(enumerate(classes))
        self._class_ids = {name: number for number, name in enumerate(classes)}
        self._detection = Detection
        self.frame: load.Frame | None = None

    def segment(self, frame: np.ndarray, frame_id: int, timestamp: float) -> list[Any]:
        """Detections of the current frame."""
        assert self.frame is not None
        found = []
        for number, (mask, name) in enumerate(
            zip(self.frame.masks, self.frame.classes, strict=True)
        ):
            box, geometry = find_geometry(mask)
            detection = self._detection(
                number, self._class_ids[name], frame_id, timestamp, box, mask, None, 1.0, geometry
            )
            detection.class_name = name
            found.append(detection)
        return found


def build_pipeline(tree: Path, overrides: dict[str, Any], classes: list[str]) -> tuple[Any, Any]:
    """The original's pipeline with given masks, and what it takes for its network."""
    from config.config_loader import Config  # pyright: ignore[reportMissingImports]
    from features.dino_extractor import DinoExtractor  # pyright: ignore[reportMissingImports]
    from memory.memory_store import MemoryStore  # pyright: ignore[reportMissingImports]
    from pipeline.reid_pipeline import ReIDPipeline  # pyright: ignore[reportMissingImports]

    class GivenFeatures(DinoExtractor):
        features: np.ndarray

        def extract_patches(self, image_rgb: np.ndarray) -> np.ndarray:
            return self.features

    loader = Config(tree / "config" / "default_config.yaml")
    config = loader.merge_dicts(loader.merge_dicts(loader.to_dict(), QUIET), overrides)
    np.random.seed(0)  # noqa: NPY002  (what the original draws from)
    network = GivenFeatures(config=config.get("dino", {}), device="cpu")
    context = types.SimpleNamespace(
        config=config,
        memory=MemoryStore(config=config, start_object_id=0),
        yolo=GivenMasks(classes),
        dino=network,
        output_dir=Path(os.devnull).parent,
    )
    return ReIDPipeline(context), network


def step_ms(pipeline: Any, network: Any, index: int, frame: load.Frame) -> dict[str, float]:
    """Steps one frame; milliseconds per stage."""
    network.features, pipeline.ctx.yolo.frame = frame.features, frame
    image = np.zeros((*frame.masks.shape[1:], 3), np.uint8)
    with open(os.devnull, "w") as sink, contextlib.redirect_stdout(sink):
        pipeline.process_frame(image, index, float(index))
    spent = {stage: 1e3 * pipeline.last_stage_times_seconds[stage] for stage in STAGES}
    given = pipeline.last_stage_details_seconds["perception"]
    spent["perception"] -= sum(1e3 * given.get(stage, 0.0) for stage in GIVEN_STAGES)
    return spent


def main() -> None:
    tree, root, name = Path(sys.argv[1]).resolve(), Path(sys.argv[2]), sys.argv[3]
    # Behind our own folder, which has no module of these names.
    sys.path.append(str(tree))
    stand_in_for_network_libraries()
    setup = json.loads(sys.stdin.readline())
    pipeline, network = build_pipeline(tree, setup["overrides"], setup["classes"])
    for index, frame in enumerate(load.load_inputs(name, root)):
        if not sys.stdin.readline():
            return
        print(json.dumps(step_ms(pipeline, network, index, frame)), flush=True)


if __name__ == "__main__":
    main()
