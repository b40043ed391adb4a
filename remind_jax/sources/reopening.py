"""What a run says of its source, so that it can be opened again; read from files, so checked."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from remind_jax.errors import SourceError
from remind_jax.files.records import Count, Positive, Text, check
from remind_jax.sources.label_maps import Unlabelled

_Rate = Annotated[float, Meta(gt=0.0, le=1e6)]
_Name = Annotated[str, Meta(min_length=1, max_length=1_000)]


class _Sampling(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    fps: _Rate | None = None
    stride: Positive = 1
    start: Count = 0
    end: Count | None = None
    max_frames: Count | None = None


class _Arguments(msgspec.Struct, forbid_unknown_fields=True, frozen=True):
    """Arguments of `open_source`."""

    spec: Text
    masks: Text | None = None
    sampling: _Sampling = _Sampling()
    metadata: Text | None = None
    sequence: _Name | None = None
    images: _Name | None = None
    mask_variant: _Name | None = None
    unlabelled: Unlabelled = "error"
    image_fps: _Rate = 30.0
    allow_size_change: bool = False
    name: _Name | None = None


class _Description(msgspec.Struct, frozen=True):
    """What `Source.describe` says; the rest is for people."""

    name: Text | None = None
    reopen: _Arguments | None = None


def read_arguments(description: Mapping[str, Any]) -> dict[str, Any]:
    """Arguments of `open_source` for a source that `Source.describe` described.

    Raises:
      SourceError: If the frames came from memory, or the description is damaged.
    """
    where = "the description of the source"
    said = check(dict(description), _Description, where, refused=SourceError)
    if said.reopen is None:
        raise SourceError(
            f"source '{said.name}' came from memory and cannot be opened again; give its video or "
            "images anew"
        )
    return msgspec.to_builtins(said.reopen)
