"""Real clips with saved detections, and what the answers about them are worth (`realvideo.py`)."""

from __future__ import annotations

import collections
import dataclasses
import functools
import gzip
import itertools
import json
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from benchmarks.field_scoring import first_sayings
from remind_jax.metrics import TrackingSequence, evaluate_sequence
from remind_jax.metrics.combine import ratio
from remind_jax.metrics.evaluation import Evaluation
from remind_jax.metrics.recovery import NO_LABEL, collect_answers, find_reference
from remind_jax.sources import open_source

ABSENT = 10  # frames; who is away for longer returns
SHARED = 5  # rows of each, from which on two objects are merged
SURE = 0.97
_BINS = 10


@dataclasses.dataclass(frozen=True)
class Clip:
    """A clip and its truth; `R` rows are the detections that the truth knows, ordered by frame."""

    name: str
    folder: Path
    lines: tuple[dict[str, Any], ...]  # the file of detections
    labels: tuple[tuple[int, ...], ...]  # the true object of every detection of every frame, or 0
    class_of: dict[int, str]

    @functools.cached_property
    def rows(self) -> Int[np.ndarray, "3 R"]:
        """Frame, detection and true object."""
        rows = [(t, d, g) for t, row in enumerate(self.labels) for d, g in enumerate(row) if g]
        return np.array(rows, int).reshape(-1, 3).T

    def open(self, scratch: Path) -> Any:
        """Its frames with their detections, which are written into a folder."""
        masks = scratch / f"{self.name}.jsonl"
        masks.write_text("".join(json.dumps(line) + "\n" for line in self.lines))
        return open_source(self.folder / "JPEGImages" / self.name, masks=masks)

    def one_class(self) -> Clip:
        """The same with one class for everything."""
        return dataclasses.replace(self, lines=self._with(lambda d: [{**d, "label": "thing"}])[0])

    def only(self, label: str) -> Clip:
        """The same with the detections of one class."""
        lines, labels = self._with(lambda d: [d] if d["label"] == label else [])
        return dataclasses.replace(self, lines=lines, labels=labels)

    def judged_by(self, label: str) -> Clip:
        """The same, with a truth of the detections of one class."""
        labels = tuple(
            tuple(
                g if d["label"] == label else 0
                for g, d in zip(row, line["detections"], strict=True)
            )
            for row, line in zip(self.labels, self.lines, strict=True)
        )
        return dataclasses.replace(self, labels=labels)

    def _with(self, change: Callable[[dict[str, Any]], list[dict[str, Any]]]) -> tuple[Any, Any]:
        """Lines and labels with every detection changed into none or one."""
        changed = [[change(one) for one in line["detections"]] for line in self.lines]
        lines = (
            {**line, "detections": [one for some in own for one in some]}
            for line, own in zip(self.lines, changed, strict=True)
        )
        labels = (
            tuple(label for label, some in zip(row, own, strict=True) if some)
            for row, own in zip(self.labels, changed, strict=True)
        )
        return tuple(lines), tuple(labels)


@dataclasses.dataclass(frozen=True)
class Answers:
    """What a tracker said of every row of a clip."""

    ids: Int[np.ndarray, "R"]  # -1: nothing
    confidence: Float[np.ndarray, "R"]  # NaN without one
    became: dict[int, int] = dataclasses.field(default_factory=dict)  # identities declared another
    seconds: float = float("nan")


@dataclasses.dataclass(frozen=True)
class Counts:
    """What is counted beside the usual scores; counts of several clips add up."""

    returns: Any
    recovered: Any
    kept: Any
    at_once: Any
    pairs: Any  # of objects of one class
    merged: Any
    sure: Any
    sure_right: Any
    binned: Any  # [..., bins] answers by confidence
    binned_sure: Any  # [..., bins] sums of their confidence
    binned_right: Any  # [..., bins]


@dataclasses.dataclass(frozen=True)
class Judged:
    """One tracker on one clip."""

    evaluation: Evaluation
    counts: Counts
    seconds: float


