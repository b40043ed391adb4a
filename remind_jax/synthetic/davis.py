"""Writes rendered tours in the DAVIS layout, with metadata that names ids, classes and absences."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from remind_jax.errors import OutputError
from remind_jax.frame import Frame
from remind_jax.synthetic.rendering import RenderedSequence, render
from remind_jax.synthetic.scene import Scene

_MAX_ID = 255


def write_davis(
    sequence: RenderedSequence | Scene, folder: str | Path, jpeg_quality: int = 92
) -> Path:
    """Writes a folder with `JPEGImages/<name>`, `Annotations/<name>` and two metadata files.

    Annotations are 8-bit grayscale instance maps, 0 where nothing is annotated;
    `metadata_one_class.json` says the same with every object in class `object`. A scene is
    rendered frame by frame, so that long tours need little memory.

    Returns:
      The folder.

    Raises:
      OutputError: If an id does not fit into 8 bits or a file cannot be written.
    """
    scene = sequence.scene if isinstance(sequence, RenderedSequence) else sequence
    frames = sequence.frames if isinstance(sequence, RenderedSequence) else render(scene)
    largest = max((item.instance_id for item in scene.objects), default=0)
    if largest > _MAX_ID:
        raise OutputError(
            f"instance id {largest} does not fit into an 8-bit instance map; "
            f"render at most {_MAX_ID} objects to write them in the DAVIS layout"
        )
    root = Path(folder)
    try:
        sightings = _write_frames(frames, scene.name, root, jpeg_quality)
        for file_name, one_class in (("metadata.json", False), ("metadata_one_class.json", True)):
            text = json.dumps(_describe(scene, sightings, one_class), indent=1)
            (root / file_name).write_text(text + "\n")
    except OSError as error:
        raise OutputError(f"cannot write the sequence to '{root}': {error}") from error
    return root


def _write_frames(
    frames: Iterable[Frame], name: str, root: Path, jpeg_quality: int
) -> dict[int, list[int]]:
    """Writes pictures and instance maps; returns the frames in which each id is seen."""
    image_folder, map_folder = root / "JPEGImages" / name, root / "Annotations" / name
    for directory in (image_folder, map_folder):
        directory.mkdir(parents=True, exist_ok=True)
    sightings: dict[int, list[int]] = defaultdict(list)
    for frame in frames:
        assert frame.image is not None
        assert frame.detections is not None
        instances = np.zeros(frame.size, np.uint8)
        ids = frame.detections.instance_ids.tolist()
        for mask, instance in zip(frame.detections.masks, ids, strict=True):
            instances[mask] = instance
            sightings[instance].append(frame.index)
        bgr = cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
        quality = [cv2.IMWRITE_JPEG_QUALITY, jpeg_quality]
        _write(image_folder / f"{frame.name}.jpg", bgr, quality)
        _write(map_folder / f"{frame.name}.png", instances, [])
    return sightings


def _write(path: Path, image: np.ndarray, parameters: list[int]) -> None:
    is_encoded, data = cv2.imencode(path.suffix, image, parameters)
    if not is_encoded:
        raise OutputError(f"the picture '{path}' cannot be encoded")
    path.write_bytes(data.tobytes())


def _describe(scene: Scene, sightings: dict[int, list[int]], one_class: bool) -> dict[str, Any]:
    classes, labels, objects = {}, {}, {}
    counts: dict[str, int] = defaultdict(int)
    for item in scene.objects:
        seen = sightings.get(item.instance_id)
        if not seen:
            continue
        key, label = str(item.instance_id), "object" if one_class else item.label
        counts[label] += 1
        classes[key], labels[key] = label, f"{label}_{counts[label]:02d}"
        objects[key] = {
            "shape": item.label,
            "lookalike_group": item.group,
            "room": scene.rooms[item.placements[0].room].name,
            "frames_visible": len(seen),
            "longest_absence": int(max(np.diff(seen), default=1)) - 1,
        }
    sources = [pose.source_index for pose in scene.path.poses]
    drop = scene.light.drop_frame
    return {
        "sequence": scene.name,
        "seed": scene.seed,
        "frames": len(sources),
        "width": scene.sensor.width_px,
        "height": scene.sensor.height_px,
        "min_mask_px": scene.sensor.min_mask_px,
        "light_drop_frame": None if drop is None else int(np.searchsorted(sources, drop)),
        "id_to_label": labels,
        "id_to_class": classes,
        "objects": objects,
    }
