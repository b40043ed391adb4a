"""What the compiled step of every method consists of, and where it comes from.

    python benchmarks/program.py                          all methods
    python benchmarks/program.py --methods plus --where 20
    python benchmarks/program.py --traced --json rows.json    with the programs that trace

Counts are exact and the same on every machine with one version of JAX: equations of the traced
program (those of loops and branches included), lines of StableHLO, fusions and loops of the
compiled one, and the bytes that it needs for the time being. Seconds are those of the processor.
`--where N` adds the N modules and the N lines that most instructions come from.
"""

from __future__ import annotations

import argparse
import collections
import dataclasses
import itertools
import re
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.light_changes import NUM_DIRECTIONS
from benchmarks.rows import show_rows
from remind_jax.compiled.compiler_options import compiler_options
from remind_jax.masks.closeups import CLOSEUP_PATCHES
from remind_jax.masks.reduction import pad_masks, reduce_masks
from remind_jax.method import Method, get_method, list_methods
from remind_jax.observation import AnyFeats, CloseupFeats, FrameFeats
from remind_jax.static import Static

STATIC = Static(feature_dim=223)
PATCHES = (30, 40)  # rows and columns of a frame of 640x480 pixels
PATCH_PX = 16
_INSTRUCTION = re.compile(r"^\s+(?:ROOT )?%?([\w.\-]+) = (?:\(.*?\)|\S+) ([\w\-]+)\(")
_COMPUTATION = re.compile(r"^(?:ENTRY )?%?([\w.\-]+) \(.*\{$")
# What only names values, or is part of another instruction.
_NO_WORK = {"parameter", "get-tuple-element", "tuple", "constant", "bitcast"}


NO_PLACE = "no place recorded"


@dataclasses.dataclass(frozen=True)
class Instruction:
    """One instruction of a compiled program, and where in this package it comes from."""

    name: str
    kind: str
    module: str
    line: int


@dataclasses.dataclass(frozen=True)
class Measured:
    """One program."""

    row: dict[str, Any]
    modules: collections.Counter[str]  # instructions by module of this package
    lines: collections.Counter[str]  # and by line


def example_input(method: Method) -> tuple[AnyFeats, Any, Any]:
    """Features, masks and what is observed of an empty frame, with the sizes of `STATIC`.

    Features are those of closeups where the method prefers these.
    """
    rows, columns = PATCHES
    size = (rows * PATCH_PX, columns * PATCH_PX)
    feats: AnyFeats = FrameFeats(
        np.zeros((rows, columns, STATIC.feature_dim), np.float32), np.array(size, np.int32)
    )
    if method.needs.prefers_closeups:
        shape = (STATIC.num_detections, CLOSEUP_PATCHES, CLOSEUP_PATCHES)
        feats = CloseupFeats(
            np.zeros((*shape, STATIC.feature_dim), np.float32),
            np.zeros(shape, np.float32),
            np.zeros(STATIC.feature_dim, bool),
            np.zeros((NUM_DIRECTIONS, STATIC.feature_dim), np.float32),
            feats.frame_size,
        )
    gaps = {"exact_gap_max": None} if method.needs.gap_options is None else {}
    nothing = reduce_masks(
        np.zeros((0, *size), bool), np.zeros(0, np.int32), np.zeros(0), num_slots=0,
        patch_px=PATCH_PX, **gaps,
    )  # fmt: skip
    observed = None if method.needs.observe is None else method.needs.observe(None, None, None)
    return feats, pad_masks(nothing, STATIC.num_detections), observed


def programs_of(method: Method, traced: bool) -> Iterator[tuple[str, Callable[..., Any], tuple]]:
    """Name, function and arguments of the programs of a method.

    With `traced`, only the one that decides, with what its decisions were made of.
    """
    thresholds = jax.tree.map(jnp.asarray, method.settings())
    given, static = example_input(method), dataclasses.replace(STATIC, switches=method.switches())

    def describe(given: Any, thresholds: Any) -> Any:
        return method.describe(*given, static=static, thresholds=thresholds)

    def decide(state: Any, seen: Any, thresholds: Any) -> Any:
        answer = method.decide(state, seen, static=static, thresholds=thresholds)
        return answer if traced else answer[0]

    if not traced:
        yield "describe", describe, (given, thresholds)
    seen = jax.jit(describe)(given, thresholds)
    yield "decide", decide, (method.init(static), seen, thresholds)


