"""Tables of a benchmark: contenders by score, by scene, by what makes a tour hard."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from remind_jax.benchmark.scoring import Scored, by_contender, summarize
from remind_jax.benchmark.tours import AXES
from remind_jax.files import make_folder
from remind_jax.metrics.comparison import Column, ComparisonTable, Row
from remind_jax.printing.words import plural

_MAIN: tuple[str | Column, ...] = (
    "IDF1",
    Column("IDF1Settled", "percent", "higher", label="IDF1 settled"),
    "HOTA",
    "AssA",
    "Recovery",
    "HardRecovery",
    "IDSW",
    Column("IDs", "count"),
    "GT_IDs",
    Column("step_ms", "ms", "lower", label="step ms"),
)
_RESOURCES: tuple[str | Column, ...] = (
    Column("step_ms", "ms", "lower", label="step ms"),
    Column("step_p95_ms", "ms", "lower", label="p95"),
    Column("frame_ms", "ms", "lower", label="frame ms"),
    Column("frame_p95_ms", "ms", "lower", label="p95"),
    Column("compiling_ms", "ms", "lower", label="compiling"),
    Column("compiling_p95_ms", "ms", "lower", label="p95"),
    Column("peak_rss_mib", "mib", "lower", label="RSS MiB"),
    Column("device_mib", "mib", "lower", label="device MiB"),
)
_UNDECIDED = (
    "IDF1: undecided detections carry no identity; IDF1 settled: each frame's are settled in one "
    "assignment within their candidates. All other scores are of the former kind."
)
_STEP = "Step: mean time of the tracker alone, without frames that compiled."
_MEASURED: tuple[str, ...] = (
    "Milliseconds per frame, mean and 95th percentile. Step: the tracker alone. Frame: detector, "
    "features, masks and step. Compiling: frame with the frames that compiled, which the others "
    "leave out.",
    "RSS: largest resident memory of the process in a scene, by the operating system; device: most "
    "memory of it in use so far, by JAX.",
)


def make_tables(
    runs: Sequence[Scored], titles: Mapping[str, str], regime: str, title: str = ""
) -> dict[str, ComparisonTable]:
    """Tables by the names of their files; the first is that of the main scores.

    `titles` are those of contenders by name. Tours have one more, by what makes them hard.
    """
    by_title = {titles.get(name, name): own for name, own in by_contender(runs).items()}
    rows = []
    for name, own in by_title.items():
        scores, intervals = summarize(own)
        num_failed = sum(run.strict is None for run in own)
        num_skipped = sum(run.record.num_skipped for run in own)
        notes = [f"{num_failed} of {len(own)} scenes failed"] if num_failed else []
        notes += [f"{plural(num_skipped, 'frame')} skipped"] if num_skipped else []
        rows.append(Row(name, scores, intervals, "; ".join(notes), is_partial=num_failed > 0))
    legend = [_UNDECIDED, _STEP]
    if any(row.intervals for row in rows):
        legend.append("Below scores: 95 % bootstrap intervals over scenes.")
    resources = [Row(row.name, row.scores) for row in rows]
    tables = {
        regime: ComparisonTable(rows, _MAIN, legend, title),
        f"{regime}_resources": ComparisonTable(resources, _RESOURCES, _MEASURED, "Time and memory"),
        f"{regime}_scenes": _cross(by_title, lambda run: run.record.scene, "IDF1 by scene"),
    }
    if any(map(_axis, runs)):
        tables[f"{regime}_axes"] = _cross(by_title, _axis, "IDF1 by difficulty")
    return tables


def list_failures(runs: Sequence[Scored]) -> list[str]:
    """A sentence for every run that has no score."""
    return [
        f"{run.record.contender} on {run.record.scene}: {run.error}"
        for run in runs
        if run.strict is None
    ]


def save_tables(tables: Mapping[str, ComparisonTable], folder: Path) -> None:
    """Writes every table as Markdown, CSV and text."""
    make_folder(folder)
    for name, table in tables.items():
        for suffix in (".md", ".csv", ".txt"):
            table.save(folder / f"{name}{suffix}")


def _cross(
    by_title: Mapping[str, list[Scored]], group: Callable[[Scored], str], title: str
) -> ComparisonTable:
    """IDF1 of contenders by groups of scenes; those of group `""` are left out."""
    runs = [run for own in by_title.values() for run in own]
    groups = [label for label in dict.fromkeys(map(group, runs)) if label]
    rows = []
    for name, own in by_title.items():
        pooled = {
            label: summarize([one for one in own if group(one) == label])[0] for label in groups
        }
        cells = {label: scores["IDF1"] for label, scores in pooled.items() if "IDF1" in scores}
        rows.append(Row(name, cells))
    columns = [Column(label, "percent", "higher") for label in groups]
    return ComparisonTable(rows, columns, (), title)


def _axis(run: Scored) -> str:
    """What makes a rendered tour hard; empty for other scenes."""
    axis = run.record.scene.rpartition("-")[0]
    return axis if axis in AXES else ""
