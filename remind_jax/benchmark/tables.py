"""Tables of a benchmark: contenders by score, by scene, by what makes a tour hard; the paper's."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Literal

from remind_jax.benchmark.running import Regime
from remind_jax.benchmark.scoring import Scored, by_contender, summarize
from remind_jax.benchmark.tours import AXES
from remind_jax.files import make_folder
from remind_jax.metrics.columns import Column
from remind_jax.metrics.comparison import ComparisonTable, Row

FORMATS = (".md", ".csv", ".tex", ".txt")

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
_PAPER: tuple[str | Column, ...] = (
    Column("IDSWRate", "percent", "lower", label="IDSW %"),
    "DetA",
    "IDP",
    "IDR",
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
    "RSS: largest resident memory of the process in a scene, device: largest share of its memory "
    "so far, both by the operating system.",
)

PaperSet = Literal["custom", "scannetpp"]

_PAPER_LEGEND = (
    "Rows of the paper follow its own definitions, which are not those of the other rows; "
    "compare them with each other."
)
_PAPER_SCORES = ("IDF1", "Recovery", "HardRecovery", "IDSWRate", "DetA", "AssA", "IDP", "IDR")
_NAN = math.nan

# The paper's numbers (arXiv 2607.09267; evaluation.md#published-numbers) by its own definitions,
# which differ from method to method; "forced" is its word for the scenes that every method was made
# to finish. Percent, in the order of _PAPER_SCORES.
_PAPER_MASKS: dict[PaperSet, dict[str, tuple[float, ...]]] = {
    "custom": {
        "DAM4SAM": (70.53, 69.15, 46.81, 9.27, 83.32, 77.59, 77.59, 64.64),
        "MASA": (53.84, 45.74, 37.94, 5.30, _NAN, 53.84, 53.84, 53.84),
        "REMIND": (90.35, 85.46, 58.16, 5.74, _NAN, 94.01, 90.35, 90.35),
        "REMIND, greedy": (90.54, 85.46, 58.16, 5.71, _NAN, 94.20, 90.54, 90.54),
        "REMIND, no background": (55.56, 53.19, 27.66, 19.87, _NAN, 80.78, 55.56, 55.56),
        "REMIND, no neighbors": (69.73, 56.03, 28.72, 11.58, _NAN, 93.20, 69.73, 69.73),
    },
    "scannetpp": {
        "DAM4SAM": (60.71, 41.65, 27.07, 4.68, 59.37, 76.60, 76.60, 50.28),
        "MASA": (54.89, 40.60, 28.96, 14.12, _NAN, 54.89, 54.89, 54.89),
        "MASA, forced": (57.01, 42.65, 30.61, 13.96, _NAN, 57.01, 57.01, 57.01),
        "REMIND": (62.47, 55.12, 39.53, 19.17, _NAN, 67.32, 62.86, 62.08),
        "REMIND, forced": (66.67, 58.36, 42.62, 16.28, _NAN, 71.44, 67.14, 66.20),
        "REMIND, greedy": (61.30, 53.85, 38.31, 19.74, _NAN, 65.77, 61.88, 60.73),
        "REMIND, no background": (37.53, 31.74, 17.54, 51.73, _NAN, 47.18, 37.55, 37.51),
        "REMIND, no neighbors": (60.39, 51.71, 35.68, 20.26, _NAN, 69.56, 60.45, 60.32),
    },
}
_PAPER_DETECTOR: dict[PaperSet, dict[str, tuple[float, ...]]] = {
    "custom": {
        "DAM4SAM": (64.54, 65.96, 39.72, 10.61, 78.25, 73.52, 73.52, 57.53),
        "MASA": (45.76, 38.65, 34.04, 6.41, 99.37, 45.90, 45.90, 45.61),
        "REMIND": (75.45, 79.08, 44.33, 8.60, 88.72, 94.03, 76.76, 74.19),
    },
    "scannetpp": {
        "DAM4SAM": (57.97, 53.59, 35.59, 20.33, 85.98, 62.70, 62.70, 53.91),
        "MASA": (50.56, 34.10, 18.63, 7.65, 69.44, 61.69, 61.69, 42.84),
        "MASA, forced": (60.38, 46.89, 29.42, 10.79, 76.37, 69.73, 69.73, 53.25),
        "REMIND": (48.07, 34.74, 16.27, 12.19, 64.57, 69.99, 57.94, 41.07),
        "REMIND, forced": (61.30, 46.23, 27.21, 11.14, 71.88, 81.68, 70.06, 54.49),
    },
}
# Mean and p95 of a frame in ms, peak RSS and device memory in GiB, on an RTX 4090 with true masks.
_PAPER_RESOURCES: dict[PaperSet, dict[str, tuple[float, float, float, float]]] = {
    "custom": {
        "DAM4SAM": (640.92, 755.43, 2.00, 9.47),
        "MASA": (109.00, 126.30, 2.14, 1.67),
        "REMIND": (342.61, 488.59, 1.36, 0.16),
    },
    "scannetpp": {
        "DAM4SAM": (737.20, 1357.77, 6.75, 21.54),
        "MASA": (136.30, 174.90, 7.19, 1.70),
        "REMIND": (500.83, 1107.96, 20.71, 0.25),
    },
}


def main_table(
    runs: Sequence[Scored],
    titles: Mapping[str, str],
    regime: Regime,
    *,
    title: str = "",
    paper: PaperSet | None = None,
) -> ComparisonTable:
    """One row per contender over all scenes, below it the paper's where the data are its own."""
    rows = []
    for name, own in by_contender(runs).items():
        scores, intervals = summarize(own)
        num_failed = sum(run.strict is None for run in own)
        note = f"{num_failed} of {len(own)} scenes failed" if num_failed else ""
        rows.append(Row(titles.get(name, name), scores, intervals, note))
    columns, legend = _MAIN, [_UNDECIDED, _STEP]
    if any(row.intervals for row in rows):
        legend.append("Below scores: 95 % bootstrap intervals over scenes.")
    if paper is not None:
        rows += paper_rows(paper, regime)
        columns += _PAPER
        legend.append(_PAPER_LEGEND)
    return ComparisonTable(rows, columns, legend, title)


