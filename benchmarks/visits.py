"""Two visits, one memory: does the second recording know what the first one saw?

    python benchmarks/visits.py [--pairs 5] [--config default] [--keep FOLDER] [--json OUT]

Each pair is a rendered tour that is cut while the camera is out of its first room; in between a
fifth of the objects of that room is moved, a tenth taken away, a tenth added, and the light is
another one. The first visit is tracked from an empty memory, the second from the file that it left.
Objects that were not moved are also counted apart.
"""

from __future__ import annotations

import argparse
import dataclasses
import itertools
import json
import sys
import tempfile
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import remind_jax as rj
from benchmarks.visit_scores import VisitCounts, score_visits, visit_scores
from remind_jax.frame import Frame
from remind_jax.metrics.combine import pool_counts
from remind_jax.printing.terminal import print_table
from remind_jax.synthetic import LookalikeGroup, SceneOptions, render_sequence
from remind_jax.synthetic.rendering import RenderedSequence
from remind_jax.synthetic.scene import Scene

HEADS = (
    "pair",
    "returning",
    "IDF1",
    "recovery within",
    "recovery across",
    "unmoved recognized",
    "recognized",
    "at once",
    "false recognitions",
)
FIRST_SEED = 900


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


def options_of(seed: int) -> SceneOptions:
    """The tour behind one pair of visits."""
    return SceneOptions(
        name=f"pair{seed}",
        seed=seed,
        min_mask_px=400,
        objects_per_room=12,
        lookalikes=(LookalikeGroup("mug", 3, "glaze"), LookalikeGroup("box", 2, "identical")),
        moved=0.2,
        removed=0.1,
        added=0.1,
    )


@dataclasses.dataclass(frozen=True)
class Pair:
    """What two visits came to."""

    scores: dict[str, float]
    all: VisitCounts
    still: VisitCounts  # objects that stood in one place


def run_pair(seed: int, config: str, folder: Path) -> Pair:
    """Renders a pair of visits and tracks both, the second with the memory of the first."""
    sequence = render_sequence(options_of(seed))
    still = kept_places(sequence.scene)
    runs: dict[str, tuple[rj.Tracks, ...]] = {}
    memory = None
    for visit in split_visits(sequence):
        out = folder / visit.scene.name
        result = rj.run(
            list(visit.frames), config=config, memory=memory, out=out, overlay=False, progress=False
        )
        memory = out / "memory.safetensors"
        runs[visit.scene.name] = result.tracks
    whole = score_visits(runs)
    of_still = score_visits({name: _only(tracks, still) for name, tracks in runs.items()})
    return Pair(whole.scores(), pool_counts(whole.counts), pool_counts(of_still.counts))


def _only(tracks: tuple[rj.Tracks, ...], instances: frozenset[int]) -> list[rj.Tracks]:
    """The frames with what is no such instance taken for nothing true."""
    return [
        dataclasses.replace(
            frame,
            instance_ids=np.where(
                np.isin(frame.instance_ids, sorted(instances)), frame.instance_ids, -1
            ),
        )
        for frame in tracks
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=5)
    parser.add_argument("--config", default="default")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args()
    rows: list[tuple[str, ...]] = []
    pairs: list[Pair] = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = options.keep or Path(temporary)
        for seed in range(FIRST_SEED, FIRST_SEED + options.pairs):
            pairs.append(run_pair(seed, options.config, folder))
            rows.append((str(seed), *_cells([pairs[-1]])))
    rows.append(("all", *_cells(pairs)))
    print_table([HEADS, *rows])
    if options.json is not None:
        content = {HEADS[0]: [dict(zip(HEADS, row, strict=True)) for row in rows]}
        options.json.write_text(json.dumps(content, indent=1) + "\n")


def _cells(pairs: list[Pair]) -> tuple[str, ...]:
    every = visit_scores(pool_counts([pair.all for pair in pairs]))
    still = visit_scores(pool_counts([pair.still for pair in pairs]))
    mean = {
        name: float(np.mean([pair.scores[name] for pair in pairs]))
        for name in ("IDF1", "RecoveryWithinVisits", "RecoveryAcrossVisits")
    }
    shares = (
        *mean.values(),
        float(still["Recognized"]),
        float(every["Recognized"]),
        float(every["RecognizedAtOnce"]),
        float(every["FalseRecognitions"]),
    )
    return f"{every['ReturningObjects']:.0f}", *(f"{100 * share:.1f}" for share in shares)


if __name__ == "__main__":
    main()
