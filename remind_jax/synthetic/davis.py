"""Writes rendered tours in the DAVIS layout, with metadata that names ids, classes and absences."""

from __future__ import annotations

import dataclasses
import json
from collections import defaultdict
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from remind_jax.errors import OutputError
from remind_jax.files import writing
from remind_jax.formats.pictures import TIMES_NAME, decode_image
from remind_jax.frame import Frame
from remind_jax.synthetic.rendering import RenderedSequence, render
from remind_jax.synthetic.scene import Scene

_MAX_ID = 255
_JPEG_QUALITY = 92


def write_davis(sequence: RenderedSequence | Scene, folder: str | Path) -> Path:
    """Writes a folder with `JPEGImages/<name>`, `Annotations/<name>` and `metadata.json`.

    Annotations are 8-bit grayscale instance maps, 0 where nothing is annotated. A scene is rendered
    frame by frame, so that long tours need little memory.

    Returns:
      The folder.

    Raises:
      OutputError: If an id does not fit into 8 bits, another scene lies there, whose classes would
        be replaced, or a file cannot be written.
    """
    scene = sequence.scene if isinstance(sequence, RenderedSequence) else sequence
    frames = sequence.frames if isinstance(sequence, RenderedSequence) else render(scene)
    for _ in _write_frames(frames, scene, Path(folder)):
        pass
    return Path(folder)


def record_davis(scene: Scene, folder: str | Path) -> Iterator[Frame]:
    """Renders a scene into a folder, as `write_davis` does, with the times of its pictures.

    Yields:
      Every frame, with its picture as whoever opens the folder reads it.

    Raises:
      OutputError: As `write_davis`.
    """
    times_s = []
    for frame, picture in _write_frames(render(scene), scene, Path(folder)):
        times_s.append(frame.time_s)
        yield dataclasses.replace(frame, image=decode_image(picture))
    with writing(Path(folder)):
        text = "".join(f"{time_s!r}\n" for time_s in times_s)
        Path(folder, "JPEGImages", scene.name, TIMES_NAME).write_text(text)


def _write_frames(
    frames: Iterable[Frame], scene: Scene, root: Path
) -> Iterator[tuple[Frame, bytes]]:
    """Writes pictures, instance maps and, at the end, metadata; yields frames and pictures."""
    largest = max((item.instance_id for item in scene.objects), default=0)
    if largest > _MAX_ID:
        raise OutputError(
            f"instance id {largest} does not fit into an 8-bit instance map; "
            f"render at most {_MAX_ID} objects to write them in the DAVIS layout"
        )
    image_folder, map_folder = root / "JPEGImages" / scene.name, root / "Annotations" / scene.name
    with writing(root):
        others = [path.name for path in root.glob("JPEGImages/*") if path != image_folder]
        if others and (root / "metadata.json").exists():
            raise OutputError(
                f"'{root}' has a metadata.json of scene '{others[0]}'; give '{scene.name}' a "
                f"folder of its own, or move that to Annotations/{others[0]}"
            )
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
        options = [cv2.IMWRITE_JPEG_QUALITY, _JPEG_QUALITY]
        picture = cv2.imencode(".jpg", bgr, options)[1].tobytes()
        with writing(root):
            (image_folder / f"{frame.name}.jpg").write_bytes(picture)
            (map_folder / f"{frame.name}.png").write_bytes(
                cv2.imencode(".png", instances)[1].tobytes()
            )
        yield frame, picture
    with writing(root):
        text = json.dumps(_describe(scene, sightings), indent=1)
        (root / "metadata.json").write_text(text + "\n")


def _describe(scene: Scene, sightings: dict[int, list[int]]) -> dict[str, Any]:
    classes, labels, objects = {}, {}, {}
    counts: dict[str, int] = defaultdict(int)
    for item in scene.objects:
        seen = sightings.get(item.instance_id)
        if not seen:
            continue
        key, label = str(item.instance_id), item.label
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
