"""What a run was made with, and what happened in it beside its decisions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Any

import msgspec

from remind_jax.errors import OutputError
from remind_jax.files.records import Label, check
from remind_jax.outputs.run_records import InfoRecord
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.tracks import title_of


class _ConfigRecord(msgspec.Struct):
    """What every configuration names."""

    tracker: Label


@dataclasses.dataclass(frozen=True)
class KnownObject:
    """An object that the memory knew before the run."""

    object_id: int
    label: str  # class
    name: str  # given by people; empty without one

    @property
    def title(self) -> str:
        """Its name, else class and id."""
        return title_of(self.label, self.object_id, {self.object_id: self.name})


@dataclasses.dataclass(frozen=True, repr=False)
class RunInfo(Printable):
    """What a run was made with: enough to read its outputs and to repeat it."""

    name: str
    source: dict[str, Any] | None  # what the source needs to be opened again; None if it cannot be
    frame_size: tuple[int, int]  # height, width in pixels
    fps: float  # processed frames per second
    class_names: tuple[str, ...]
    config: dict[str, Any]  # nested, as it would be written to YAML
    backbone: str
    versions: dict[str, str]  # remind_jax, jax, numpy, opencv, python
    device: str
    started_at: str  # ISO 8601
    detector: dict[str, Any] | None = None  # what found the detections; None for given masks
    known_objects: tuple[KnownObject, ...] = ()  # of the memory that the run went on from

    def to_json(self) -> dict[str, Any]:
        """The same as a dictionary that `json` can write."""
        return dataclasses.asdict(self) | {
            "frame_size": list(self.frame_size),
            "class_names": list(self.class_names),
            "known_objects": [dataclasses.asdict(one) for one in self.known_objects],
        }

    @classmethod
    def from_json(
        cls, content: Mapping[str, Any], where: str = "the description of the run"
    ) -> RunInfo:
        """Reads back what `to_json` made; unknown keys of later versions are left out.

        Raises:
          OutputError: If a key is missing or of another kind; `where` it stands is named.
        """
        record = check(content, InfoRecord, where, refused=OutputError)
        check(record.config, _ConfigRecord, f"{where}, `config`", refused=OutputError)
        known = tuple(KnownObject(**msgspec.structs.asdict(one)) for one in record.known_objects)
        return cls(**{**msgspec.structs.asdict(record), "known_objects": known})

    @property
    def object_names(self) -> dict[int, str]:
        """Names that people gave to objects, by id."""
        return {one.object_id: one.name for one in self.known_objects if one.name}

    @property
    def tracker(self) -> str:
        """Name of the method."""
        return self.config["tracker"]

    def _summarize(self) -> SmallTable:
        return SmallTable(f"run '{self.name}'", self.facts())

    def facts(self) -> tuple[str, ...]:
        """What it was made with, in two lines."""
        height, width = self.frame_size
        return (
            f"{width} x {height} pixels, {self.fps:.4g} frames per second",
            f"tracker {self.tracker}, {self.backbone}, {self.device}, started at {self.started_at}",
        )


@dataclasses.dataclass(frozen=True)
class Event:
    """Something worth knowing that happened at a frame, as detections that were dropped."""

    frame_index: int
    kind: str  # a word or two: "dropped", "features"
    message: str
