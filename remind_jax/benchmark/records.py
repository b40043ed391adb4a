"""What is kept of each run: who tracked which scene, how it went, how long it took.

One folder per contender and scene, complete as soon as `record.json` is there:

    <out>/<regime>/<contender>/<scene>/record.json        this module
                                       detections.jsonl   identities, as `remind run` writes them
                                       run.json
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from typing import Any, Literal

from remind_jax.errors import OutputError

RECORD_NAME = "record.json"
Status = Literal["done", "failed"]


@dataclasses.dataclass(frozen=True)
class Timing:
    """Milliseconds per frame."""

    mean_ms: float
    p95_ms: float


@dataclasses.dataclass(frozen=True)
class Record:
    """How one contender fared on one scene."""

    contender: str
    scene: str
    regime: str
    fingerprint: str  # of all that decides about the result: configuration, features, input
    status: Status
    error: str = ""  # why it failed
    num_frames: int = 0
    frame: Timing | None = None  # features, masks and step, without frames that compiled
    frame_compiling: Timing | None = None  # with them
    step: Timing | None = None  # the tracker alone, without frames that compiled
    peak_rss_mib: float = math.nan
    device_mib: float = math.nan


def folder_of(out: Path, regime: str, contender: str, scene: str) -> Path:
    """Where a run is kept."""
    return out / regime / contender / scene


def write_record(folder: Path, record: Record) -> None:
    """Writes a record; it appears complete or not at all.

    Raises:
      OutputError: If it cannot be written.
    """
    path = folder / RECORD_NAME
    unfinished = path.with_name(path.name + ".part")
    values = {k: _finite(v) for k, v in dataclasses.asdict(record).items()}
    try:
        folder.mkdir(parents=True, exist_ok=True)
        unfinished.write_text(json.dumps(values, indent=1) + "\n", encoding="utf-8")
        os.replace(unfinished, path)
    except OSError as error:
        raise OutputError(f"cannot write '{path}': {error.strerror}") from error


def read_record(folder: Path) -> Record | None:
    """Reads a record; None if there is none, or none of this version."""
    try:
        values: dict[str, Any] = json.loads((folder / RECORD_NAME).read_text(encoding="utf-8"))
        for name in ("frame", "frame_compiling", "step"):
            values[name] = None if values[name] is None else Timing(**values[name])
        for name in ("peak_rss_mib", "device_mib"):
            values[name] = math.nan if values[name] is None else values[name]
        return Record(**values)
    except (OSError, ValueError, KeyError, TypeError):
        return None


def _finite(value: Any) -> Any:
    """JSON knows no NaN."""
    return None if isinstance(value, float) and math.isnan(value) else value
