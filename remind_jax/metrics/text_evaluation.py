"""Scores two text files of one format, with the breakdowns that their truth allows.

The size of a box is its share of the frame, and text does not tell the frame: `seqinfo.ini`, which
MOTChallenge puts beside its truth, does. Masks of MOTS carry the size of their frame.
"""

from __future__ import annotations

import configparser
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float

from remind_jax.masks.run_length import mask_areas
from remind_jax.metrics.breakdowns import Breakdown, count_breakdowns
from remind_jax.metrics.evaluation import Evaluation, evaluate_sequence
from remind_jax.metrics.mot_files import BoxRows, FileFormat
from remind_jax.metrics.sequence import TrackingSequence
from remind_jax.metrics.text_sequences import pair_mot_files, pair_mots_files

DEFAULT_MOTS_CLASS = 2  # pedestrian

SIZE_UNKNOWN = (
    "the frame size is unknown (no seqinfo.ini with imWidth and imHeight beside the truth), "
    "so nothing is said by size of observation"
)


def evaluate_text(
    format: FileFormat,
    gt_path: Path,
    pred_path: Path,
    *,
    num_frames: int | None = None,
    class_id: int | None = None,
    by_object: bool = False,
) -> tuple[Evaluation, list[str]]:
    """Scores a scene as TrackEval does, and breaks it down.

    Args:
      format: Of both files.
      gt_path: Truth.
      pred_path: Predictions.
      num_frames: Length of the sequence; up to the last row if left out.
      class_id: Class to score; MOT: all, MOTS: 2, if left out.
      by_object: Keep the counts of every object, for intervals over them.

    Returns:
      The evaluation, and what is to be told about it.

    Raises:
      SourceError: If a file cannot be read or breaks the rules of its format.
    """
    notes = []
    if format == "mot":
        sequence, boxes = pair_mot_files(
            gt_path, pred_path, num_frames=num_frames, class_id=class_id
        )
        frame_size = read_frame_size(gt_path)
        if frame_size is None:
            notes.append(SIZE_UNKNOWN)
        breakdowns = _break_down_boxes(sequence, boxes, frame_size)
    else:
        sequence, masks = pair_mots_files(
            gt_path,
            pred_path,
            num_frames=num_frames,
            class_id=DEFAULT_MOTS_CLASS if class_id is None else class_id,
            first_frame=0 if format == "kitti-mots" else 1,
        )
        frame_areas = np.array([np.prod(rle["size"]) for rle in masks.rles])
        breakdowns = count_breakdowns(
            sequence,
            area_share=mask_areas(masks.rles) / np.maximum(1, frame_areas),
            gt_class=np.zeros(len(masks.frame), np.int64),
            class_names=sequence.class_names,
        )
    return evaluate_sequence(sequence, breakdowns=breakdowns, by_object=by_object), notes


def read_frame_size(gt_path: Path) -> tuple[int, int] | None:
    """Height and width in pixels from the scene's `seqinfo.ini`; None where nothing tells them."""
    folder = gt_path.parent.parent if gt_path.parent.name == "gt" else gt_path.parent
    content = configparser.ConfigParser()
    try:
        content.read(folder / "seqinfo.ini", encoding="utf-8")
        size = tuple(content.getint("Sequence", key) for key in ("imHeight", "imWidth"))
    except (configparser.Error, ValueError, OSError):
        return None
    return (size[0], size[1]) if min(size) > 0 else None


def _break_down_boxes(
    sequence: TrackingSequence, truth: BoxRows, frame_size: tuple[int, int] | None
) -> Mapping[str, Breakdown]:
    has_classes = len(truth.class_id) > 0 and bool((truth.class_id >= 0).all())
    numbers, gt_class = np.unique(truth.class_id, return_inverse=True)
    return count_breakdowns(
        sequence,
        area_share=None if frame_size is None else share_of_frame(truth.boxes, frame_size),
        gt_class=gt_class if has_classes else None,
        class_names=tuple(f"class {number}" for number in numbers),
    )


def share_of_frame(
    boxes: Float[np.ndarray, "N 4"], frame_size: tuple[int, int]
) -> Float[np.ndarray, "N"]:
    """Share of the frame that each box covers; what lies outside of the frame does not count."""
    height, width = frame_size
    left, top, right, bottom = np.clip(boxes, 0, [width, height, width, height]).T
    return np.maximum(right - left, 0) * np.maximum(bottom - top, 0) / (height * width)
