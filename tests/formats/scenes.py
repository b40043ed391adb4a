"""Two small scenes written in every format that is read."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.formats.rows import boxes_of
from remind_jax.masks.run_length import encode_label_map
from tests.sources import making

# Columns of a frame that an object covers; object 2 leaves and returns.
TRUTH = {
    "one": ["11.22.", "11.22.", "11....", "11.22."],
    "two": ["333...", ".333..", "..333."],
}
# What a tracker called them; object 2 of scene one returns under another id.
ANSWERS = {"one": ["77.88.", "77.88.", "77....", "7..99."], "two": ["555...", ".555..", "..555."]}
CLASSES = {1: "cup", 2: "cup", 3: "box"}
HEIGHT = 4


def label_maps(rows: list[str]) -> list[np.ndarray]:
    """A label map per line, each character a column."""
    return [np.tile([int(c) if c != "." else 0 for c in row], (HEIGHT, 1)) for row in rows]


def write_maps(root: Path, scenes: dict[str, list[str]]) -> Path:
    """Folders of PNGs, as DAVIS has them below `Annotations`."""
    for name, rows in scenes.items():
        for frame, labels in enumerate(label_maps(rows)):
            making.write_image(root / name / f"{frame:05d}.png", labels.astype(np.uint8))
    return root


def write_davis(root: Path, scenes: dict[str, list[str]]) -> Path:
    """With metadata that names the classes."""
    write_maps(root / "Annotations", scenes)
    labels = {str(number): f"{name}_{number}" for number, name in CLASSES.items()}
    (root / "metadata.json").write_text(json.dumps({"id_to_label": labels}))
    return root


def rows_of(rows: list[str]) -> list[tuple[int, int, dict[str, Any], list[float]]]:
    """Frame, id, code and box (left, top, width, height) of every object in every frame."""
    found = []
    for frame, labels in enumerate(label_maps(rows)):
        for number, rle in encode_label_map(labels).items():
            left, top, right, bottom = boxes_of([rle])[0].tolist()
            code = {"size": rle["size"], "counts": rle["counts"].decode()}
            found.append((frame, number, code, [left, top, right - left, bottom - top]))
    return found


def mot_text(rows: list[str]) -> str:
    return "".join(
        f"{frame + 1},{number},{','.join(map(str, box))},1,1,1\n"
        for frame, number, _, box in rows_of(rows)
    )


def mots_text(rows: list[str], first_frame: int = 1) -> str:
    return "".join(
        f"{frame + first_frame} {number} 2 {HEIGHT} {len(rows[0])} {code['counts']}\n"
        for frame, number, code, _ in rows_of(rows)
    )


def coco_video(scenes: dict[str, list[str]], part: str = "segmentations") -> dict[str, Any]:
    """COCO-video JSON with masks or boxes."""
    names = sorted(set(CLASSES.values()))
    videos, annotations = [], []
    for video_id, (scene, rows) in enumerate(scenes.items(), 1):
        files = [f"{scene}/{frame:05d}.jpg" for frame in range(len(rows))]
        size = {"height": HEIGHT, "width": len(rows[0]), "length": len(rows)}
        videos.append({"id": video_id, "name": scene, "file_names": files, **size})
        tracks: dict[int, list[Any]] = {}
        for frame, number, code, box in rows_of(rows):
            entries = tracks.setdefault(number, [None] * len(rows))
            entries[frame] = code if part == "segmentations" else box
        annotations += [
            {
                "id": number,
                "video_id": video_id,
                "category_id": names.index(CLASSES.get(number, "cup")) + 1,
                part: entries,
            }
            for number, entries in tracks.items()
        ]
    categories = [{"id": i + 1, "name": name} for i, name in enumerate(names)]
    return {"videos": videos, "annotations": annotations, "categories": categories}


def coco_results(scenes: dict[str, list[str]]) -> list[dict[str, Any]]:
    """The list of results that YouTube-VIS asks for; it has no ids."""
    return [
        {k: v for k, v in annotation.items() if k not in ("id", "category_id")} | {"score": 0.9}
        for annotation in coco_video(scenes)["annotations"]
    ]


def write_json(path: Path, content: Any) -> Path:
    path.write_text(json.dumps(content))
    return path


def write_texts(root: Path, texts: dict[str, str]) -> Path:
    root.mkdir(parents=True)
    for name, text in texts.items():
        (root / f"{name}.txt").write_text(text)
    return root
