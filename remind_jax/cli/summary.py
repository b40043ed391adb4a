"""What is said about a run when it is over: a few lines for people, JSON for machines."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from remind_jax.errors import on_one_line
from remind_jax.printing.terminal import print_lines
from remind_jax.printing.words import first_of, plural

if TYPE_CHECKING:
    from remind_jax.outputs.result import Result

_MAX_NAMED = 20  # known objects that are named
_MAX_EXAMPLES = 3  # skipped frames and events that are spelled out


def summary_facts(result: Result, out: Path) -> dict[str, Any]:
    """Counts, times, skipped frames and events of a run, as `json` can write them."""
    return {
        "name": result.info.name,
        "out": str(out),
        "complete": result.complete,
        **result.summary(),
        "skipped": [dataclasses.asdict(frame) for frame in result.skipped],
        "events": [dataclasses.asdict(event) for event in result.events],
    }


def print_summary(result: Result, out: Path, notes: Iterable[str] = ()) -> None:
    """Prints for people what was found, how long it took, what went wrong, and where it is."""
    facts = result.summary()
    found = (
        f"{result.info.name}: {plural(facts['frames'], 'frame')}, "
        f"{plural(facts['identities'], 'identity', 'identities')}, "
        f"{plural(facts['returns'], 'return')}, "
        f"{100 * facts['undecided_share']:.1f} % of {facts['detections']} detections uncertain"
    )
    profile = result.info.config.get("profile")
    place = "output in" if result.complete else "stopped; what was done is in"
    lines = [
        *notes,
        found,
        *([f"thresholds by 'remind calibrate': {profile}"] if profile else []),
        *_say_known(result),
        *_say_times(facts),
        *_say_skipped(result),
        *_say_events(result),
        f"{place} {out}, open {out / 'report.html'}",
    ]
    print_lines(*map(on_one_line, lines))


def _say_known(result: Result) -> list[str]:
    """Which objects of the memory were met again."""
    known, not_met = result.info.known_objects, result.not_met()
    if not known:
        return []
    line = f"{len(known) - len(not_met)} of {plural(len(known), 'known object')} met again"
    if not not_met:
        return [line]
    return [f"{line}; not met: {first_of([one.title for one in not_met], _MAX_NAMED)}"]


def _say_times(facts: dict[str, Any]) -> list[str]:
    stages = facts["ms_per_frame"]
    if not stages:
        return []
    parts = ", ".join(f"{stage} {times['median']:.1f}" for stage, times in stages.items())
    first_ms, compile_s = facts["first_frame_ms"], facts["compile_s"]
    waits = [] if first_ms is None else [f"first frame after {first_ms / 1000:.1f} s"]
    waits += [] if compile_s is None else [f"{compile_s:.1f} s spent on compiling"]
    return [f"median ms per frame: {parts}", *([", ".join(waits)] if waits else [])]


def _say_skipped(result: Result) -> list[str]:
    if not result.skipped:
        return []
    num = sum(frame.count for frame in result.skipped)
    shown = [f"'{frame.name}': {frame.reason}" for frame in result.skipped[:_MAX_EXAMPLES]]
    more = ["..."] if len(result.skipped) > _MAX_EXAMPLES else []
    return [f"{plural(num, 'frame')} skipped: " + "; ".join(shown + more)]


def _say_events(result: Result) -> list[str]:
    """All of the whole run, then one line per kind: the first, and how many more there were."""
    lines = [event.message for event in result.events if event.frame_index < 0]
    later = [event for event in result.events if event.frame_index >= 0]
    for kind, count in Counter(event.kind for event in later).items():
        first = next(event for event in later if event.kind == kind)
        more = f" (and {count - 1} more like this)" if count > 1 else ""
        lines.append(f"frame {first.frame_index}: {first.message}{more}")
    return lines
