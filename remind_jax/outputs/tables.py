"""Tables of a run for people and for scorers: CSV, MOTChallenge, MOTS, COCO-video.

`tracks.csv` has every detection. The other formats know firm identities only, each once per
frame: undecided detections are left out, and where an identity was given twice in a frame
(possible with the published configuration) the detection with the higher score keeps it.
Their ids start at 1 (`object_id + 1`), their frames at 1 (position in the run + 1).
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Bool, Int

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome, Reason, Status
from remind_jax.files.csv_cells import write_row
from remind_jax.frame import Rle
from remind_jax.masks.run_length import decode_mask, encode_masks, mask_areas, union_area
from remind_jax.tracks import Tracks

# Columns of `tracks.csv`: a value of a detection by frame and row.
_CSV: dict[str, Callable[[Tracks, int], Any]] = {
    "frame": lambda tracks, row: int(tracks.frame_index),
    "source_index": lambda tracks, row: int(tracks.source_index),
    "time_s": lambda tracks, row: round(float(tracks.time_s), 6),
    "name": lambda tracks, row: tracks.name,
    "detection": lambda tracks, row: row,
    "label": lambda tracks, row: tracks.labels[row],
    "outcome": lambda tracks, row: Outcome(tracks.outcome[row]).name.lower(),
    "reason": lambda tracks, row: Reason(tracks.reason[row]).name.lower(),
    "object_id": lambda tracks, row: int(tracks.object_id[row]),
    "pending_id": lambda tracks, row: int(tracks.pending_id[row]),
    "status": lambda tracks, row: Status(tracks.status[row]).name.lower(),
    "score": lambda tracks, row: _round(tracks.shown_score(row)),
    "confidence": lambda tracks, row: _round(tracks.shown_confidence(row)),
    "candidates": lambda tracks, row: _list_candidates(tracks, row),
    "left": lambda tracks, row: round(float(tracks.boxes[row, 0]), 2),
    "top": lambda tracks, row: round(float(tracks.boxes[row, 1]), 2),
    "right": lambda tracks, row: round(float(tracks.boxes[row, 2]), 2),
    "bottom": lambda tracks, row: round(float(tracks.boxes[row, 3]), 2),
    "area": lambda tracks, row: int(tracks.areas[row]),
    "detector_score": lambda tracks, row: _round(float(tracks.detector_scores[row])),
    "object_name": lambda tracks, row: tracks.names.get(int(tracks.object_id[row])),
}
CSV_COLUMNS = tuple(_CSV)


def detection_rows(tracks: Tracks) -> list[dict[str, Any]]:
    """The rows of `tracks.csv` for one frame, one per detection; pixels, seconds, None: empty."""
    return [
        {name: value(tracks, row) for name, value in _CSV.items()} for row in range(len(tracks))
    ]


def _list_candidates(tracks: Tracks, row: int) -> str:
    ids, scores = tracks.candidate_id[row].tolist(), tracks.candidate_score[row].tolist()
    pairs = zip(ids, scores, strict=True)
    return ";".join(f"{i}:{score:.4g}" for i, score in pairs if i != NO_ID)


def _round(value: float | None) -> float | None:
    return None if value is None else round(value, 6)


class CsvWriter(contextlib.AbstractContextManager):
    """Writes `tracks.csv` frame by frame; every frame is on disk when `add` returns.

    Text is guarded (`files/csv_cells.py`).
    """

    def __init__(self, path: Path, *, append: bool = False) -> None:
        self._path = path
        with files.writing(path):
            self._file = path.open("a" if append else "w", encoding="utf-8", newline="")
            if not append:
                write_row(self._file, CSV_COLUMNS)

    def add(self, tracks: Tracks) -> None:
        """Appends one frame."""
        with files.writing(self._path):
            for row in detection_rows(tracks):
                write_row(self._file, row.values())
            self._file.flush()

    def close(self) -> None:
        """Closes the file."""
        with files.writing(self._path):
            self._file.close()

    def __exit__(self, *raised: object) -> None:
        self.close()


def firm_rows(tracks: Tracks) -> Int[np.ndarray, "K"]:
    """Detections with a firm identity, each identity once (higher score, then lower row)."""
    rows = np.flatnonzero(tracks.is_firm & (tracks.object_id != NO_ID))
    by_score = rows[np.argsort(-tracks.score[rows], kind="stable")]
    _, first = np.unique(tracks.object_id[by_score], return_index=True)
    return np.sort(by_score[first])


def mot_lines(tracks: Iterable[Tracks]) -> list[str]:
    """MOTChallenge results: `frame,id,left,top,width,height,confidence,-1,-1,-1`.

    Class and visibility are -1 as the challenge asks of results; classes are in `tracks.csv`.
    """
    lines = []
    for number, frame in enumerate(tracks, start=1):
        for row in firm_rows(frame):
            left, top, right, bottom = frame.boxes[row]
            lines.append(
                f"{number},{frame.object_id[row] + 1},{left:.2f},{top:.2f},{right - left:.2f},"
                f"{bottom - top:.2f},{frame.confidence[row]:.4f},-1,-1,-1"
            )
    return lines


def mots_lines(tracks: Iterable[Tracks], class_names: Sequence[str]) -> list[str]:
    """MOTS results: `frame id class height width rle`, class = place in `class_names` + 1.

    Masks of a frame may not overlap in this format: shared pixels go to the higher confidence.
    """
    numbers = {name: number for number, name in enumerate(class_names, start=1)}
    lines = []
    for number, frame in enumerate(tracks, start=1):
        rows = firm_rows(frame)
        height, width = frame.frame_size
        for row, rle in zip(rows, masks_without_overlap(frame, rows), strict=True):
            if rle is None:
                continue
            lines.append(
                f"{number} {frame.object_id[row] + 1} {numbers[frame.labels[row]]} "
                f"{height} {width} {rle['counts'].decode('ascii')}"
            )
    return lines


def coco_video(
    tracks: Sequence[Tracks], class_names: Sequence[str], name: str, fps: float
) -> dict[str, Any]:
    """A run in the layout of YouTube-VIS annotations: per identity one mask or null per frame.

    `score` of an annotation is its mean confidence.
    """
    numbers = {label: number for number, label in enumerate(class_names, start=1)}
    height, width = tracks[0].frame_size if tracks else (0, 0)
    annotations: dict[int, dict[str, Any]] = {}
    scores: dict[int, list[float]] = {}
    for position, frame in enumerate(tracks):
        for row in firm_rows(frame):
            object_id = int(frame.object_id[row])
            if object_id not in annotations:
                annotations[object_id] = _empty_annotation(object_id, len(tracks)) | {
                    "category_id": numbers[frame.labels[row]],
                    "height": height,
                    "width": width,
                }
            left, top, right, bottom = (float(side) for side in frame.boxes[row])
            rle = frame.rles[row]
            annotation = annotations[object_id]
            annotation["segmentations"][position] = {
                "size": list(rle["size"]),
                "counts": rle["counts"].decode("ascii"),
            }
            annotation["bboxes"][position] = [left, top, right - left, bottom - top]
            annotation["areas"][position] = int(frame.areas[row])
            scores.setdefault(object_id, []).append(float(frame.confidence[row]))
    video = {"id": 1, "name": name, "height": height, "width": width, "length": len(tracks)}
    return {
        "info": {"description": name, "fps": fps},
        "videos": [video | {"file_names": [frame.name for frame in tracks]}],
        "categories": [{"id": number, "name": label} for label, number in numbers.items()],
        "annotations": [
            annotations[object_id] | {"score": float(np.mean(scores[object_id]))}
            for object_id in sorted(annotations)
        ],
    }


def write_tables(
    folder: Path, tracks: Sequence[Tracks], class_names: Sequence[str], name: str, fps: float
) -> None:
    """Writes `mot.txt`, `mots.txt` and `coco_video.json`."""
    content = coco_video(tracks, class_names, name, fps)
    texts = {
        "mot.txt": "".join(f"{line}\n" for line in mot_lines(tracks)),
        "mots.txt": "".join(f"{line}\n" for line in mots_lines(tracks, class_names)),
        "coco_video.json": json.dumps(content, ensure_ascii=False, separators=(",", ":")),
    }
    for file_name, text in texts.items():
        files.replace_file(folder / file_name, text.encode("utf-8"))


def _empty_annotation(object_id: int, num_frames: int) -> dict[str, Any]:
    return {
        "id": object_id + 1,
        "video_id": 1,
        "iscrowd": 0,
        "segmentations": [None] * num_frames,
        "bboxes": [None] * num_frames,
        "areas": [None] * num_frames,
    }


def masks_without_overlap(tracks: Tracks, rows: Int[np.ndarray, "K"]) -> list[Rle | None]:
    """The masks of `rows` without shared pixels; None for one of which nothing is left."""
    rles = [tracks.rles[row] for row in rows]
    areas = mask_areas(rles)
    if union_area(rles) == areas.sum():
        return [rle if area else None for rle, area in zip(rles, areas, strict=True)]
    taken: Bool[np.ndarray, "H W"] = np.zeros(tracks.frame_size, bool)
    cut: list[Rle | None] = [None] * len(rles)
    for place in np.argsort(-tracks.confidence[rows], kind="stable"):
        free = decode_mask(rles[place]).astype(bool) & ~taken
        taken |= free
        if free.any():
            (cut[place],) = encode_masks(free[None])
    return cut
