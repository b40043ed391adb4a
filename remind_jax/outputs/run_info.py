"""What a run was made with, and what happened in it beside its decisions.

These records are what files of runs hold: their fields say what is allowed.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from remind_jax.errors import OutputError
from remind_jax.files.records import MOST_ROWS, Label, Side, Small, Text, check
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.tracks import title_of


@dataclasses.dataclass(frozen=True)
class KnownObject:
    """An object that the memory knew before the run."""

    object_id: Small
    label: Label  # class
    name: Label  # given by people; empty without one

    @property
    def title(self) -> str:
        """Its name, else class and id."""
        return title_of(self.label, self.object_id, {self.object_id: self.name})


@dataclasses.dataclass(frozen=True, repr=False)
class RunInfo(Printable):
    """What a run was made with: enough to read its outputs and to repeat it."""

    name: Text
    # what the source needs to be opened again; None if it cannot be
    source: dict[str, Any] | None
    frame_size: tuple[Side, Side]  # height, width in pixels
    fps: Annotated[float, Meta(ge=0.0, le=1e6)]  # processed frames per second
    class_names: Annotated[tuple[Text, ...], Meta(max_length=100_000)]
    config: dict[str, Any]  # nested, as it would be written to YAML
    backbone: Text
    # of remind_jax, jax, numpy, opencv, python
    versions: Annotated[dict[Label, Text], Meta(max_length=1_000)]
    device: Text
    started_at: Label  # ISO 8601
    detector: dict[str, Any] | None = None  # what found the detections; None for given masks
    # of the memory that the run went on from
    known_objects: Annotated[tuple[KnownObject, ...], Meta(max_length=1_000_000)] = ()

    def to_json(self) -> dict[str, Any]:
        """The same as a dictionary that `json` can write."""
        return msgspec.to_builtins(self)

    @classmethod
    def from_json(
        cls, content: Mapping[str, Any], where: str = "the description of the run"
    ) -> RunInfo:
        """Reads back what `to_json` made; unknown keys of later versions are left out.

        Raises:
          OutputError: If a key is missing or of another kind; `where` it stands is named.
        """
        return check(content, RunInfo, where, refused=OutputError).checked(where)

    def checked(self, where: str) -> RunInfo:
        """This one, if its configuration names a tracker, as every configuration does.

        Raises:
          OutputError: If it does not.
        """
        if not isinstance(self.config.get("tracker"), str):
            raise OutputError(f"{where}: its `config` names no `tracker`")
        return self

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

    frame_index: Annotated[int, Meta(ge=-1, lt=MOST_ROWS)]
    kind: Label  # a word or two: "dropped", "features"
    message: Text
