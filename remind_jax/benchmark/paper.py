"""The paper's numbers, to stand beside ours (arXiv 2607.09267; evaluation.md#published-numbers).

They follow the paper's own definitions, which differ from method to method; ours are the standard
metrics. "forced" is the paper's word for the scenes that every method was made to finish.
"""

from __future__ import annotations

import math
from typing import Literal

from remind_jax.metrics.comparison import Row

PaperSet = Literal["custom", "scannetpp"]

LEGEND = (
    "Rows of the paper follow its own definitions, which are not those of the other rows; "
    "compare them with each other."
)
_COLUMNS = ("IDF1", "Recovery", "HardRecovery", "IDSWRate", "DetA", "AssA", "IDP", "IDR")
_NAN = math.nan

# Percent, in the order of _COLUMNS.
_MASKS: dict[PaperSet, dict[str, tuple[float, ...]]] = {
    "custom": {
        "DAM4SAM": (70.53, 69.15, 46.81, 9.27, 83.32, 77.59, 77.59, 64.64),
        "MASA": (53.84, 45.74, 37.94, 5.30, _NAN, 53.84, 53.84, 53.84),
        "REMIND": (90.35, 85.46, 58.16, 5.74, _NAN, 94.01, 90.35, 90.35),
        "REMIND, greedy": (90.54, 85.46, 58.16, 5.71, _NAN, 94.20, 90.54, 90.54),
        "REMIND, no background": (55.56, 53.19, 27.66, 19.87, _NAN, 80.78, 55.56, 55.56),
        "REMIND, no neighbours": (69.73, 56.03, 28.72, 11.58, _NAN, 93.20, 69.73, 69.73),
    },
    "scannetpp": {
        "DAM4SAM": (60.71, 41.65, 27.07, 4.68, 59.37, 76.60, 76.60, 50.28),
        "MASA": (54.89, 40.60, 28.96, 14.12, _NAN, 54.89, 54.89, 54.89),
        "MASA, forced": (57.01, 42.65, 30.61, 13.96, _NAN, 57.01, 57.01, 57.01),
        "REMIND": (62.47, 55.12, 39.53, 19.17, _NAN, 67.32, 62.86, 62.08),
        "REMIND, forced": (66.67, 58.36, 42.62, 16.28, _NAN, 71.44, 67.14, 66.20),
        "REMIND, greedy": (61.30, 53.85, 38.31, 19.74, _NAN, 65.77, 61.88, 60.73),
        "REMIND, no background": (37.53, 31.74, 17.54, 51.73, _NAN, 47.18, 37.55, 37.51),
        "REMIND, no neighbours": (60.39, 51.71, 35.68, 20.26, _NAN, 69.56, 60.45, 60.32),
    },
}
_DETECTOR: dict[PaperSet, dict[str, tuple[float, ...]]] = {
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
_RESOURCES: dict[PaperSet, dict[str, tuple[float, float, float, float]]] = {
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


def paper_rows(data: PaperSet, regime: Literal["masks", "detector"]) -> tuple[Row, ...]:
    """Rows of the paper's tables for one of its data sets."""
    rows = []
    for name, values in (_MASKS if regime == "masks" else _DETECTOR)[data].items():
        scores = {c: v / 100 for c, v in zip(_COLUMNS, values, strict=True)}
        if regime == "masks" and name in _RESOURCES[data]:
            mean_ms, p95_ms, rss_gib, device_gib = _RESOURCES[data][name]
            scores |= {
                "frame_ms": mean_ms,
                "frame_p95_ms": p95_ms,
                "peak_rss_mib": 1024 * rss_gib,
                "device_mib": 1024 * device_gib,
            }
        rows.append(Row(f"paper: {name}", scores))
    return tuple(rows)