def find_clips(folder: Path, wanted: Sequence[str] = ()) -> list[Clip]:
    """The clips of a folder, by name."""
    return [
        _read_clip(file.parent)
        for file in sorted(folder.glob("*/metadata.json"))
        if not wanted or file.parent.name in wanted
    ]


def _read_clip(folder: Path) -> Clip:
    told = json.loads((folder / "metadata.json").read_text())
    (packed,) = folder.glob("*.jsonl.gz")
    lines = tuple(map(json.loads, gzip.decompress(packed.read_bytes()).splitlines()))
    labels = tuple(map(tuple, told["labels_of_detections"]))
    classes = {int(number): name for number, name in told["id_to_class"].items()}
    return Clip(folder.name, folder, lines, labels, classes)


def judge(clip: Clip, answers: Answers) -> Judged:
    """Scores the answers about a clip; who is right is who has most rows, one to one."""
    frame, _, instance = clip.rows
    said = answers.ids != NO_LABEL
    rows = first_sayings(frame, answers.ids)
    sequence = TrackingSequence.create(
        len(clip.labels),
        (frame, instance),
        (frame[rows], answers.ids[rows]),
        (rows, np.arange(len(rows)), np.ones(len(rows))),
        name=clip.name,
    )
    given = collect_answers(sequence)
    reference = find_reference(given)
    right = said & (given.label == reference[np.searchsorted(given.objects, instance)])
    visits = [visit for own in _visits(clip) for visit in own[1:]]
    rated = said & np.isfinite(answers.confidence)
    sure, hit = answers.confidence[rated], right[rated]
    place = np.minimum((_BINS * sure).astype(int), _BINS - 1)
    merged, pairs = _merged(clip, answers)
    binned = [np.bincount(place, each, _BINS) for each in (None, sure, hit)]
    counts = (
        len(visits),
        sum(right[visit].any() for visit in visits),
        sum(2 * right[visit].sum() > len(visit) for visit in visits),
        sum(right[visit[0]] for visit in visits),
        pairs,
        merged,
        (sure >= SURE).sum(),
        hit[sure >= SURE].sum(),
        *binned,
    )
    return Judged(evaluate_sequence(sequence), Counts(*map(np.asarray, counts)), answers.seconds)


def _visits(clip: Clip) -> Iterable[list[np.ndarray]]:
    """The rows of every visit of every object, in order."""
    frame, _, instance = clip.rows
    for number in np.unique(instance):
        own = np.flatnonzero(instance == number)
        yield np.split(own, np.flatnonzero(np.diff(frame[own]) > ABSENT) + 1)


def _merged(clip: Clip, answers: Answers) -> tuple[int, int]:
    """Pairs of objects of one class that share an identity, and all such pairs."""
    called: dict[int, set[int]] = {}
    for number in np.unique(clip.rows[2]).tolist():
        own = answers.ids[(clip.rows[2] == number) & (answers.ids != NO_LABEL)].tolist()
        names = collections.Counter(_final(answers.became, one) for one in own)
        called[number] = {name for name, num in names.items() if num >= SHARED}
    same = [
        bool(called[a] & called[b])
        for a, b in itertools.combinations(called, 2)
        if clip.class_of[a] == clip.class_of[b]
    ]
    return sum(same), len(same)


def _final(became: dict[int, int], number: int) -> int:
    seen = set()
    while number in became and number not in seen:
        seen.add(number)
        number = became[number]
    return number


def extra_scores(counts: Counts) -> dict[str, Any]:
    distance = np.abs(counts.binned_sure - counts.binned_right).sum(-1)
    counted = ("returns", "recovered", "kept", "at_once", "pairs", "merged")
    return {
        **{name: getattr(counts, name) for name in counted},
        "sure_right": ratio(counts.sure_right, counts.sure),
        "ece": ratio(distance, counts.binned.sum(-1)),
    }
