"""The one data type that every metric takes: who is where in a sequence, and what overlaps what.

Letters: `G` ground-truth rows, `P` predicted rows, `K` overlapping pairs, `T` frames.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from functools import cached_property
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.errors import SourceError

# Similarities are ratios; rounding may lift a perfect overlap this far above 1.
SIMILARITY_SLACK = 1e-9


@dataclasses.dataclass(frozen=True)
class TrackingSequence:
    """Ground truth and predictions of one sequence.

    Rows are ordered by frame and, inside a frame, as they were given; pairs are ordered by
    ground-truth row, then predicted row. Build with `create`, which checks this.
    """

    num_frames: int
    gt_frame: Int[np.ndarray, "G"]  # 0 ... num_frames - 1
    gt_id: Int[np.ndarray, "G"]  # unique inside a frame
    pred_frame: Int[np.ndarray, "P"]
    pred_id: Int[np.ndarray, "P"]  # unique inside a frame
    pair_gt: Int[np.ndarray, "K"]  # row of the ground truth
    pair_pred: Int[np.ndarray, "K"]  # row of the prediction
    pair_similarity: Float[np.ndarray, "K"]  # (0, 1]
    gt_class: Int[np.ndarray, "G"]  # index into class_names
    pred_class: Int[np.ndarray, "P"]
    class_names: tuple[str, ...] = ("object",)
    name: str = "sequence"  # for messages and tables

    @classmethod
    def create(
        cls,
        num_frames: int,
        ground_truth: tuple[Any, Any],
        predictions: tuple[Any, Any],
        pairs: tuple[Any, Any, Any],
        *,
        gt_class: Any = None,
        pred_class: Any = None,
        class_names: Sequence[str] = ("object",),
        name: str = "sequence",
        first_frame: int = 0,
    ) -> TrackingSequence:
        """Builds a sequence from flat tables and checks it as TrackEval does.

        Args:
          ground_truth: Frame `[G]` and id `[G]` of each row, frames not falling.
          predictions: Frame `[P]` and id `[P]` of each row, frames not falling.
          pairs: Ground-truth row `[K]`, predicted row `[K]`, similarity `[K]` in [0, 1].

        Raises:
          SourceError: If an id occurs twice in one frame, a frame is outside of the sequence, a
            pair joins different frames, or a similarity is outside of [0, 1].
        """
        gt_frame, gt_id, pred_frame, pred_id, pair_gt, pair_pred = (
            np.asarray(column, np.int64) for column in (*ground_truth, *predictions, *pairs[:2])
        )
        similarity = np.asarray(pairs[2], np.float64)
        check_rows("ground truth", name, num_frames, gt_frame, gt_id, first_frame)
        check_rows("prediction", name, num_frames, pred_frame, pred_id, first_frame)
        _check_pairs(name, gt_frame, pred_frame, pair_gt, pair_pred, similarity)
        order = np.flatnonzero(similarity > 0)
        rank = pair_gt[order] * max(1, len(pred_frame)) + pair_pred[order]
        if np.any(np.diff(rank) <= 0):
            order = order[np.argsort(rank, kind="stable")]
        return cls(
            int(num_frames),
            gt_frame,
            gt_id,
            pred_frame,
            pred_id,
            pair_gt[order],
            pair_pred[order],
            similarity[order],
            _classes_or_zero(gt_class, len(gt_frame)),
            _classes_or_zero(pred_class, len(pred_frame)),
            tuple(class_names),
            name,
        )

    @cached_property
    def gt_objects(self) -> Int[np.ndarray, "objects"]:
        """Ground-truth ids that occur, ascending."""
        return self._gt_numbering[0]

    @cached_property
    def pred_objects(self) -> Int[np.ndarray, "labels"]:
        """Predicted ids that occur, ascending."""
        return self._pred_numbering[0]

    @cached_property
    def gt_index(self) -> Int[np.ndarray, "G"]:
        """Position of each row's id in `gt_objects`."""
        return self._gt_numbering[1]

    @cached_property
    def pred_index(self) -> Int[np.ndarray, "P"]:
        """Position of each row's id in `pred_objects`."""
        return self._pred_numbering[1]

    @cached_property
    def gt_lengths(self) -> Int[np.ndarray, "objects"]:
        """Frames in which each ground-truth object is visible."""
        return np.bincount(self.gt_index, minlength=len(self.gt_objects))

    @cached_property
    def pred_lengths(self) -> Int[np.ndarray, "labels"]:
        """Frames in which each predicted id occurs."""
        return np.bincount(self.pred_index, minlength=len(self.pred_objects))

    @cached_property
    def pair_frame(self) -> Int[np.ndarray, "K"]:
        """Frame of each pair."""
        return self.gt_frame[self.pair_gt]

    @cached_property
    def gt_counts(self) -> Int[np.ndarray, "T"]:
        """Ground-truth rows of each frame."""
        return np.diff(self.gt_start)

    @cached_property
    def pred_counts(self) -> Int[np.ndarray, "T"]:
        """Predicted rows of each frame."""
        return np.diff(self.pred_start)

    @cached_property
    def gt_start(self) -> Int[np.ndarray, "{self.num_frames}+1"]:
        """First ground-truth row of each frame, and the number of rows."""
        return frame_starts(self.gt_frame, self.num_frames)

    @cached_property
    def pred_start(self) -> Int[np.ndarray, "{self.num_frames}+1"]:
        """First predicted row of each frame, and the number of rows."""
        return frame_starts(self.pred_frame, self.num_frames)

    @cached_property
    def id_pairs(self) -> tuple[Int[np.ndarray, "I"], Int[np.ndarray, "I"], Int[np.ndarray, "K"]]:
        """Pairs of ids that ever overlap (object, label), and which of them each row pair is."""
        num_labels = max(1, len(self.pred_objects))
        key = self.gt_index[self.pair_gt] * num_labels + self.pred_index[self.pair_pred]
        found, member = number_ids(key)
        return found // num_labels, found % num_labels, member

    @cached_property
    def _gt_numbering(self) -> tuple[np.ndarray, np.ndarray]:
        return number_ids(self.gt_id)

    @cached_property
    def _pred_numbering(self) -> tuple[np.ndarray, np.ndarray]:
        return number_ids(self.pred_id)

    def select(
        self, keep_gt: Bool[np.ndarray, "G"], keep_pred: Bool[np.ndarray, "P"]
    ) -> TrackingSequence:
        """The same sequence with only some of its rows, and the pairs between them."""
        new_gt, new_pred = np.cumsum(keep_gt) - 1, np.cumsum(keep_pred) - 1
        kept = keep_gt[self.pair_gt] & keep_pred[self.pair_pred]
        return dataclasses.replace(
            self,
            gt_frame=self.gt_frame[keep_gt],
            gt_id=self.gt_id[keep_gt],
            gt_class=self.gt_class[keep_gt],
            pred_frame=self.pred_frame[keep_pred],
            pred_id=self.pred_id[keep_pred],
            pred_class=self.pred_class[keep_pred],
            pair_gt=new_gt[self.pair_gt[kept]],
            pair_pred=new_pred[self.pair_pred[kept]],
            pair_similarity=self.pair_similarity[kept],
        )

    def select_class(self, class_name: str) -> TrackingSequence:
        """Ground truth and predictions of one class."""
        if class_name not in self.class_names:
            raise SourceError(
                f"{self.name} has no class '{class_name}'; it has {', '.join(self.class_names)}"
            )
        index = self.class_names.index(class_name)
        return self.select(self.gt_class == index, self.pred_class == index)


