"""The account of a run of REMIND plus on the host and in `trace.npz`.

In the file every array holds the detections of all frames one after another; `frame.detections`
tells how many belong to each frame.
"""

from __future__ import annotations

import dataclasses
import io
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float, Int

from remind_jax.decision import Decisions
from remind_jax.errors import OutputError
from remind_jax.outputs import store
from remind_jax.plus.state import Verdicts
from remind_jax.tracks import Tracks

if TYPE_CHECKING:
    from remind_jax.plus.account import PlusExplainer

VERSION = 1
_KIND = "plus"


@dataclasses.dataclass(frozen=True)
class PlusRecord:
    """What the decisions of one frame were made of; NumPy arrays without padding rows."""

    verdicts: Verdicts
    outcome: Int[np.ndarray, "N"]  # decision.Outcome, as told at once
    reason: Int[np.ndarray, "N"]  # decision.Reason
    object_id: Int[np.ndarray, "N"]  # -1 without a firm identity
    confidence: Float[np.ndarray, "N"]

    def __len__(self) -> int:
        return len(self.outcome)


_TOLD = ("outcome", "reason", "object_id", "confidence")
_WEIGHED = tuple(field.name for field in dataclasses.fields(Verdicts))


class PlusArchive:
    """The records of a run by frame; those of a file are read when they are first asked for."""

    def __init__(self) -> None:
        self._frames: dict[int, PlusRecord] = {}
        self._path: Path | None = None

    @classmethod
    def open(cls, path: Path) -> PlusArchive:
        """The archive of a file, not read yet."""
        archive = cls()
        archive._path = path
        return archive

    def explainer(self, tracks: Sequence[Tracks], config: Mapping[str, Any]) -> PlusExplainer:
        """Explains decisions of the run with these frames and this configuration."""
        from remind_jax.plus.account import PlusExplainer

        return PlusExplainer(self, tracks, config)

    def frame(self, frame_index: int) -> PlusRecord | None:
        """The record of a frame; None if the run has no such frame.

        Raises:
          OutputError: If the file is damaged.
        """
        self._read()
        return self._frames.get(frame_index)

    def add(
        self,
        frame_index: int,
        num: int,
        decisions: Decisions,
        trace: Verdicts,
        class_names: Sequence[str],
    ) -> None:
        """Keeps one frame.

        Args:
          frame_index: Number of the processed frame.
          num: Detections of the frame; further rows are padding.
          decisions: Host arrays.
          trace: Host arrays.
          class_names: By class id; candidates are of the class of their detection.
        """
        del class_names
        told: dict[str, Any] = {name: np.asarray(getattr(decisions, name))[:num] for name in _TOLD}
        weighed: dict[str, Any] = {
            name: np.asarray(getattr(trace, name))[:num] for name in _WEIGHED
        }
        self._frames[frame_index] = PlusRecord(Verdicts(**weighed), **told)

    def save(self, path: Path) -> None:
        """Writes `trace.npz` at once or not at all.

        Raises:
          OutputError: If it cannot be written.
        """
        self._read()
        index = sorted(self._frames)
        frames = [self._frames[i] for i in index]
        columns: dict[str, np.ndarray] = {
            "tracker": np.array(_KIND),
            "version": np.array(VERSION),
            "frame.index": np.array(index, np.int32),
            "frame.detections": np.array([len(frame) for frame in frames], np.int32),
        }
        for name in _TOLD if frames else ():
            columns[f"told.{name}"] = np.concatenate([getattr(frame, name) for frame in frames])
        for name in _WEIGHED if frames else ():
            parts = [getattr(frame.verdicts, name) for frame in frames]
            columns[f"weighed.{name}"] = np.concatenate(parts)
        buffer = io.BytesIO()
        np.savez_compressed(buffer, **columns)  # pyright: ignore[reportArgumentType]
        store.replace_file(path, buffer.getvalue())

    def _read(self) -> None:
        if self._path is None:
            return
        path = self._path
        try:
            with np.load(path) as file:
                if file["tracker"] != _KIND or file["version"] > VERSION:
                    raise OutputError(
                        f"'{path}' is of tracker '{file['tracker']}', version {file['version']}; "
                        f"this remind-jax reads '{_KIND}' up to {VERSION}: upgrade it"
                    )
                columns = {name: file[name] for name in file.files}
            self._frames = _split(columns)
        except OutputError:
            raise
        except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
            raise OutputError(
                f"'{path}' is damaged ({type(error).__name__}: {error}); run the tracker again "
                "with --trace"
            ) from error
        self._path = None


def _split(columns: Mapping[str, np.ndarray]) -> dict[int, PlusRecord]:
    """The records of all frames."""
    ends = np.cumsum(columns["frame.detections"])
    frames = {}
    for index, start, end in zip(
        columns["frame.index"].tolist(),
        (ends - columns["frame.detections"]).tolist(),
        ends.tolist(),
        strict=True,
    ):
        told: dict[str, Any] = {name: columns[f"told.{name}"][start:end] for name in _TOLD}
        weighed: dict[str, Any] = {name: columns[f"weighed.{name}"][start:end] for name in _WEIGHED}
        frames[index] = PlusRecord(Verdicts(**weighed), **told)
    return frames
