"""Two visits of the same rooms by different ways, learned apart and joined, against one memory.

    python benchmarks/joined.py [--pairs 4] [--rooms 2,3] [--keep FOLDER] [--json OUT]

Each pair is a rendered tour that is cut where the camera turns back in the last room: it sees the
rooms on its way there, and again from other places on its way back, while the light fades. Both
visits are tracked from an empty memory and the memories are joined; the second is also tracked with
the memory of the first. IDF1 is that of both visits as one.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import remind_jax as rj
from benchmarks.rows import show_rows
from benchmarks.visit_scores import score_visits
from benchmarks.visits import FIRST_SEED, options_of, split_visits
from remind_jax.numerics.absent import NO_ID
from remind_jax.outputs.writer import MEMORY_NAME
from remind_jax.session.changed_memory import JoinedObjects, join_memories
from remind_jax.session.memory_file import load_memory
from remind_jax.synthetic import SceneOptions, render_sequence
from remind_jax.tracks import Tracks

Visit = tuple[Tracks, ...]


def tour_of(seed: int, num_rooms: int) -> SceneOptions:
    """A tour through rooms in which nothing is moved."""
    absence = 44 * (num_rooms - 1)
    return dataclasses.replace(
        options_of(seed),
        num_rooms=num_rooms,
        absence_frames=absence,
        frames=76 + absence,
        moved=0.0,
        removed=0.0,
        added=0.0,
    )


def follow(frames: list[Any], memory: Path | None, out: Path) -> Visit:
    """Tracks a visit; leaves its memory in a folder."""
    result = rj.run(frames, memory=memory, out=out, overlay=False, progress=False, overwrite=True)
    return tuple(result.tracks)


def as_joined(visit: Visit, joined: JoinedObjects) -> list[Tracks]:
    """The second visit by the ids of the joined memory."""
    kept = {gone: one for one, gone in joined.matched}
    now = {one: kept.get(number, number) for one, number in joined.ids.items()} | {NO_ID: NO_ID}
    beyond = max(now.values()) + 1  # what the memory has no more; no id is shared
    return [
        dataclasses.replace(
            tracks,
            object_id=np.array(
                [now.get(one, beyond + one) for one in tracks.object_id.tolist()],
                tracks.object_id.dtype,
            ),
        )
        for tracks in visit
    ]


def instances(visit: Visit) -> dict[int, int]:
    """The true instance of each id: the most frequent one."""
    counts: dict[int, collections.Counter[int]] = collections.defaultdict(collections.Counter)
    for tracks in visit:
        for one, instance in zip(
            tracks.object_id.tolist(), tracks.instance_ids.tolist(), strict=True
        ):
            counts[one][instance] += 1
    return {one: of_one.most_common(1)[0][0] for one, of_one in counts.items() if one != NO_ID}


def measure(name: str, first: Visit, second: Visit, after: Visit, folder: Path) -> dict[str, Any]:
    """One row; `after`: the second visit tracked with the memory of the first."""
    memory, added = (load_memory(folder / one / MEMORY_NAME) for one in ("first", "second"))
    known = memory.object_ids()
    _, joined = join_memories(memory, added, folder)
    truth, other = instances(first), instances(second)
    there = {here: one for one, here in joined.ids.items()}
    shared = {truth[one] for one in known if one in truth} & {
        other[one] for one in joined.ids if one in other
    }
    right = sum(truth.get(kept) == other.get(there[gone]) for kept, gone in joined.matched)
    scores = {
        which: 100 * score_visits({"first": first, "second": visit}).scores()["IDF1"]
        for which, visit in (("one_memory", after), ("joined", as_joined(second, joined)))
    }
    return {
        "name": name,
        "shared": len(shared),
        "matched": right,
        "wrong": len(joined.matched) - right,
        "ambiguous": len(joined.ambiguous),
        **{f"IDF1_{which}": score for which, score in scores.items()},
    }


def rows(options: argparse.Namespace, folder: Path) -> Iterator[dict[str, Any]]:
    """Each pair, and all of a number of rooms."""
    for num_rooms in map(int, options.rooms.split(",")):
        found = []
        for seed in range(FIRST_SEED, FIRST_SEED + options.pairs):
            visits = split_visits(render_sequence(tour_of(seed, num_rooms)))
            kept = folder / f"{num_rooms}-{seed}"
            memory = kept / "first" / MEMORY_NAME
            first = follow(list(visits[0].frames), None, kept / "first")
            second = follow(list(visits[1].frames), None, kept / "second")
            after = follow(list(visits[1].frames), memory, kept / "after")
            found.append(measure(f"{num_rooms} rooms, {seed}", first, second, after, kept))
            yield found[-1]
        yield {"name": f"{num_rooms} rooms, all"} | {
            key: float(np.mean([row[key] for row in found])) for key in found[0] if key != "name"
        }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--pairs", type=int, default=4)
    parser.add_argument("--rooms", default="2,3")
    parser.add_argument("--keep", type=Path, metavar="FOLDER")
    parser.add_argument("--json", type=Path, metavar="OUT")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        show_rows(rows(options, options.keep or Path(temporary)), options.json)


if __name__ == "__main__":
    main()
