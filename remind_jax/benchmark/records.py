"""A run that is kept, complete as soon as `<regime>/<contender>/<scene>/record.json` is there."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Literal

from remind_jax.errors import RemindError
from remind_jax.files import make_folder, replace_file
from remind_jax.files.records import Count, Label, Text, read_json

RECORD_NAME = "record.json"
Status = Literal["done", "failed"]


@dataclasses.dataclass(frozen=True)
class Record:
    """How one contender fared on one scene."""

    contender: Text
    scene: Text
    regime: Text
    fingerprint: Text  # of all that decides about the result: configuration, features, input
    status: Status
    error: str = ""  # why it failed
    num_kills: Count = 0  # processes that ended during this run
    num_frames: Count = 0
    num_skipped: Count = 0  # frames that could not be read, and are in no score
    # Milliseconds per frame, mean and 95th percentile, as columns of the tables name them. `step`:
    # the tracker alone; `frame`: detector, features, masks and step; `compiling`: with the frames
    # that compiled, which the others leave out.
    times_ms: dict[Label, float] = dataclasses.field(default_factory=dict)
    peak_rss_mib: float | None = None
    device_mib: float | None = None


def folder_of(out: Path, regime: str, contender: str, scene: str) -> Path:
    """Where a run is kept."""
    return out / regime / contender / scene


def write_record(folder: Path, record: Record) -> None:
    """Writes a record; it appears complete or not at all."""
    make_folder(folder)
    text = json.dumps(dataclasses.asdict(record), indent=1) + "\n"
    replace_file(folder / RECORD_NAME, text.encode("utf-8"))


def read_record(folder: Path) -> Record | None:
    """Reads a record; None if there is none, or none of this version."""
    try:
        return read_json(folder / RECORD_NAME, Record)
    except RemindError:
        return None
