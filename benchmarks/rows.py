"""Rows of a benchmark as they come: printed one by one, kept as JSON."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import jax

import remind_jax as rj


def show_rows(rows: Iterable[dict[str, Any]], file: Path | None) -> None:
    """Prints every row when it is there; the first value is its name."""
    print(f"remind-jax {rj.__version__}, {jax.devices()[0].device_kind}", flush=True)
    kept = []
    for row in rows:
        kept.append(row)
        cells = [f"{k} {v:.1f}" if isinstance(v, float) else str(v) for k, v in row.items()]
        print(f"{cells[0]:38s}", "  ".join(cells[1:]), flush=True)
    if file is not None:
        file.write_text(json.dumps(kept, indent=1))
