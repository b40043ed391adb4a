"""Time of the two solvers: in-graph twins beside host callbacks, in the same run, alternating.

    python benchmarks/solvers.py [--json OUT] [--repeats 15] [--batch 64]

Every row also states whether the results were equal (`labels` may differ where two distances of
random points lie within rounding).
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.solvers.assignment import assign
from remind_jax.solvers.clustering import kmeans

# Detections, objects, classes, detections in use.
ASSIGNMENTS = ((16, 64, 4, 12), (32, 128, 4, 30), (64, 128, 1, 64), (64, 128, 8, 64))
# Patches, detections, dimensions, patches of a detection.
CLUSTERINGS = ((600, 16, 32, 40), (1200, 16, 384, 60), (3600, 16, 384, 100), (3600, 16, 384, 400))
PARTS = {"clusters": 4, "iterations": 5, "restarts": 2, "seed": 0}
RINGS = {"clusters": 24, "iterations": 10, "restarts": 1, "seed": 1}
MAX_BATCH_BYTES = 2**28  # of the features of a batch; larger rows are run one by one only

Solve = Callable[..., jax.Array]


def make_assignment(rng, rows: int, columns: int, classes: int, live: int) -> tuple:
    """Half of the pairs within a class are allowed, so that rows compete."""
    group = rng.integers(0, classes, rows).astype(np.int32)
    allowed = group[:, None] == rng.integers(0, classes, columns)
    allowed &= rng.random((rows, columns)) < 0.5
    allowed[live:] = False
    scores = rng.random((rows, columns)).astype(np.float32)
    return scores, allowed, group, np.full(rows, 0.1, np.float32), np.bool_(True)


def make_clustering(rng, patches: int, sets: int, dims: int, size: int) -> tuple:
    """Unit vectors; sets are runs of patches."""
    points = rng.normal(size=(patches, dims)).astype(np.float32)
    points /= np.linalg.norm(points, axis=1, keepdims=True)
    start = rng.integers(0, patches - size, (sets, 1))
    index = np.arange(patches)
    return points, (index >= start) & (index < start + size)


def list_problems(batch: int) -> Iterator[tuple[str, Callable[[str], Solve], tuple]]:
    """Name, solver to compile and arguments of each row; batches share the switch of dummies."""
    rng = np.random.default_rng(0)
    for shape in ASSIGNMENTS:
        name = f"assign {shape[0]}x{shape[1]}, {shape[2]} classes, {shape[3]} rows"
        one = make_assignment(rng, *shape)
        yield name, lambda solver: partial(assign, solver=solver), one
        many = [make_assignment(rng, *shape) for _ in range(batch)]
        stacked = (*(np.stack(part) for part in list(zip(*many, strict=True))[:4]), one[4])
        axes = (0, 0, 0, 0, None)
        yield (
            f"{name}, vmap {batch}",
            lambda solver, axes=axes: jax.vmap(partial(assign, solver=solver), in_axes=axes),
            stacked,
        )
    for options in (PARTS, RINGS):
        for shape in CLUSTERINGS:
            name = f"kmeans {shape[0]} patches, {shape[1]} sets of {shape[3]}, D {shape[2]}"
            name += f", K {options['clusters']}"
            solve = partial(label, options=options)
            one = make_clustering(rng, *shape)
            yield name, lambda solver, solve=solve: partial(solve, solver=solver), one
            if batch * one[0].nbytes > MAX_BATCH_BYTES or options is RINGS:
                continue
            many = [make_clustering(rng, *shape) for _ in range(batch)]
            yield (
                f"{name}, vmap {batch}",
                lambda solver, solve=solve: jax.vmap(partial(solve, solver=solver)),
                tuple(np.stack(part) for part in zip(*many, strict=True)),
            )


def label(points: Any, members: Any, *, options: dict[str, int], solver: str) -> Any:
    return kmeans(points, members, **options, solver=solver)[0]


def time_ms(run: Callable[[], Any]) -> float:
    start = time.perf_counter()
    jax.block_until_ready(run())
    return 1e3 * (time.perf_counter() - start)


def measure(name: str, compile_for: Callable[[str], Solve], arguments: tuple, repeats: int) -> dict:
    arguments = jax.device_put(arguments)
    twin, host = (jax.jit(compile_for(solver)) for solver in ("jax", "host"))
    compile_s = time_ms(lambda: twin(*arguments)) / 1e3
    equal = float((np.asarray(twin(*arguments)) == np.asarray(host(*arguments))).mean())
    times = [
        (time_ms(lambda: twin(*arguments)), time_ms(lambda: host(*arguments)))
        for _ in range(repeats)
    ]
    ours, theirs = (statistics.median(column) for column in zip(*times, strict=True))
    return {
        "name": f"solvers: {name}",
        "ours_ms": round(ours, 3),
        "peer": "host callback",
        "peer_ms": round(theirs, 3),
        "ratio": round(theirs / ours, 2),
        "equal": round(equal, 6),
        "first_call_s": round(compile_s, 2),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").split("\n")[0])
    parser.add_argument("--json", type=Path, help="write the rows here")
    parser.add_argument("--repeats", type=int, default=15)
    parser.add_argument("--batch", type=int, default=64)
    options = parser.parse_args()
    rows = []
    for name, compile_for, arguments in list_problems(options.batch):
        rows.append(measure(name, compile_for, arguments, options.repeats))
        print(json.dumps(rows[-1]), flush=True)
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