def measure(name: str, method: Method, function: Callable[..., Any], arguments: tuple) -> Measured:
    """Traces, lowers, compiles and runs a program of a method."""
    start = time.process_time()
    traced = jax.jit(function, compiler_options=compiler_options()).trace(*arguments)
    lowered = traced.lower()
    prepared = time.process_time()
    compiled = lowered.compile()
    done = time.process_time()
    text = compiled.as_text() or ""
    kinds, modules, lines = count_instructions(text)
    used = compiled.memory_analysis()
    row = {
        "name": name,
        "equations": count_equations(traced.jaxpr.jaxpr),
        "stablehlo_lines": len(lowered.as_text().splitlines()),
        "fusions": kinds["fusion"],
        "loops": kinds["while"],
        "temporary_bytes": 0 if used is None else int(used.temp_size_in_bytes),
        "trace_cpu_s": prepared - start,
        "compile_cpu_s": done - prepared,
        "run_cpu_ms": _time_runs(compiled, arguments),
    }
    return Measured(row, modules, lines)


def count_equations(jaxpr: Any) -> int:
    """Equations of a traced program, with those of its loops, branches and calls."""
    total = len(jaxpr.eqns)
    for equation in jaxpr.eqns:
        for inner in jax.tree.leaves(
            tuple(equation.params.values()), is_leaf=lambda leaf: hasattr(leaf, "eqns")
        ):
            inner = getattr(inner, "jaxpr", inner)
            total += count_equations(inner) if hasattr(inner, "eqns") else 0
    return total


def count_instructions(
    text: str,
) -> tuple[collections.Counter[str], collections.Counter[str], collections.Counter[str]]:
    """Instructions of a compiled program that run on their own: by kind, module and line."""
    kinds, modules, lines = (collections.Counter[str]() for _ in range(3))
    for one in read_instructions(text):
        kinds[one.kind] += 1
        modules[one.module] += 1
        lines[f"{one.module}:{one.line}"] += 1
    return kinds, modules, lines


def read_instructions(text: str) -> Iterator[Instruction]:
    """Instructions of a compiled program that run on their own."""
    place_of = _read_places(text)
    is_fused = False
    for line in text.splitlines():
        if found := _COMPUTATION.match(line):
            is_fused = "fused" in found[1] or "wrapped" in found[1]
        elif not is_fused and (found := _INSTRUCTION.match(line)) and found[2] not in _NO_WORK:
            frame = re.search(r"stack_frame_id=(\d+)", line)
            place = place_of(int(frame[1])) if frame else (NO_PLACE, 0)
            yield Instruction(found[1], found[2], *place)


def _read_places(text: str) -> Callable[[int], tuple[str, int]]:
    """Module and line of a stack frame: the innermost of this package."""

    def table(name: str) -> dict[int, str]:
        found = re.search(rf"^{name}\n(.*?)\n\n", text, re.MULTILINE | re.DOTALL)
        rows = [line.split(" ", 1) for line in found[1].splitlines()] if found else []
        return {int(number): rest for number, rest in rows}

    def fields(row: str) -> dict[str, int]:
        return {name: int(value) for name, value in re.findall(r"(\w+)=(\d+)", row)}

    files = table("FileNames")
    locations = {number: fields(row) for number, row in table("FileLocations").items()}
    frames = {number: fields(row) for number, row in table("StackFrames").items()}

    def place_of(frame: int) -> tuple[str, int]:
        while frame in frames:
            location = locations[frames[frame]["file_location_id"]]
            path = files[location["file_name_id"]].strip('"')
            if "/remind_jax/" in path:
                return path.rpartition("/remind_jax/")[2], location.get("line", 0)
            parent = frames[frame].get("parent_frame_id", 0)
            frame = 0 if parent == frame else parent
        return NO_PLACE, 0

    return place_of


def _time_runs(compiled: Any, arguments: tuple, repeats: int = 20) -> float:
    jax.block_until_ready(compiled(*arguments))
    start = time.process_time()
    for _ in range(repeats):
        jax.block_until_ready(compiled(*arguments))
    return 1000 * (time.process_time() - start) / repeats


def measure_all(names: list[str], traced: bool, num_places: int) -> Iterator[dict[str, Any]]:
    """A row per program, and, if wanted, rows that say where its instructions come from."""
    for name, with_trace in itertools.product(names, (False, True) if traced else (False,)):
        method = get_method(name)
        for part, function, arguments in programs_of(method, with_trace):
            shown = f"{name}, {part}{', traced' if with_trace else ''}"
            measured = measure(shown, method, function, arguments)
            yield measured.row
            for counter in (measured.modules, measured.lines):
                for place, number in counter.most_common(num_places):
                    yield {"name": f"  {place}", "instructions": number}


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    names = list_methods()
    parser.add_argument("--methods", nargs="+", default=names, choices=names)
    parser.add_argument("--traced", action="store_true")
    parser.add_argument("--where", type=int, default=0, metavar="N")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    show_rows(measure_all(given.methods, given.traced, given.where), given.json)


if __name__ == "__main__":
    main()
