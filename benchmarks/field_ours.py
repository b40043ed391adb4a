"""Our own trackers on the trials of `field.py`, and the file of detections that the others get."""

from __future__ import annotations

import dataclasses
import hashlib
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from benchmarks.field_worlds import COVERED, FPS, Trial
from remind_jax.backbone.registry import Backbone, get_backbone
from remind_jax.baselines.parts.masked_mean import look
from remind_jax.benchmark.contenders import Contender, make_contenders
from remind_jax.crops import Crops
from remind_jax.frame import Frame
from remind_jax.masks.reduction import pad_feats, pad_masks
from remind_jax.session.live import Tracker

OURS = ("default", "remind", "bank-closeups")
_CLOSEUPS = "-closeups"
_SLOTS = 32
_REMEMBERED = 500  # pictures, less than a GB


def make_ours(names: Sequence[str]) -> tuple[Contender, ...]:
    """As `make_contenders`; `NAME-closeups` sees closeups where NAME by itself sees the frame."""

    def make(name: str) -> Contender:
        (one,) = make_contenders([name.removesuffix(_CLOSEUPS)])
        if not name.endswith(_CLOSEUPS):
            return one
        config = one.config.updated({"input": {"closeups": "always"}})
        return Contender(name, f"{one.title}, closeups", config)

    return tuple(make(name) for name in names)


@dataclasses.dataclass(frozen=True)
class Described:
    """What a frame shows, for trackers that take boxes and embeddings."""

    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom; right and bottom excluded
    scores: Float[np.ndarray, "N"]
    classes: Int[np.ndarray, "N"]
    embeddings: Float[np.ndarray, "N D"]  # of unit length


def _described_once(backbone: Backbone) -> Backbone:
    """The same, which remembers the features of the last pictures."""
    known: dict[bytes, Any] = {}

    def apply(images: Any) -> Any:
        key = hashlib.blake2b(np.asarray(images).tobytes(), digest_size=16).digest()
        if key not in known:
            if len(known) == _REMEMBERED:
                known.pop(next(iter(known)))
            known[key] = jax.block_until_ready(backbone.extract(images))
        return known[key]

    return dataclasses.replace(backbone, apply=apply, apply_to=None)


class Ours:
    """Our trackers; each is compiled once and forgets everything between trials."""

    def __init__(self, names: tuple[str, ...] = OURS) -> None:
        backbone = _described_once(get_backbone("patch-statistics"))
        contenders = make_ours(names)
        self.titles = {one.name: one.title for one in contenders}
        self._trackers = {one.name: Tracker(one.config, backbone) for one in contenders}

    def answer(self, name: str, trial: Trial) -> Int[np.ndarray, "M"]:
        """Identities as they were given in each frame, -1 where there was none yet."""
        tracker = self._trackers[name]
        tracker.reset()
        told, covered, prepared = [], 0, None
        for frame, number in zip(trial.frames(), trial.picture, strict=True):
            covered = covered + 1 if number == COVERED else 0
            # After two covered frames, what the next one becomes on the host is the same again.
            if covered > 2 and prepared is not None:
                prepared = dataclasses.replace(prepared, frame=frame)
            else:
                prepared = tracker.prepare(frame)
            told.append(tracker.advance(prepared).object_id)
        return np.concatenate(told).astype(np.int64)


class Describer:
    """Boxes and masked means of the features that plus sees: those of closeups."""

    def __init__(self) -> None:
        (bank,) = make_ours(["bank-closeups"])
        self._tracker = Tracker(bank.config)
        self._look = jax.jit(lambda feats, masks: look(feats, masks).vector)

    def describe(self, frame: Frame) -> Described:
        """What a frame with detections shows."""
        prepared = self._tracker.prepare(frame)
        found = prepared.detections
        num = len(found)
        slots = -(-max(num, 1) // _SLOTS) * _SLOTS  # few sizes, so that few programs are compiled
        feats = pad_feats(self._tracker.describe(prepared), slots)
        vectors = jax.device_get(self._look(feats, pad_masks(prepared.masks, slots)))
        boxes = np.array([Crops.of(found.masks).box(row) for row in range(num)]).reshape(num, 4)
        boxes[:, 2:] += boxes[:, :2]
        return Described(boxes, found.scores, np.asarray(prepared.masks.class_id), vectors[:num])


def write_sequence(
    file: Path,
    shown: Iterable[tuple[int, Described]],
    picture: Int[np.ndarray, "T"],
    pictures: Path,
    fps: float,
) -> None:
    """Writes the neutral file of a sequence (`field_peers/neutral.py`); it holds no truth.

    Args:
      file: What is written.
      shown: Frames with detections, in order.
      picture: Number of the picture of each frame, -1 where the lens is covered.
      pictures: File of all pictures.
      fps: Frames per second.
    """
    parts = list(shown)
    np.savez(
        file,
        frame=np.concatenate([np.full(len(one.boxes), index) for index, one in parts]),
        boxes=np.concatenate([one.boxes for _, one in parts]).astype(np.float32),
        scores=np.concatenate([one.scores for _, one in parts]).astype(np.float32),
        classes=np.concatenate([one.classes for _, one in parts]).astype(np.int64),
        embeddings=np.concatenate([one.embeddings for _, one in parts]).astype(np.float32),
        picture=picture,
        pictures=str(pictures.resolve()),
        fps=fps,
    )


class TrialWriter:
    """Neutral files of trials; every picture is described once."""

    def __init__(self) -> None:
        self._describer = Describer()
        self._known: dict[tuple[Path, int], Described] = {}

    def write(self, trial: Trial, file: Path) -> None:
        """Writes the file of a trial."""
        shown = [
            (index, self._describe(trial, int(number)))
            for index, number in enumerate(trial.picture)
            if number >= 0
        ]
        write_sequence(file, shown, trial.picture, trial.pictures.file, FPS)

    def _describe(self, trial: Trial, number: int) -> Described:
        key = trial.pictures.file, number
        if key not in self._known:
            (frame,) = dataclasses.replace(trial, picture=np.array([number])).frames()
            self._known[key] = self._describer.describe(frame)
        return self._known[key]