def number_ids(
    ids: Int[np.ndarray, "N"],
) -> tuple[Int[np.ndarray, "U"], Int[np.ndarray, "N"]]:
    """The distinct ids, ascending, and the position of each id among them."""
    found, member = np.unique(ids, return_inverse=True)
    return found, member


def frame_starts(frame: Int[np.ndarray, "N"], num_frames: int) -> Int[np.ndarray, "{num_frames}+1"]:
    """First row of each frame in rows ordered by frame, and the number of rows at the end."""
    counts = np.bincount(frame, minlength=num_frames)
    return np.concatenate([[0], np.cumsum(counts)])


def _classes_or_zero(classes: Any, num: int) -> np.ndarray:
    if classes is None:
        return np.zeros(num, np.int64)
    classes = np.asarray(classes, np.int64)
    if len(classes) != num:
        raise SourceError(f"{len(classes)} classes were given for {num} rows")
    return classes


def check_rows(
    side: str, name: str, num_frames: int, frame: np.ndarray, ids: np.ndarray, first_frame: int
) -> None:
    """Refuses rows that are not ordered by frame, and ids that occur twice in a frame."""
    if frame.shape != ids.shape or frame.ndim != 1:
        raise SourceError(f"{name}: {len(frame)} frames were given for {len(ids)} {side} ids")
    if not len(frame):
        return
    if frame[0] < 0 or frame[-1] >= num_frames or np.any(np.diff(frame) < 0):
        raise SourceError(
            f"{name}: {side} rows must be ordered by frame, with frames 0 to {num_frames - 1}"
        )
    found, index = number_ids(ids)
    _, member, seen = np.unique(frame * len(found) + index, return_inverse=True, return_counts=True)
    if seen.max() > 1:
        row = int(np.flatnonzero(seen[member] > 1)[0])
        raise SourceError(
            f"{name}, frame {frame[row] + first_frame}: {side} id {ids[row]} occurs "
            f"{seen[member[row]]} times; an id may occur once in a frame"
        )


def _check_pairs(
    name: str,
    gt_frame: np.ndarray,
    pred_frame: np.ndarray,
    pair_gt: np.ndarray,
    pair_pred: np.ndarray,
    similarity: np.ndarray,
) -> None:
    if not pair_gt.shape == pair_pred.shape == similarity.shape:
        raise SourceError(
            f"{name}: {len(pair_gt)} ground-truth rows, {len(pair_pred)} predicted rows and "
            f"{len(similarity)} similarities were given for the pairs; the lengths must agree"
        )
    bad = ~((similarity >= -SIMILARITY_SLACK) & (similarity <= 1 + SIMILARITY_SLACK))
    if bad.any():
        raise SourceError(f"{name}: similarity {similarity[bad][0]} is outside of [0, 1]")
    for side, pair, rows in (
        ("ground-truth", pair_gt, gt_frame),
        ("predicted", pair_pred, pred_frame),
    ):
        if len(pair) and not 0 <= pair.min() <= pair.max() < len(rows):
            raise SourceError(f"{name}: a pair names a {side} row outside of 0 to {len(rows) - 1}")
    if np.any(gt_frame[pair_gt] != pred_frame[pair_pred]):
        raise SourceError(f"{name}: a pair joins a ground truth and a prediction of other frames")
