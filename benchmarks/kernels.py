"""What the compiled programs of some frames execute: kernels, their number and their time."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import gzip
import json
import tempfile
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import jax

from benchmarks.program import NO_PLACE, Instruction, read_instructions


@dataclasses.dataclass
class Kernel:
    """One instruction of a program, however often it ran."""

    program: str
    name: str
    runs: int = 0
    milliseconds: float = 0.0  # without what runs within it


class Recording:
    """Kernels that were executed while `record` was open."""

    def __init__(self) -> None:
        self.kernels: list[Kernel] = []


@contextlib.contextmanager
def record() -> Iterator[Recording]:
    """Records every kernel of every program that runs meanwhile, by the profiler of JAX."""
    recording = Recording()
    options = jax.profiler.ProfileOptions()
    options.host_tracer_level, options.python_tracer_level = 3, 0
    with tempfile.TemporaryDirectory() as folder:
        jax.profiler.start_trace(folder, profiler_options=options)
        try:
            yield recording
        finally:
            jax.profiler.stop_trace()
        (file,) = Path(folder).rglob("*.trace.json.gz")
        with gzip.open(file, "rt", encoding="utf-8") as stream:
            recording.kernels = sum_events(json.load(stream)["traceEvents"])


def sum_events(events: Iterable[dict[str, Any]]) -> list[Kernel]:
    """Kernels of the events of a trace, the longest first.

    An event that lies within another one of its thread, as those of a loop, is not counted in it.
    """
    kernels: dict[tuple[str, str], Kernel] = {}
    around: dict[Any, list[tuple[float, Kernel]]] = collections.defaultdict(list)
    ran = [e for e in events if e.get("ph") == "X" and "hlo_op" in e.get("args", {})]
    for event in sorted(ran, key=lambda e: (e["ts"], -e.get("dur", 0.0))):
        key = (event["args"]["hlo_module"], event["args"]["hlo_op"])
        kernel = kernels.setdefault(key, Kernel(*key))
        start, lasted = event["ts"], event.get("dur", 0.0)
        stack = around[event["tid"]]
        while stack and stack[-1][0] <= start:
            stack.pop()
        if stack:
            stack[-1][1].milliseconds -= lasted / 1000
        stack.append((start + lasted, kernel))
        kernel.runs += 1
        kernel.milliseconds += lasted / 1000
    return sorted(kernels.values(), key=lambda kernel: -kernel.milliseconds)


def make_rows(
    kernels: list[Kernel], texts: Iterable[str], num_frames: int, most: int
) -> Iterator[dict[str, Any]]:
    """Rows per frame: all, by kind, by module, by line and by kernel, the longest of each.

    Args:
      kernels: What was executed.
      texts: The compiled programs, as text.
      num_frames: Frames that were recorded.
      most: Rows of each sort.
    """
    instructions: dict[tuple[str, str], Instruction] = {}
    for text in texts:
        program = text.split(maxsplit=2)[1].rstrip(",")
        instructions |= {(program, one.name): one for one in read_instructions(text)}

    def row(name: str, group: list[Kernel]) -> dict[str, Any]:
        return {
            "name": name,
            "kernels": sum(kernel.runs for kernel in group) / num_frames,
            "ms": round(sum(kernel.milliseconds for kernel in group) / num_frames, 4),
        }

    yield row("all kernels", kernels)
    sorts: list[dict[str, list[Kernel]]] = [collections.defaultdict(list) for _ in range(4)]
    for kernel in kernels:
        none = Instruction(kernel.name, "other", NO_PLACE, 0)
        one = instructions.get((kernel.program, kernel.name), none)
        place = f"{one.module}:{one.line}"
        names = one.kind, one.module, place, f"{kernel.program} {kernel.name} ({place})"
        for groups, name in zip(sorts, names, strict=True):
            groups[name].append(kernel)
    for groups in sorts:
        rows = (row(f"  {name}", group) for name, group in groups.items())
        yield from sorted(rows, key=lambda one: -one["ms"])[:most]
