"""The columns of a table of scores: how a number is written, which way is better, what it means."""

from __future__ import annotations

import dataclasses
import math
from typing import Literal

Kind = Literal["percent", "count", "seconds", "ms", "mib", "number"]
Better = Literal["higher", "lower"]
Interval = tuple[float, float]  # lower, upper end

NOTHING = "-"

# Digits after the point.
_DECIMALS: dict[Kind, int] = {
    "percent": 2,
    "count": 0,
    "seconds": 1,
    "ms": 1,
    "mib": 0,
    "number": 3,
}


@dataclasses.dataclass(frozen=True)
class Column:
    """One column of a comparison."""

    name: str  # key of the score
    kind: Kind = "number"  # percent: the score is a fraction and shown times 100
    better: Better | None = None
    meaning: str = ""  # one sentence for the legend
    label: str | None = None  # heading, if not the name

    @property
    def heading(self) -> str:
        """What stands above the column."""
        return self.label or self.name

    def format(self, value: float, extra_digits: int = 0) -> str:
        """A score as it is shown."""
        scale = 100.0 if self.kind == "percent" else 1.0
        decimals = max(0, _DECIMALS[self.kind] + extra_digits)
        return f"{scale * value:.{decimals}f}"


COLUMNS: dict[str, Column] = {
    column.name: column
    for column in (
        Column(
            "HOTA", "percent", "higher", "Detection and association over 19 overlaps (TrackEval)."
        ),
        Column("DetA", "percent", "higher", "Detection accuracy of HOTA."),
        Column("AssA", "percent", "higher", "Association accuracy of HOTA."),
        Column("LocA", "percent", "higher", "Mean overlap of matches, over HOTA's thresholds."),
        Column("MOTA", "percent", "higher", "1 - (misses + false positives + switches) / truth."),
        Column("MOTP", "percent", "higher", "Mean overlap of matches at 0.5."),
        Column("IDF1", "percent", "higher", "Observations with their one right identity (F1)."),
        Column("IDP", "percent", "higher", "Precision of IDF1."),
        Column("IDR", "percent", "higher", "Recall of IDF1."),
        Column("IDSW", "count", "lower", "Identity switches, across gaps of any length."),
        Column("IDSWRate", "percent", "lower", "Switches per observation.", "IDSW %"),
        Column("Frag", "count", "lower", "Interruptions of tracks."),
        Column("MT", "count", "higher", "Objects tracked in more than 80 % of their frames."),
        Column("PT", "count", None, "Objects tracked in 20 to 80 %."),
        Column("ML", "count", "lower", "Objects tracked in less than 20 %."),
        Column(
            "Recovery", "percent", "higher", "Returns in which the object got its identity back."
        ),
        Column(
            "HardRecovery",
            "percent",
            "higher",
            "... in the first frame of the return.",
            "Hard rec.",
        ),
        Column("Opportunities", "count", None, "Returns of objects to view.", "Returns"),
        Column(
            "ClassHOTA",
            "percent",
            "higher",
            "HOTA as far as labels judge, mean over classes.",
            "HOTA cls",
        ),
        Column("ClassAssA", "percent", "higher", "Association accuracy, likewise.", "AssA cls"),
        Column("ClassIDF1", "percent", "higher", "IDF1, likewise.", "IDF1 cls"),
        Column("IDs", "count", None, "Identities given."),
        Column("GT_IDs", "count", None, "True objects.", "Objects"),
        Column("FirmShare", "percent", None, "Observations with a firm identity.", "Firm"),
        Column(
            "FirmAccuracy", "percent", "higher", "Firm identities that are right.", "Firm right"
        ),
        Column("AmbiguousShare", "percent", None, "Observations with candidates.", "Ambiguous"),
        Column(
            "CandidateHitRate",
            "percent",
            "higher",
            "Candidate sets that hold the truth.",
            "Set hit",
        ),
        Column(
            "CollapseAccuracy",
            "percent",
            "higher",
            "Candidate sets settled rightly.",
            "Settled right",
        ),
        Column("WeakShare", "percent", "lower", "Observations with neither.", "Weak"),
        Column("ms_per_frame", "ms", "lower", "Mean time of a frame.", "ms"),
        Column("p95_ms", "ms", "lower", "95th percentile of the time of a frame.", "p95 ms"),
        Column(
            "peak_rss_mib", "mib", "lower", "Largest resident memory of the process.", "RSS MiB"
        ),
    )
}


def column_of(column: str | Column) -> Column:
    """A column by its name; an unknown name becomes a plain number."""
    return COLUMNS.get(column, Column(column)) if isinstance(column, str) else column


def format_cell(column: Column, value: float, interval: Interval | None = None) -> tuple[str, str]:
    """A score and its interval as they are shown; the second is empty without an interval."""
    if math.isnan(value):
        return NOTHING, ""
    if interval is None or math.isnan(interval[0]) or math.isnan(interval[1]):
        return column.format(value), ""
    low, high = (column.format(end, -1) for end in interval)
    return column.format(value), f"{low} to {high}"
