"""Sequences as the step of REMIND plus sees them, recorded once, answered often, and scored."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from scipy.optimize import linear_sum_assignment

from remind_jax.backbone.registry import get_backbone
from remind_jax.config import load_config
from remind_jax.frame import NO_INSTANCE, Frame
from remind_jax.masks.reduction import pad_feats, pad_masks
from remind_jax.metrics import TrackingSequence, evaluate_sequence
from remind_jax.plus.observation import Motion, Sightings, observe
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.session.live import Tracker
from remind_jax.static import Static

Changes = dict[str, dict[str, Any]]


@dataclasses.dataclass(frozen=True)
class Recording:
    """A sequence as the step sees it; leading axis `T` frames."""

    name: str
    sightings: Sightings
    motion: Motion
    truth: np.ndarray  # [T, N] true instance, NO_INSTANCE without one
    present: np.ndarray  # [T, N] slots that hold a mask


def as_one_class(frame: Frame) -> Frame:
    """The frame with things instead of classes."""
    if frame.detections is None:
        return frame
    same = dataclasses.replace(frame.detections, labels=("thing",) * len(frame.detections))
    return dataclasses.replace(frame, detections=same)


def record(
    name: str,
    frames: Iterable[Frame],
    backbone: str,
    one_class: bool,
    closeups: str = "auto",
) -> Recording:
    """Reduces, describes and pools every frame once; `closeups`: as `input.closeups`."""
    config = load_config("plus").updated({"input.closeups": closeups})
    live = Tracker(config, get_backbone(backbone))
    prepared, features = [], []
    for frame in frames:
        ready = live.prepare(as_one_class(frame) if one_class else frame)
        prepared.append(ready)
        assert ready.image is not None, "a sequence without images has no motion to observe"
        features.append(jax.device_get(live.describe(ready)))
    num = max(1, max(len(one.detections) for one in prepared))
    look = jax.jit(functools.partial(observe, unit_patches=jnp.array(True)))
    seen = []
    for one, feats in zip(prepared, features, strict=True):
        given = pad_feats(feats, num), pad_masks(one.masks, num), one.observed
        seen.append(jax.device_get(look(*given)))
    sightings, motion = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    truth = np.full((len(prepared), num), NO_INSTANCE)
    present = np.zeros((len(prepared), num), bool)
    for row, one in enumerate(prepared):
        truth[row, : len(one.detections)] = one.detections.instance_ids
        present[row, : len(one.detections)] = one.masks.valid
    return Recording(name, sightings, motion, truth, present)


@functools.partial(jax.jit, static_argnames="static")
def _scan(state: Any, frames: Any, thresholds: PlusThresholds, static: Static) -> Any:
    def one(state: Any, frame: Any) -> Any:
        state, _ = advance(state, *frame, static=static, thresholds=thresholds)
        told = (state.answers.answer_id, state.decisions.confidence, state.overflow.objects)
        return state, told

    return jax.lax.scan(one, state, frames)[1]


def answer(recording: Recording, thresholds: PlusThresholds) -> tuple[np.ndarray, np.ndarray]:
    """Answers and their confidence `[T, N]`."""
    static = Static(
        num_detections=recording.truth.shape[1],
        num_objects=128,
        feature_dim=recording.sightings.look.shape[-1],
    )
    frames = (recording.sightings, recording.motion, recording.present)
    while True:
        ids, confidence, lacking = jax.device_get(_scan(init(static), frames, thresholds, static))
        if not lacking.any():
            return ids, confidence
        static = static.grow(num_objects=2 * static.num_objects)


def judge(recording: Recording, ids: np.ndarray) -> dict[str, float]:
    """Scores of answers; `repeated` counts ids that a frame gives more than once."""
    frame = np.broadcast_to(np.arange(len(ids))[:, None], ids.shape)
    said = ids >= 0
    repeated = 0
    for row in range(len(ids)):
        given = np.flatnonzero(said[row])
        _, first = np.unique(ids[row, given], return_index=True)
        extra = np.delete(given, first)
        said[row, extra] = False
        repeated += len(extra)
    # Two detections of one object in a frame: the first one is the object.
    true = recording.truth != NO_INSTANCE
    for row in range(len(ids)):
        given = np.flatnonzero(true[row])
        _, first = np.unique(recording.truth[row, given], return_index=True)
        true[row, np.delete(given, first)] = False
    both = (true & said).ravel()
    pairs = (np.cumsum(true) - 1)[both], (np.cumsum(said) - 1)[both], np.ones(int(both.sum()))
    sequence = TrackingSequence.create(
        len(ids),
        (frame[true], recording.truth[true]),
        (frame[said], ids[said]),
        pairs,
        name=recording.name,
    )
    scores = evaluate_sequence(sequence).scores()
    return {
        "IDF1": 100 * scores["IDF1"],
        "AssA": 100 * scores["AssA"],
        "HardRecovery": 100 * scores["HardRecovery"],
        "IDSW": scores["IDSW"],
        "ids": float(len(np.unique(ids[said]))),
        "objects": float(len(np.unique(recording.truth[true]))),
        "repeated": float(repeated),
    }


def changed(thresholds: PlusThresholds, changes: Changes) -> PlusThresholds:
    """Thresholds with some values of some groups changed."""
    groups = {
        group: dataclasses.replace(getattr(thresholds, group), **values)
        for group, values in changes.items()
    }
    return dataclasses.replace(thresholds, **groups)


def best_ids(truth: np.ndarray, ids: np.ndarray) -> dict[int, int]:
    """The one id of each object that fits it best, one to one over the sequence."""
    known = truth >= 0
    objects, row = np.unique(truth[known], return_inverse=True)
    given, column = np.unique(ids[known], return_inverse=True)
    common = np.zeros((len(objects), len(given)))
    np.add.at(common, (row, column), 1)
    pairs = zip(*linear_sum_assignment(-common), strict=True)
    return {int(objects[r]): int(given[c]) for r, c in pairs}


def is_right(truth: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Whether an answer is the one id that fits its object best."""
    reference = best_ids(truth, ids)
    return np.array([reference.get(int(o)) == i for o, i in zip(truth, ids, strict=True)])
