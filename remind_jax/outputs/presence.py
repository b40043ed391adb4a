"""When each identity was seen, gone and back, and in doubt; positions count frames from 0."""

from __future__ import annotations

import collections
import dataclasses
import itertools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np

from remind_jax.decision import NO_ID, Outcome
from remind_jax.tracks import Tracks, title_of

# Shorter gaps are flicker of detector or decision, not an absence worth a mark.
MIN_ABSENCE_FRAMES = 5

UNDECIDED = (Outcome.AMBIGUOUS, Outcome.PROVISIONAL_NEW, Outcome.PROVISIONAL_PARENT)

Span = tuple[int, int]  # first and last position, both included


@dataclasses.dataclass(frozen=True)
class Presence:
    """One identity over time."""

    object_id: int
    label: str
    title: str  # its name, else class and id
    seen: tuple[Span, ...]  # frames with a firm detection
    candidate: tuple[Span, ...]  # frames in which an undecided detection may be this one
    absences: tuple[Span, ...]  # gaps that are long enough

    @property
    def num_frames(self) -> int:
        """Frames with a firm detection."""
        return sum(last - first + 1 for first, last in self.seen)

    @property
    def returns(self) -> tuple[int, ...]:
        """The position after each absence."""
        return tuple(last + 1 for _, last in self.absences)


@dataclasses.dataclass(frozen=True)
class ObjectHistory:
    """When one identity was seen. Frame numbers are `Tracks.frame_index`."""

    object_id: int
    label: str
    title: str  # its name, else class and id
    first_frame: int
    last_frame: int
    num_frames: int  # frames with a firm detection
    absences: tuple[Span, ...]  # first and last frame without it, both included
    returns: tuple[int, ...]  # the frame after each absence


def find_presences(
    run: Iterable[Tracks], min_absence_frames: int = MIN_ABSENCE_FRAMES
) -> list[Presence]:
    """Every identity of a run, by rising id."""
    seen: dict[int, list[int]] = collections.defaultdict(list)
    candidate: dict[int, list[int]] = collections.defaultdict(list)
    labels: dict[int, str] = {}
    names: Mapping[int, str] = {}
    for position, tracks in enumerate(run):
        for object_id, label in zip(tracks.object_id.tolist(), tracks.labels, strict=True):
            if object_id != NO_ID:
                seen[object_id].append(position)
                labels.setdefault(object_id, label)
        names = tracks.names
        undecided = np.isin(tracks.outcome, UNDECIDED)
        for object_id in np.unique(tracks.candidate_id[undecided]).tolist():
            candidate[object_id].append(position)
    found = []
    for object_id, label in sorted(labels.items()):
        spans = join_positions(seen[object_id])
        gaps = [(one[1] + 1, other[0] - 1) for one, other in itertools.pairwise(spans)]
        absences = tuple(gap for gap in gaps if gap[1] - gap[0] + 1 >= min_absence_frames)
        doubts = join_positions(candidate[object_id])
        title = title_of(label, object_id, names)
        found.append(Presence(object_id, label, title, spans, doubts, absences))
    return found


def find_histories(run: Sequence[Tracks], min_absence_frames: int) -> tuple[ObjectHistory, ...]:
    """The same by the numbers of the frames."""
    number = [tracks.frame_index for tracks in run]
    return tuple(
        ObjectHistory(
            object_id=one.object_id,
            label=one.label,
            title=one.title,
            first_frame=number[one.seen[0][0]],
            last_frame=number[one.seen[-1][1]],
            num_frames=one.num_frames,
            absences=tuple((number[first], number[last]) for first, last in one.absences),
            returns=tuple(number[position] for position in one.returns),
        )
        for one in find_presences(run, min_absence_frames)
    )


def join_positions(positions: Iterable[int]) -> tuple[Span, ...]:
    """Joins rising positions into spans without gaps; repeated positions count once."""
    spans: list[list[int]] = []
    for position in positions:
        if spans and position <= spans[-1][1] + 1:
            spans[-1][1] = position
        else:
            spans.append([position, position])
    return tuple((first, last) for first, last in spans)
