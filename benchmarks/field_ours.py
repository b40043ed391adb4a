"""Our own trackers on the trials of `field.py`, and the file of detections that the others get."""

from __future__ import annotations

import dataclasses
import hashlib
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Float, Int

from benchmarks.field_worlds import COVERED, FPS, SCORE, Trial
from remind_jax.backbone.registry import Backbone, get_backbone
from remind_jax.baselines.masked_mean import look
from remind_jax.benchmark.contenders import make_contenders
from remind_jax.masks.reduction import pad_masks
from remind_jax.observation import FrameFeats
from remind_jax.session.live import Tracker

OURS = ("default", "remind", "bank")
_MOST_DETECTIONS = 32  # of one picture
_REMEMBERED = 500  # pictures, less than a GB


@dataclasses.dataclass(frozen=True)
class Described:
    """What a picture shows, for trackers that take boxes and embeddings."""

    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom; right and bottom excluded
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
        self.titles = {one.name: one.title for one in make_contenders(names)}
        self._trackers = {one.name: Tracker(one.config, backbone) for one in make_contenders(names)}

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
    """Boxes and masked means of our default features, each picture once."""

    def __init__(self) -> None:
        self._tracker = Tracker("default", tracker="bank")
        self._known: dict[tuple[Path, int], Described] = {}
        self._look = jax.jit(lambda feats, masks: look(feats, masks).vector)

    def write(self, trial: Trial, file: Path) -> None:
        """Writes the neutral file of a trial; it holds no truth."""
        parts = [
            (index, self._describe(trial, int(number)))
            for index, number in enumerate(trial.picture)
            if number >= 0
        ]
        boxes = np.concatenate([one.boxes for _, one in parts])
        np.savez(
            file,
            frame=np.concatenate([np.full(len(one.boxes), index) for index, one in parts]),
            boxes=boxes.astype(np.float32),
            scores=np.full(len(boxes), SCORE, np.float32),
            classes=np.zeros(len(boxes), np.int64),
            embeddings=np.concatenate([one.embeddings for _, one in parts]).astype(np.float32),
            picture=trial.picture,
            pictures=str(trial.pictures.file.resolve()),
            fps=FPS,
        )

    def _describe(self, trial: Trial, number: int) -> Described:
        key = trial.pictures.file, number
        if key not in self._known:
            self._known[key] = self._look_at(trial, number)
        return self._known[key]

    def _look_at(self, trial: Trial, number: int) -> Described:
        one = dataclasses.replace(trial, picture=np.array([number]))
        (frame,) = one.frames()
        prepared = self._tracker.prepare(frame)
        assert prepared.image is not None
        patches = self._tracker.backbone.extract(prepared.image[None])[0]
        feats = FrameFeats(patches, np.array(frame.size, np.int32))
        vectors = jax.device_get(self._look(feats, pad_masks(prepared.masks, _MOST_DETECTIONS)))
        num = len(prepared.detections)
        return Described(np.asarray(prepared.masks.box)[:num], vectors[:num])
