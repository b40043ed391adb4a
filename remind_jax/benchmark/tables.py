"""Tables of a benchmark: contenders by score, by scene, by what makes a tour hard."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from remind_jax.benchmark.scoring import Scored, by_contender, summarize
from remind_jax.benchmark.tours import AXES
from remind_jax.files import make_folder
from remind_jax.metrics.comparison import Column, ComparisonTable, Row

FORMATS = (".md", ".csv", ".txt")

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


def main_table(
    runs: Sequence[Scored], titles: Mapping[str, str], title: str = ""
) -> ComparisonTable:
    """One row per contender over all scenes."""
    rows = []
    for name, own in by_contender(runs).items():
        scores, intervals = summarize(own)
        num_failed = sum(run.strict is None for run in own)
        note = f"{num_failed} of {len(own)} scenes failed" if num_failed else ""
        rows.append(Row(titles.get(name, name), scores, intervals, note))
    legend = [_UNDECIDED, _STEP]
    if any(row.intervals for row in rows):
        legend.append("Below scores: 95 % bootstrap intervals over scenes.")
    return ComparisonTable(rows, _MAIN, legend, title)


def resource_table(runs: Sequence[Scored], titles: Mapping[str, str]) -> ComparisonTable:
    """Time and memory of each contender."""
    rows = [
        Row(titles.get(name, name), summarize(own)[0]) for name, own in by_contender(runs).items()
    ]
    return ComparisonTable(rows, _RESOURCES, _MEASURED, "Time and memory")


def scene_table(runs: Sequence[Scored], titles: Mapping[str, str]) -> ComparisonTable:
    """IDF1 by scene."""
    return _cross(runs, titles, lambda run: run.record.scene, "IDF1 by scene")


def axis_table(runs: Sequence[Scored], titles: Mapping[str, str]) -> ComparisonTable | None:
    """IDF1 by what makes a rendered tour hard, three tours each; None for other scenes."""
    known = [run for run in runs if _axis(run) in AXES]
    return _cross(known, titles, _axis, "IDF1 by difficulty") if known else None


def list_failures(runs: Sequence[Scored]) -> list[str]:
    """A sentence for every run that has no score."""
    return [
        f"{run.record.contender} on {run.record.scene}: {run.error}"
        for run in runs
        if run.strict is None
    ]


def save_tables(tables: Mapping[str, ComparisonTable], folder: Path) -> list[Path]:
    """Writes every table as Markdown, CSV and text."""
    make_folder(folder)
    written = []
    for name, table in tables.items():
        for suffix in FORMATS:
            path = folder / f"{name}{suffix}"
            table.save(path)
            written.append(path)
    return written


def _cross(
    runs: Sequence[Scored],
    titles: Mapping[str, str],
    group: Callable[[Scored], str],
    title: str,
) -> ComparisonTable:
    """Contenders by groups of scenes."""
    groups = list(dict.fromkeys(map(group, runs)))
    rows = []
    for name, own in by_contender(runs).items():
        cells = {}
        for label in groups:
            scores, _ = summarize([run for run in own if group(run) == label])
            if "IDF1" in scores:
                cells[label] = scores["IDF1"]
        rows.append(Row(titles.get(name, name), cells))
    columns = [Column(label, "percent", "higher") for label in groups]
    return ComparisonTable(rows, columns, (), title)


def _axis(run: Scored) -> str:
    return run.record.scene.rpartition("-")[0]
