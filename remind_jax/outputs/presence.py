"""When each identity was seen, gone and back, and in doubt."""

from __future__ import annotations

import bisect
import collections
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from remind_jax.decision import NO_ID, Outcome
from remind_jax.formats.firm import main_labels
from remind_jax.tracks import Tracks, title_of

# Shorter gaps are flicker of detector or decision, not an absence worth a mark.
MIN_ABSENCE_FRAMES = 5

UNDECIDED = (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_NEW, Outcome.PROVISIONAL_PARENT)

Span = tuple[int, int]  # first and last, both included


@dataclasses.dataclass(frozen=True)
class ObjectHistory:
    """When one identity was seen. Frames are `Tracks.frame_index`."""

    object_id: int
    label: str  # of most of its detections
    title: str  # its name, else class and id
    num_frames: int  # frames with a firm detection
    seen: tuple[Span, ...]  # frames with a firm detection
    candidate: tuple[Span, ...]  # frames in which an undecided detection may be this one
    absences: tuple[Span, ...]  # frames without it, where these are enough

    @property
    def first_frame(self) -> int:
        """Of the first firm detection."""
        return self.seen[0][0]

    @property
    def last_frame(self) -> int:
        """Of the last firm detection."""
        return self.seen[-1][1]

    @property
    def returns(self) -> tuple[int, ...]:
        """The frame after each absence."""
        starts = [first for first, _ in self.seen]
        return tuple(starts[bisect.bisect(starts, last)] for _, last in self.absences)


def find_histories(run: Sequence[Tracks], min_absence_frames: int) -> tuple[ObjectHistory, ...]:
    """Every identity of a run, by rising id."""
    seen: dict[int, list[int]] = collections.defaultdict(list)
    candidate: dict[int, list[int]] = collections.defaultdict(list)
    labels = main_labels(run, [tracks.object_id for tracks in run])
    names: Mapping[int, str] = {}
    for position, tracks in enumerate(run):
        for object_id in tracks.object_id[tracks.object_id != NO_ID].tolist():
            seen[object_id].append(position)
        names = tracks.names
        undecided = np.isin(tracks.outcome, UNDECIDED)
        for object_id in np.unique(tracks.candidate_id[undecided]).tolist():
            candidate[object_id].append(position)

    def by_number(spans: Iterable[Span]) -> tuple[Span, ...]:
        return tuple((run[first].frame_index, run[last].frame_index) for first, last in spans)

    found = []
    for object_id, label in sorted(labels.items()):
        spans = join_positions(seen[object_id])
        gaps = [(one[1] + 1, other[0] - 1) for one, other in itertools.pairwise(spans)]
        found.append(
            ObjectHistory(
                object_id,
                label,
                title_of(label, object_id, names),
                sum(last - first + 1 for first, last in spans),
                by_number(spans),
                by_number(join_positions(candidate[object_id])),
                by_number(gap for gap in gaps if gap[1] - gap[0] + 1 >= min_absence_frames),
            )
        )
    return tuple(found)


def join_positions(positions: Iterable[int]) -> tuple[Span, ...]:
    """Joins rising positions into spans without gaps; repeated positions count once."""
    spans: list[list[int]] = []
    for position in positions:
        if spans and position <= spans[-1][1] + 1:
            spans[-1][1] = position
        else:
            spans.append([position, position])
    return tuple((first, last) for first, last in spans)