def resource_table(
    runs: Sequence[Scored], titles: Mapping[str, str], *, paper: PaperSet | None = None
) -> ComparisonTable:
    """Time and memory of each contender; the paper's, on its own machine, below."""
    rows = [
        Row(titles.get(name, name), summarize(own)[0]) for name, own in by_contender(runs).items()
    ]
    legend = list(_MEASURED)
    if paper is not None:
        rows += [row for row in paper_rows(paper, "masks") if "frame_ms" in row.scores]
        legend.append("The paper measured on an RTX 4090, its network included.")
    return ComparisonTable(rows, _RESOURCES, legend, "Time and memory")


def scene_table(
    runs: Sequence[Scored], titles: Mapping[str, str], score: str = "IDF1", title: str = ""
) -> ComparisonTable:
    """One score by scene."""
    return _cross(runs, titles, score, lambda run: run.record.scene, title)


def axis_table(
    runs: Sequence[Scored], titles: Mapping[str, str], score: str = "IDF1", title: str = ""
) -> ComparisonTable | None:
    """One score by what makes a rendered tour hard, three tours each; None for other scenes."""
    known = [run for run in runs if _axis(run) in AXES]
    return _cross(known, titles, score, _axis, title) if known else None


def paper_rows(data: PaperSet, regime: Literal["masks", "detector"]) -> tuple[Row, ...]:
    """Rows of the paper's tables for one of its data sets."""
    rows = []
    for name, values in (_PAPER_MASKS if regime == "masks" else _PAPER_DETECTOR)[data].items():
        scores = {c: v / 100 for c, v in zip(_PAPER_SCORES, values, strict=True)}
        if regime == "masks" and name in _PAPER_RESOURCES[data]:
            mean_ms, p95_ms, rss_gib, device_gib = _PAPER_RESOURCES[data][name]
            scores |= {
                "frame_ms": mean_ms,
                "frame_p95_ms": p95_ms,
                "peak_rss_mib": 1024 * rss_gib,
                "device_mib": 1024 * device_gib,
            }
        rows.append(Row(f"paper: {name}", scores))
    return tuple(rows)


def list_failures(runs: Sequence[Scored]) -> list[str]:
    """A sentence for every run that has no score."""
    return [
        f"{run.record.contender} on {run.record.scene}: {run.error}"
        for run in runs
        if run.strict is None
    ]


def save_tables(tables: Mapping[str, ComparisonTable], folder: Path) -> list[Path]:
    """Writes every table as Markdown, CSV, LaTeX and text."""
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
    score: str,
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
            if score in scores:
                cells[label] = scores[score]
        rows.append(Row(titles.get(name, name), cells))
    columns = [Column(label, "percent", "higher") for label in groups]
    return ComparisonTable(rows, columns, (), title or score)


def _axis(run: Scored) -> str:
    return run.record.scene.rpartition("-")[0]
