"""Tours cut into visits: recordings of the same rooms, with things changed in between."""

from __future__ import annotations

import dataclasses
import itertools

from remind_jax.frame import Frame
from remind_jax.synthetic.rendering import RenderedSequence
from remind_jax.synthetic.scene import Scene


def split_visits(sequence: RenderedSequence) -> tuple[RenderedSequence, ...]:
    """One recording per visit: the tour is cut in the middle of every absence.

    Things are moved, added and taken away before the first cut (`SceneOptions.moved` ...). Instance
    ids mean the same in all visits; frames and seconds of each count from 0.
    """
    scene, frames = sequence.scene, sequence.frames
    cuts = [0, *((start + end) // 2 for start, end in scene.path.away), len(frames)]
    visits = []
    for number, (start, end) in enumerate(itertools.pairwise(cuts), start=1):
        named = dataclasses.replace(scene, name=f"{scene.name}-visit{number}")
        kept = [
            _restart(frame, index, frames[start]) for index, frame in enumerate(frames[start:end])
        ]
        visits.append(RenderedSequence(named, tuple(kept)))
    return tuple(visits)


def kept_places(scene: Scene) -> frozenset[int]:
    """Instances that stand in one place through the whole tour."""
    return frozenset(
        item.instance_id
        for item in scene.objects
        if [(place.start_frame, place.end_frame) for place in item.placements] == [(0, None)]
    )


def _restart(frame: Frame, index: int, first: Frame) -> Frame:
    """A frame of a tour as one of a visit."""
    return dataclasses.replace(
        frame,
        index=index,
        source_index=frame.source_index - first.source_index,
        time_s=frame.time_s - first.time_s,
        name=f"{index:05d}",
    )
