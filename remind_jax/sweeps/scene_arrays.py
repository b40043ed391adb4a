"""A whole scene as arrays: described once for all settings to which frames look the same.

Letters: `T` frames, `N` detection slots.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import hashlib
import logging
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np
from jaxtyping import Bool, Int

from remind_jax.backbone.opening import open_backbone
from remind_jax.backbone.registry import DEFAULT_BACKBONE, Backbone
from remind_jax.config import Config, load_config
from remind_jax.config.dotted_keys import nest
from remind_jax.errors import SourceError
from remind_jax.frame import NO_INSTANCE, Frame
from remind_jax.masks.reduction import pad_feats, pad_masks
from remind_jax.method import Method, get_method
from remind_jax.observation import AnyFeats, Masks
from remind_jax.printing.words import plural
from remind_jax.session.live import Tracker
from remind_jax.settings.ranges import check_option
from remind_jax.sources import open_source
from remind_jax.sources.opening import check_options
from remind_jax.sources.prefetch import prefetch
from remind_jax.sources.source import Source
from remind_jax.static import MOST_OBJECTS, Static
from remind_jax.sweeps.settings import stack

NONE = -1

_log = logging.getLogger(__name__)


@dataclasses.dataclass(frozen=True)
class StackedScene:
    """A scene as arrays of fixed shapes, for `jax.lax.scan` over the frames of any method.

    Letters: `N` detection slots, as many as the fullest frame has detections.
    """

    # `observation.FrameFeats` or `CloseupFeats`, `observation.Masks`, and what the method observed
    # beside them or None: `method.step(state, *frame, ...)`. Leading axis `T`.
    frames: tuple[AnyFeats, Masks, Any]
    static: Static  # capacities, for `init` and `step`
    settings: Any  # the numbers of the configuration, for the features that frames have

    @property
    def valid(self) -> Bool[np.ndarray, "T N"]:
        """Slots that hold a detection; those of a frame come first, in their order."""
        return np.asarray(self.frames[1].valid)


@dataclasses.dataclass(frozen=True)
class SceneFrames:
    """What the tracker is shown of a scene, reduced on the host."""

    name: str
    feats: list[AnyFeats]
    masks: list[Masks]  # one slot per detection
    observed: list[Any]  # what the method observed beside them
    object_index: Int[np.ndarray, "T N"]  # true object of each detection: 0, 1, ...; -1 for none
    num_objects: int  # true ones
    config: Config  # what a setting does not name, with the profile of what features come from

    @property
    def num_frames(self) -> int:
        """Frames."""
        return len(self.masks)

    @property
    def most_detections(self) -> int:
        """Detections of the fullest frame."""
        return max((len(masks.valid) for masks in self.masks), default=0)

    @property
    def capacities(self) -> dict[str, int]:
        """Slots for what is in the scene, and for what a frame may add to it, by name.

        They are rounded, so that scenes of about the same size share programs. Where settings go
        one after the other, spare slots cost little, and there is room for every second object to
        be taken for a new one: without, most sweeps would soon compile a larger program.
        """
        most = self.most_detections
        in_turn = get_method(self.config.tracker).sweeping.in_turn_on_cpu
        needed = {
            "num_detections": most,
            "num_objects": self.num_objects * (3 if in_turn else 2) // 2 + most,
            "num_pending": most,
        }
        return {name: _round_up(max(1, count)) for name, count in needed.items()}

    @functools.cached_property
    def digest(self) -> str:
        """Hash of all that the tracker is shown, and of the truth."""
        digest = hashlib.sha256()
        for leaf in jax.tree.leaves((self.feats, self.masks, self.observed)):
            digest.update(np.ascontiguousarray(leaf).data)
        digest.update(np.ascontiguousarray(self.object_index).data)
        return digest.hexdigest()


def _round_up(count: int) -> int:
    """The next of 1 to 8, 10, 12, 14, 16, 20, 24, ...: up to a quarter more."""
    step = 1 << max(0, count.bit_length() - 3)
    return -(-count // step) * step


def load_scene(
    source: Source, config: Config, backbone: Backbone, reduced_with: Mapping[str, float] = {}
) -> SceneFrames:
    """Reads a scene and its features.

    Args:
      backbone: What features come from where the source brings none; one that caches them does so
        once. Its profile is followed then.
      reduced_with: Thresholds that masks are reduced with instead of those of `config`, by name.

    Raises:
      SourceError: If the source is empty, or does not say which objects its masks show.
    """
    feats, masks, observed, instances, config = _read(source, config, backbone, reduced_with)
    found = sorted({int(i) for ids in instances for i in ids} - {NO_INSTANCE})
    if not found:
        raise SourceError(
            f"'{source.name}' holds no mask of a known object; a sweep is scored against masks "
            "that say which object they show"
        )
    index = _index_objects(instances, found)
    return SceneFrames(source.name, feats, masks, observed, index, len(found), config)


def stack_scene(
    source: Any,
    config: str | Path | Config | Mapping[str, Any] = "default",
    backbone: str | Backbone = DEFAULT_BACKBONE,
    *,
    num_objects: int | None = None,
    **source_options: Any,
) -> StackedScene:
    """Reads a scene into arrays on which the pure functions of a method run.

    Example:
      >>> scene = rj.stack_scene("rooms.mp4", masks="masks/")
      >>> method = rj.get_method("default")
      >>> def advance(state, frame):
      ...     state = method.step(state, *frame, static=scene.static, thresholds=scene.settings)
      ...     return state, (state.decisions.object_id, state.overflow.objects)
      >>> state, (ids, lacked) = jax.lax.scan(advance, method.init(scene.static), scene.frames)
      >>> assert not lacked.any()

    Args:
      source: Whatever `open_source` opens, with its detections.
      config: The method, its settings and how input is read.
      backbone: What features come from where the source brings none.
      num_objects: Object slots, as in the configuration if left out. `state.overflow.objects` says
        after each frame how many it needed, 0 if they sufficed; collect it, for a frame that lacks
        some changes nothing else, and the next one may have enough.
      **source_options: Of `open_source`: `masks`, `sampling`, ...

    Raises:
      RemindError: If source, configuration or backbone are not accepted.
    """
    if num_objects is not None:
        check_option("num_objects", num_objects, 1, MOST_OBJECTS)
    check_options(source_options, stack_scene)
    source = open_source(source, **source_options)
    feats, masks, observed, _, config = _read(source, load_config(config), open_backbone(backbone))
    static = dataclasses.replace(
        config.static,
        num_detections=max(1, *(len(one.valid) for one in masks)),
        num_objects=num_objects or config.static.num_objects,
        feature_dim=feats[0].patches.shape[-1],
    )
    padded = [
        (pad_feats(one, static.num_detections), pad_masks(some, static.num_detections), beside)
        for one, some, beside in zip(feats, masks, observed, strict=True)
    ]
    frames = jax.tree.map(lambda *leaves: np.stack(leaves), *padded)
    return StackedScene(frames, static, config.thresholds)


def _read(
    source: Source, config: Config, backbone: Backbone, reduced_with: Mapping[str, float] = {}
) -> tuple[list[AnyFeats], list[Masks], list[Any], list[np.ndarray], Config]:
    """Of all frames features, masks, what is observed, and instances.

    Last, the configuration, with the profile of the backbone unless the source brings features.
    """
    reader = Tracker(config.updated({"thresholds": nest(reduced_with)}), backbone)
    feats, masks, observed, instances = [], [], [], []
    brings_features = False
    # One waits at most, whatever its size.
    ahead = prefetch(
        (reader.prepare(_with_masks(frame, source.name)) for frame in source),
        depth=1,
        size_of=lambda _: 0,
    )
    with contextlib.closing(ahead):
        for prepared in ahead:
            brings_features = prepared.features is not None
            feats.append(jax.device_get(reader.describe(prepared)))
            shape, first = (one.patches.shape[-3:] for one in (feats[-1], feats[0]))
            if shape != first:  # all that closeups share as well
                raise SourceError(
                    f"features of frame '{prepared.frame.name}' of '{source.name}' are "
                    f"{list(shape)}, those of the first {list(first)}; give all frames features "
                    "of one shape, or none"
                )
            masks.append(prepared.masks)
            observed.append(prepared.observed)
            instances.append(prepared.detections.instance_ids)
    if not masks:
        raise SourceError(f"'{source.name}' has no frames")
    if left_out := sum(frame.count for frame in source.skipped):
        _log.warning(
            "'%s': %s left out, the first: %s",
            source.name, plural(left_out, "frame"), source.skipped[0].reason,
        )  # fmt: skip
    if not any(np.isfinite(one.patches).any() for one in feats):
        raise SourceError(
            f"not one feature of '{source.name}' is a finite number; give another backbone, or its "
            "features in float32"
        )
    if not brings_features:
        config = config.for_backbone(*backbone.identity)
    return feats, masks, observed, instances, config


def _with_masks(frame: Frame, scene: str) -> Frame:
    if frame.detections is None:
        raise SourceError(
            f"frame '{frame.name}' of '{scene}' comes without masks; give masks that say which "
            "object they show"
        )
    return frame


def _index_objects(instances: list[np.ndarray], found: list[int]) -> Int[np.ndarray, "T N"]:
    number = {instance: index for index, instance in enumerate(found)}
    shape = (len(instances), max(len(ids) for ids in instances))
    index = np.full(shape, NONE, np.int32)
    for frame, ids in enumerate(instances):
        index[frame, : len(ids)] = [number.get(int(instance), NONE) for instance in ids]
    return index


def describe_scene(scene: SceneFrames, static: Static, config: Config) -> Any:
    """Every detection of a scene described: frames for `Method.decide`, leading axis `T`.

    Of the thresholds of `config` those of `Sweeping.described_by` matter.
    """
    method = get_method(config.tracker)
    thresholds = stack(config.thresholds, [{}], static.scalar)
    thresholds = jax.tree.map(lambda leaf: leaf[0], thresholds)
    frames = []
    for feats, masks, observed in zip(scene.feats, scene.masks, scene.observed, strict=True):
        padded = pad_masks(masks, static.num_detections)
        feats = pad_feats(feats, static.num_detections)
        frames.append(
            jax.device_get(_describe(method, static, feats, padded, observed, thresholds))
        )
    return jax.tree.map(lambda *leaves: np.stack(leaves), *frames)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _describe(
    method: Method, static: Static, feats: AnyFeats, masks: Masks, observed: Any, thresholds: Any
) -> Any:
    return method.describe(feats, masks, observed, static=static, thresholds=thresholds)
