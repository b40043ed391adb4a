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

ANY_CLASS = "object"  # of all rows, where classes are not told apart
# Similarities are ratios; rounding may lift a perfect overlap this far above 1.
SIMILARITY_SLACK = 1e-9


@dataclasses.dataclass(frozen=True)
class Side:
    """Ground truth or predictions, ordered by frame and, inside a frame, as they were given."""

    num_frames: int
    frame: Int[np.ndarray, "N"]  # 0 ... num_frames - 1
    id: Int[np.ndarray, "N"]  # unique inside a frame
    class_index: Int[np.ndarray, "N"]  # into the class names of the sequence

    def __len__(self) -> int:
        return len(self.id)

    @property
    def objects(self) -> Int[np.ndarray, "U"]:
        """Ids that occur, ascending."""
        return self._numbering[0]

    @property
    def index(self) -> Int[np.ndarray, "N"]:
        """Position of each row's id in `objects`."""
        return self._numbering[1]

    @cached_property
    def lengths(self) -> Int[np.ndarray, "U"]:
        """Frames in which each id occurs."""
        return np.bincount(self.index, minlength=len(self.objects))

    @cached_property
    def counts(self) -> Int[np.ndarray, "T"]:
        """Rows of each frame."""
        return np.bincount(self.frame, minlength=self.num_frames)

    @cached_property
    def start(self) -> Int[np.ndarray, "_"]:
        """First row of each frame, and the number of rows."""
        return np.concatenate([[0], np.cumsum(self.counts)])

    @cached_property
    def _numbering(self) -> tuple[np.ndarray, np.ndarray]:
        return np.unique(self.id, return_inverse=True)

    def select(self, keep: Bool[np.ndarray, "N"]) -> Side:
        """Only some of the rows."""
        return Side(self.num_frames, self.frame[keep], self.id[keep], self.class_index[keep])


@dataclasses.dataclass(frozen=True)
class TrackingSequence:
    """Ground truth and predictions of one sequence; build with `create`, which checks them.

    Pairs are ordered by ground-truth row, then predicted row.
    """

    gt: Side
    pred: Side
    pair_gt: Int[np.ndarray, "K"]  # row of the ground truth
    pair_pred: Int[np.ndarray, "K"]  # row of the prediction
    pair_similarity: Float[np.ndarray, "K"]  # (0, 1]
    class_names: tuple[str, ...] = (ANY_CLASS,)
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
        class_names: Sequence[str] = (ANY_CLASS,),
        name: str = "sequence",
        first_frame: int = 0,
    ) -> TrackingSequence:
        """Builds a sequence from flat tables and checks it as TrackEval does.

        Args:
          ground_truth: Frame `[G]` and id `[G]` of each row, frames not falling.
          predictions: Frame `[P]` and id `[P]` of each row, frames not falling.
          pairs: Ground-truth row `[K]`, predicted row `[K]`, similarity `[K]` in [0, 1].

        Raises:
          SourceError: If a number is no whole one, an id occurs twice in one frame, a frame is
            outside of the sequence, a pair is given twice or joins different frames, or a
            similarity is outside of [0, 1].
        """
        gt, pred = (
            _make_side(int(num_frames), *rows, classes)
            for rows, classes in ((ground_truth, gt_class), (predictions, pred_class))
        )
        pair_gt, pair_pred = (_whole("row numbers of pairs", column) for column in pairs[:2])
        similarity = np.asarray(pairs[2], np.float64)
        _check_rows("ground truth", name, gt, first_frame)
        _check_rows("prediction", name, pred, first_frame)
        _check_pairs(name, gt.frame, pred.frame, pair_gt, pair_pred, similarity)
        order = np.flatnonzero(similarity > 0)
        rank = pair_gt[order] * max(1, len(pred)) + pair_pred[order]
        if np.any(np.diff(rank) <= 0):
            order = order[np.argsort(rank, kind="stable")]
            if np.any(np.diff(np.sort(rank)) == 0):
                raise SourceError(f"{name}: a pair is given twice; give the overlap of each once")
        pairs = pair_gt[order], pair_pred[order], similarity[order]
        return cls(gt, pred, *pairs, tuple(class_names), name)

    @property
    def num_frames(self) -> int:
        """Of the sequence."""
        return self.gt.num_frames

    @cached_property
    def pair_frame(self) -> Int[np.ndarray, "K"]:
        """Frame of each pair."""
        return self.gt.frame[self.pair_gt]

    @cached_property
    def id_pairs(self) -> tuple[Int[np.ndarray, "I"], Int[np.ndarray, "I"], Int[np.ndarray, "K"]]:
        """Pairs of ids that ever overlap (object, label), and which of them each row pair is."""
        num_labels = max(1, len(self.pred.objects))
        key = self.gt.index[self.pair_gt] * num_labels + self.pred.index[self.pair_pred]
        found, member = np.unique(key, return_inverse=True)
        return found // num_labels, found % num_labels, member

    def select(
        self, keep_gt: Bool[np.ndarray, "G"], keep_pred: Bool[np.ndarray, "P"]
    ) -> TrackingSequence:
        """The same sequence with only some of its rows, and the pairs between them."""
        new_gt, new_pred = np.cumsum(keep_gt) - 1, np.cumsum(keep_pred) - 1
        kept = keep_gt[self.pair_gt] & keep_pred[self.pair_pred]
        return dataclasses.replace(
            self,
            gt=self.gt.select(keep_gt),
            pred=self.pred.select(keep_pred),
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
        return self.select(self.gt.class_index == index, self.pred.class_index == index)


def _make_side(num_frames: int, frame: Any, ids: Any, classes: Any) -> Side:
    """Rows of one class if none are given."""
    frame, ids = _whole("frames", frame), _whole("ids", ids)
    classes = np.zeros(len(frame), np.int64) if classes is None else _whole("classes", classes)
    if len(classes) != len(frame):
        raise SourceError(f"{len(classes)} classes were given for {len(frame)} rows")
    return Side(num_frames, frame, ids, classes)


def _whole(what: str, given: Any) -> Int[np.ndarray, "N"]:
    values = np.asarray(given)
    numbers = values.astype(np.int64)
    if values.dtype.kind == "f" and np.any(numbers != values):
        raise SourceError(f"{what} are whole numbers, found {values[numbers != values][0]}")
    return numbers


def _check_rows(side: str, name: str, rows: Side, first_frame: int) -> None:
    """Refuses rows that are not ordered by frame, and ids that occur twice in a frame."""
    frame, ids = rows.frame, rows.id
    if frame.shape != ids.shape or frame.ndim != 1:
        raise SourceError(f"{name}: {len(frame)} frames were given for {len(ids)} {side} ids")
    if not len(frame):
        return
    if frame[0] < 0 or frame[-1] >= rows.num_frames or np.any(np.diff(frame) < 0):
        raise SourceError(
            f"{name}: {side} rows must be ordered by frame, with frames 0 to {rows.num_frames - 1}"
        )
    key = frame * len(rows.objects) + rows.index
    _, member, seen = np.unique(key, return_inverse=True, return_counts=True)
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
