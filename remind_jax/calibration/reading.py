"""Scenes as views: every detection described with two backbones, in bounded memory.

Letters: `V` views.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Int

from remind_jax.backbone.registry import Backbone
from remind_jax.calibration.comparisons import NONE, Sightings, Views
from remind_jax.calibration.estimate import join
from remind_jax.config import Config
from remind_jax.detectors.detector import Detector
from remind_jax.errors import SourceError
from remind_jax.masks.reduction import pad_masks
from remind_jax.method import Method, get_method
from remind_jax.metrics.pairing import box_iou
from remind_jax.observation import Descriptors, FrameFeats, Masks
from remind_jax.session.live import Tracker
from remind_jax.session.preparation import Prepared
from remind_jax.sources.source import Source
from remind_jax.static import Static

MAX_BYTES = 256 << 20  # of the views of a scene
_SLOTS = 8  # detection slots grow by so many

MIN_OVERLAP = 0.3  # of the boxes in two successive frames


@dataclasses.dataclass(frozen=True)
class SceneViews:
    """The views of a scene to each backbone, and what they show."""

    name: str
    views: tuple[Views, ...]  # with each backbone
    tracklets: Sightings


def read_scene(
    source: Source,
    config: Config,
    backbones: Sequence[Backbone],
    detector: Detector | None = None,
    most_bytes: int = MAX_BYTES,
) -> SceneViews:
    """Describes all detections; of a long scene those of every second, fourth, ... frame.

    Raises:
      SourceError: If the scene is empty, has no images or no masks.
    """
    config = config.updated({"perception.part_merge": 1.0})
    describers = [_Describer(config, backbone) for backbone in backbones]
    kept: dict[int, list[Views]] = {}
    frames: list[Boxes] = []
    stride, num_bytes = 1, 0
    for number, frame in enumerate(source):
        if frame.image is None:
            raise SourceError(f"'{source.name}' has no images; give scenes with images and masks")
        if detector is not None:
            frame = dataclasses.replace(frame, detections=detector(frame.image))
        prepared = [one.prepare(frame) for one in describers]
        frames.append(Boxes.of(prepared[0]))
        if number % stride or not len(prepared[0].detections):
            continue
        kept[number] = [
            one.describe(given) for one, given in zip(describers, prepared, strict=True)
        ]
        num_bytes += sum(views.num_bytes for views in kept[number])
        while num_bytes > most_bytes and len(kept) > 1:
            stride *= 2
            kept = {one: views for one, views in kept.items() if one % stride == 0}
            num_bytes = sum(views.num_bytes for both in kept.values() for views in both)
    if not kept:
        asked = "scenes with images and masks" if detector is None else "scenes where it finds some"
        raise SourceError(f"'{source.name}' has no detections; give {asked}")
    return _collect(source.name, kept, frames)


@dataclasses.dataclass(frozen=True)
class Boxes:
    """What is kept of every frame."""

    index: int
    box: np.ndarray
    valid: np.ndarray
    class_id: np.ndarray

    @classmethod
    def of(cls, prepared: Prepared) -> Boxes:
        """Those of a frame."""
        masks, num = prepared.masks, len(prepared.detections)
        return cls(
            prepared.frame.index,
            np.array(masks.box[:num], float),
            np.array(masks.valid[:num]),
            np.array(masks.class_id[:num]),
        )


class _Describer:
    """Prepares and describes the frames of one scene with one backbone."""

    def __init__(self, config: Config, backbone: Backbone) -> None:
        # Reduces the masks of a frame.
        self.prepare = Tracker(
            dataclasses.replace(config, backbone_profile=False), backbone
        ).prepare
        self._backbone, self._config = backbone, config
        self._static = dataclasses.replace(config.static, feature_dim=backbone.dim)
        self._thresholds = config.thresholds.as_arrays(config.static.scalar)

    def describe(self, prepared: Prepared) -> Views:
        """The views of a frame, one per detection."""
        num = len(prepared.detections)
        self._static = self._static.grow(num_detections=-(-num // _SLOTS) * _SLOTS)
        assert prepared.image is not None
        patches = np.asarray(self._backbone.extract(prepared.image[None])[0])
        feats = FrameFeats(patches, np.array(prepared.frame.size, np.int32))
        masks = pad_masks(prepared.masks, self._static.num_detections)
        method = get_method(self._config.tracker)
        seen = jax.device_get(_describe(method, self._static, feats, masks, self._thresholds))
        valid = seen.valid[:num, None]
        return Views(
            appearance=seen.appearance[:num],
            appearance_seen=seen.appearance_valid[:num] & valid,
            rings=seen.rings[:num],
            rings_seen=seen.rings_valid[:num] & valid,
            parts=seen.parts[:num, 0],
            parts_seen=seen.parts_valid[:num, 0] & valid,
        )


@functools.partial(jax.jit, static_argnums=(0, 1))
def _describe(
    method: Method, static: Static, feats: FrameFeats, masks: Masks, thresholds: Any
) -> Descriptors:
    seen = method.describe(feats, masks, None, static=static, thresholds=thresholds)
    return seen.descriptors


def _collect(name: str, kept: dict[int, list[Views]], frames: list[Boxes]) -> SceneViews:
    """Puts the views of all frames one after the other, and says which object each shows."""
    tracks = link_boxes(frames)
    seen = []
    for number in kept:
        one = frames[number]
        index = np.full(len(one.valid), one.index, np.int32)
        seen.append(Sightings(index, tracks[number], one.class_id))
    views = tuple(join(of_one) for of_one in zip(*kept.values(), strict=True))
    return SceneViews(name, views, join(seen))


def link_boxes(frames: Sequence[Boxes]) -> list[Int[np.ndarray, "N"]]:
    """Numbers the tracklets of each frame; -1 where there is no detection.

    A detection goes on with the one of the frame before that overlaps it most, if that overlaps no
    other more, by `MIN_OVERLAP` of the union at least, and is of its class.
    """
    found: list[np.ndarray] = []
    number = 0
    for t, now in enumerate(frames):
        track = np.full(len(now.valid), NONE, np.int32)
        if t and len(frames[t - 1].valid):
            last = frames[t - 1]
            overlap = box_iou(last.box, now.box) * (last.valid[:, None] & now.valid)
            overlap *= last.class_id[:, None] == now.class_id
            for slot in np.flatnonzero(now.valid):
                before = int(overlap[:, slot].argmax())
                best = overlap[before, slot]
                if best >= MIN_OVERLAP and overlap[before].argmax() == slot:
                    track[slot] = found[-1][before]
        fresh = now.valid & (track == NONE)
        track[fresh] = number + np.arange(int(fresh.sum()))
        number += int(fresh.sum())
        found.append(track)
    return found
