"""`Tracker`: the same tracker for a robot's loop, one frame in, identities out, no files.

`prepare` (host only) and `advance` (device) are the two halves of `update`, so that a run can do
the first ahead of the second in another thread.
"""

from __future__ import annotations

import dataclasses
import math
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax
import numpy as np

from remind_jax.backbone.registry import Backbone, get_backbone
from remind_jax.compiled.ahead import Forecast, Preparation
from remind_jax.compiled.frame_step import FrameInput, FrameStep, Told, pack_thresholds
from remind_jax.compiled.packing import Packed
from remind_jax.compiled.programs import waited_s
from remind_jax.config import Config, load_config
from remind_jax.decision import NO_ID, Decisions
from remind_jax.errors import ConfigError, SourceError
from remind_jax.frame import Detections, Frame
from remind_jax.masks.alignment import Alignment
from remind_jax.masks.reduction import pad_masks, reduce_masks
from remind_jax.method import get_method
from remind_jax.observation import FrameFeats, Masks, PatchAttention
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import Trace
from remind_jax.session.announcement import Announcements, choose_after, hear, tell
from remind_jax.session.memory_file import (
    SavedMemory,
    check_backbone,
    check_tracker,
    load_memory,
    save_memory,
    static_of,
)
from remind_jax.session.readout import Outlines, outline, read_tracks
from remind_jax.static import Static
from remind_jax.tracks import Tracks

_ATTENTION_SLOTS = 256  # object patches whose attention is kept; doubles with the need
_CAPACITIES = {
    "detections": "num_detections",
    "objects": "num_objects",
    "undecided tracks": "num_pending",
}
FEATURES_GIVEN = "features"  # name of the backbone of sources that bring their own features


@dataclasses.dataclass(frozen=True)
class Prepared:
    """A frame as the device needs it, and what the result will repeat of it."""

    frame: Frame
    detections: Detections  # without ignored classes, in pixels of the frame
    image: np.ndarray | None  # uint8 RGB at the tracker's size, or
    features: np.ndarray | None  # patch features that came with the frame
    masks: Masks  # one slot per detection
    num_ignored: int  # detections of ignored classes
    stage_ms: dict[str, float]
    observed: Any = None  # what the method observed between the last frame and this one


@dataclasses.dataclass(frozen=True)
class Notice:
    """Something that a frame did besides its decisions."""

    kind: str
    message: str


class Tracker:
    """Remembers objects over an unbounded stream of frames.

    Not thread-safe. Touches no file but in `save` and `load`, and for the compiled programs that it
    keeps (`remind_jax.compiled.kept`); programs for larger capacities are compiled in a thread of
    its own before they are needed. Results depend on neither.
    """

    def __init__(
        self,
        config: str | Path | Config | Mapping[str, Any] = "default",
        backbone: str | Backbone = "patch-statistics",
        *,
        tracker: str | None = None,
        trace: bool = False,
        announce_after: int | None = None,
        **backbone_options: Any,
    ) -> None:
        """Makes an empty memory.

        Args:
          config: Name of a shipped configuration, a YAML file, nested values, or a `Config`.
          backbone: Name of a registered backbone, or one that was made already.
          tracker: Name of the method (`remind_jax.method.list_methods`) with the thresholds of the
            shipped configuration of that name, else its published ones; that of the configuration
            if left out.
          trace: Keep what the decisions of the last frame were made of, as `trace`.
          announce_after: Detections after which an object gets its id; until then its detections
            are provisional. As the configuration says if left out, else 1, for masks that are
            right; `announcement.DETECTOR_DEFAULT` suits those of a detector.
          **backbone_options: Options of a backbone given by name.

        Raises:
          ConfigError: If one of them is unknown or does not fit.
        """
        self.config = load_config(config)
        if tracker is not None:
            self.config = self.config.with_tracker(tracker)
        self.announce_after = choose_after(announce_after, self.config.input.announce_after, False)
        self.method = get_method(self.config.tracker)
        if trace and self.method.step_traced is None:
            raise ConfigError(
                f"tracker '{self.method.name}' keeps no account of its decisions; leave out trace"
            )
        if isinstance(backbone, str):
            backbone = get_backbone(backbone, **backbone_options)
        self.backbone = backbone
        self._static = self.config.static
        if self._static.precision == "float64" and not jax.config.read("jax_enable_x64"):
            raise ConfigError(
                "static.precision is 'float64', which needs 64-bit JAX; set the environment "
                "variable JAX_ENABLE_X64=1"
            )
        self._ignored = {name.lower() for name in self.config.input.ignored_classes}
        self._class_ids: dict[str, int] = {}
        self._state: Any = None
        self._attention_slots = _ATTENTION_SLOTS
        if self._wants_attention():
            self.backbone.check_attention()
        self._last_image: np.ndarray | None = None  # of the last frame prepared
        self._features_given = False
        self._has_profile = False
        self._placed: tuple[Config | None, Packed | None] = (None, None)  # thresholds on the device
        self.announcements = self._announce_nothing()
        self._is_tracing = trace
        self.trace: Trace | None = None  # of the last frame, on the host
        self.decided: Tracks | None = None  # the last frame, by ids of the memory
        self.notices: list[Notice] = []  # of the last frame
        self.stage_ms: dict[str, float] = {}  # of the last frame
        self.compile_s = 0.0  # waited for programs to be compiled or loaded, so far
        self._frame_step = FrameStep(self.method, traced=trace)
        self._forecast, self._preparation = Forecast(), Preparation()

    @property
    def num_objects(self) -> int:
        """Objects in memory."""
        return 0 if self._state is None else int(np.sum(np.asarray(self._state.objects.id) >= 0))

    @property
    def state(self) -> Any:
        """The memory as a pytree; None before the first frame."""
        return self._state

    @property
    def static(self) -> Static:
        """Capacities as grown so far."""
        return self._static

    @property
    def class_names(self) -> tuple[str, ...]:
        """Classes met so far, by class id."""
        return tuple(self._class_ids)

    def reset(self) -> None:
        """Forgets everything; compiled programs stay."""
        self._state = None
        self._forecast = Forecast()
        self._last_image = None
        self._class_ids = {}
        self.trace = self.decided = None
        self.announcements = self._announce_nothing()

    def warm_up(self, frame_size: tuple[int, int], *, num_objects: int = 0) -> float:
        """Compiles or loads all programs for frames of one size, so that not even the first waits.

        Args:
          frame_size: Height and width in pixels.
          num_objects: Prepares the larger capacities as well that so many objects will need.

        Returns:
          Seconds that it took.

        Raises:
          SourceError: If frames of this size are too small.
        """
        start, last_image = time.perf_counter(), self._last_image
        image = np.zeros((*frame_size, 3), np.uint8)
        nothing = Detections.create(np.zeros((0, *frame_size), bool))
        prepared = self.prepare(Frame(0, 0, 0.0, "warm-up", image, nothing))
        self._last_image = last_image
        self._follow_profile()
        patches, attention = self._extract(prepared)
        frame_feats = FrameFeats(patches, np.array(frame_size, np.int32), attention)
        static = self._with_feature_dim(patches.shape[-1])
        while True:
            self._frame_step.prepare(self._input(frame_feats, prepared, static), static)
            if static.num_objects >= num_objects:
                return time.perf_counter() - start
            static = static.grow(num_objects=static.num_objects + 1)

    def update(self, frame: Any, detections: Any = None) -> Tracks:
        """Takes the next frame and says who is who in it.

        Args:
          frame: RGB image, uint8 `[H, W, 3]`, or a `Frame` (which may bring its own features).
          detections: `Detections`, `supervision.Detections`, boolean masks `[N, H, W]`, an
            instance map `[H, W]`; left out for a `Frame` that holds them.

        Raises:
          SourceError: If the frame is smaller than a patch, or masks and frame do not agree.
        """
        if not isinstance(frame, Frame):
            index = 0 if self._state is None else int(self._state.frame)
            image = np.asarray(frame)
            if image.ndim != 3 or image.shape[2] != 3 or image.dtype != np.uint8:
                raise SourceError(
                    f"the frame is {image.dtype} of shape {image.shape}; give an RGB image, "
                    "uint8 [H, W, 3]"
                )
            frame = Frame(index, index, float(index), str(index), image)
        if detections is not None:
            from remind_jax.sources.detections import detections_from

            given = detections_from(detections, frame.size)
            frame = dataclasses.replace(frame, detections=given)
        return self.advance(self.prepare(frame))

    def prepare(self, frame: Frame) -> Prepared:
        """The part of `update` that needs no memory: drops ignored classes and reduces masks.

        Raises:
          SourceError: If the frame has no detections, neither image nor features, is smaller than
            a patch, or disagrees with its masks about the size.
        """
        start = time.perf_counter()
        if frame.detections is None:
            raise SourceError(f"frame '{frame.name}' comes without masks; give masks or a detector")
        masks = frame.detections.masks
        if frame.image is not None and frame.image.shape[:2] != masks.shape[1:]:
            raise SourceError(
                f"masks of frame '{frame.name}' are {masks.shape[2]}x{masks.shape[1]} pixels, the "
                f"image is {frame.image.shape[1]}x{frame.image.shape[0]}"
            )
        kept = [i for i, name in enumerate(frame.detections.labels) if not self._ignores(name)]
        detections = frame.detections.select(np.array(kept, int))
        patch_px = self._patch_px(frame)
        alignment = Alignment.fit(frame.size, patch_px, self.config.input)
        options = self.config.input
        reduced = reduce_masks(
            alignment.align_masks(detections.masks),
            np.array([self._class_id(name) for name in detections.labels], np.int32),
            detections.scores,
            num_slots=len(detections),
            patch_px=patch_px,
            sanitize=options.sanitize,
            fill_holes=options.fill_holes,
            close_px=options.close_px,
            open_px=options.open_px,
            keep_largest=options.keep_largest,
            erosion_px=options.erosion_px,
            **self._gap_options(),
        )
        image = None if frame.image is None else alignment.align_image(frame.image)
        reduced_at = time.perf_counter()
        spent = {"masks": 1000 * (reduced_at - start)}
        observed = None
        if self.method.observe is not None:
            observed = self.method.observe(self._last_image, image)
            self._last_image = image
            spent["observe"] = 1000 * (time.perf_counter() - reduced_at)
        num_ignored = len(frame.detections) - len(kept)
        return Prepared(
            frame, detections, image, frame.features, reduced, num_ignored, spent, observed
        )

    def advance(self, prepared: Prepared) -> Tracks:
        """The part of `update` that reads and writes memory."""
        start, waited_before = time.perf_counter(), waited_s()
        attention = None
        if prepared.features is not None:
            patches, self._features_given = prepared.features, True
        elif prepared.image is not None:
            self._follow_profile()
            patches, attention = jax.block_until_ready(self._extract(prepared))
        else:
            raise SourceError(
                f"frame '{prepared.frame.name}' has neither an image nor patch features"
            )
        described = time.perf_counter()
        size = np.array(prepared.frame.size, np.int32)
        self.notices = self._say_ignored(prepared)
        decisions, outlines = self._step(FrameFeats(patches, size, attention), prepared)
        tracks = self._announce(self._read(prepared, outlines, decisions))
        done = time.perf_counter()
        self.compile_s += waited_s() - waited_before
        self.stage_ms = {
            **prepared.stage_ms,
            "backbone": 1000 * (described - start),
            "step": 1000 * (done - described),
        }
        return tracks

    def save(self, path: str | Path) -> None:
        """Writes the memory to a file.

        Raises:
          OutputError: If the file cannot be written.
          SourceError: If there is nothing to remember yet.
        """
        if self._state is None:
            raise SourceError("there is no memory to save before the first frame")
        name = FEATURES_GIVEN if self._features_given else self.backbone.name
        told = None if self.announcements.is_identity else self.announcements
        saved = SavedMemory(
            self._state, self._static, self.class_names, name, self.method.name, told
        )
        save_memory(path, saved)

    def load(self, path: str | Path) -> None:
        """Goes on from a memory file; what is in memory now is forgotten.

        Thresholds stay those of this tracker, capacities and structural switches that nobody chose
        become those of the file.

        Raises:
          OutputError: If the file is missing, damaged or of another schema.
          RemindError: If it was made with another backbone, by another tracker, or with room for
            other switches.
        """
        memory = load_memory(path)
        check_tracker(memory, self.method.name, path)
        if memory.backbone != FEATURES_GIVEN:
            check_backbone(memory, self.backbone.name, path)
        self._features_given = memory.backbone == FEATURES_GIVEN
        self._state, self._static = memory.state, static_of(memory, self.config, path)
        self._class_ids = {name: number for number, name in enumerate(memory.class_names)}
        if memory.announced is not None:
            self.announcements = memory.announced
        elif self.announce_after > 1:
            self.announcements = Announcements.all_below(int(memory.state.next_id))
        else:
            self.announcements = Announcements()

    def _follow_profile(self) -> None:
        """Takes the thresholds made for the backbone, now that it is known to be used."""
        if not self._has_profile:
            self.config = self.config.for_backbone(self.backbone.name)
            self._has_profile = True

    def _extract(self, prepared: Prepared) -> tuple[jax.Array, PatchAttention | None]:
        """Patch features of the frame, and attention between its objects' patches if wanted."""
        assert prepared.image is not None
        images = prepared.image[None]
        if not self._wants_attention():
            return self.backbone.extract(images)[0], None
        patches = np.flatnonzero(np.any(prepared.masks.coverage > 0, axis=0))
        while self._attention_slots < len(patches):
            self._attention_slots *= 2
        slots = np.full(self._attention_slots, -1, np.int32)
        slots[: len(patches)] = patches
        heads = self._static.attention_heads or None
        features, paid = self.backbone.extract_with_attention(images, slots[None], heads)
        return features[0], PatchAttention(slots, paid.row_sums[0], paid.block[0])

    def _wants_attention(self) -> bool:
        """Whether parts come from attention; other methods know no parts."""
        is_remind = isinstance(self.config.thresholds, Thresholds)
        return is_remind and "attention" in self._static.part_channels

    def _ignores(self, label: str) -> bool:
        return label.lower() in self._ignored

    def _class_id(self, label: str) -> int:
        return self._class_ids.setdefault(label, len(self._class_ids))

    def _gap_options(self) -> dict[str, float]:
        """How gaps between masks are measured; of no interest to methods without relations."""
        if not isinstance(self.config.thresholds, Thresholds):
            return {"exact_gap_max": -math.inf}
        relations = self.config.thresholds.relations
        return {
            "scale_min_px": float(relations.scale_min_px),
            "exact_gap_max": float(relations.exact_gap_max),
        }

    def _patch_px(self, frame: Frame) -> int:
        """Side of a patch in pixels of the frame."""
        if frame.features is None:
            return self.backbone.patch_px
        (height, width), (rows, columns) = frame.size, frame.features.shape[:2]
        patch_px = height // rows
        if patch_px < 1 or (height // patch_px, width // patch_px) != (rows, columns):
            raise SourceError(
                f"features of frame '{frame.name}' are {rows}x{columns} patches, which do not "
                f"tile its {height}x{width} pixels with square patches"
            )
        return patch_px

    def _step(self, frame_feats: FrameFeats, prepared: Prepared) -> tuple[Decisions, Outlines]:
        """Steps, growing capacities until the frame fits; outlines the masks meanwhile."""
        static = self._with_feature_dim(frame_feats.patches.shape[-1])
        if self._state is None:
            self._state, self._static = self.method.init(static), static
        if (num := len(prepared.masks.valid)) > self._static.num_detections:
            self._make_room(num_detections=num)
        outlines: Outlines | None = None
        while True:
            # Kept at once: the step takes over the memory of the old state, and Ctrl-C may come
            # while its result is waited for.
            self._state, packed, trace = self._frame_step(
                self._state, self._input(frame_feats, prepared, self._static), self._static
            )
            outlines = outlines or outline(prepared.detections.masks)
            told: Told = jax.device_get(packed).unpack()
            if not told.overflow.objects and not told.overflow.pending:
                break
            self._make_room(
                num_objects=int(told.overflow.objects), num_pending=int(told.overflow.pending)
            )
        self.trace = jax.device_get(trace)
        self._look_ahead(frame_feats, prepared, told)
        return told.decisions, outlines

    def _with_feature_dim(self, dim: int) -> Static:
        """The capacities with the width of the features, which the first frame tells."""
        if self._static.feature_dim not in (0, dim):
            raise SourceError(
                f"the frame has features of {dim} numbers, the memory knows "
                f"{self._static.feature_dim}; go on with the features that it was made with"
            )
        return dataclasses.replace(self._static, feature_dim=dim)

    def _input(self, frame_feats: FrameFeats, prepared: Prepared, static: Static) -> FrameInput:
        masks = pad_masks(prepared.masks, static.num_detections)
        given = Packed.of((masks, prepared.observed))
        return FrameInput(frame_feats, given, self._place_thresholds())

    def _make_room(self, **needed: int) -> None:
        """Grows, as the frame does not fit; the programs for it are often ready by then."""
        self._grow(self._preparation.room_for(self._static.grow(**needed)))

    def _look_ahead(self, frame_feats: FrameFeats, prepared: Prepared, told: Told) -> None:
        """Has the programs for the next capacities compiled once it is foreseen that they come."""
        num_objects, num_pending = (int(count) for count in told.occupied)
        self._forecast.add(
            time.monotonic(),
            {
                "num_detections": len(prepared.masks.valid),
                "num_objects": num_objects,
                "num_pending": num_pending,
            },
        )
        static = self._forecast.needed(self._static)
        if static != self._static:
            # The size of this frame is that of the next ones.
            self._preparation.start(
                static,
                lambda static: self._frame_step.prepare(
                    self._input(frame_feats, prepared, static), static
                ),
            )

    def _place_thresholds(self) -> Packed:
        """The thresholds of the configuration, brought to the device once: hundreds of numbers."""
        config, placed = self._placed
        if config is not self.config or placed is None:
            placed = jax.device_put(pack_thresholds(self.config.thresholds, self._static.scalar))
            self._placed = (self.config, placed)
        return placed

    def _grow(self, static: Static) -> None:
        """Moves the memory into larger capacities; results do not depend on them."""
        self._state, before = self.method.enlarge(self._state, static), self._static
        self._static = static
        for what, name in _CAPACITIES.items():
            capacity = getattr(static, name)
            if capacity != getattr(before, name):
                self.notices.append(Notice("capacity", f"there is room for {capacity} {what} now"))

    def _say_ignored(self, prepared: Prepared) -> list[Notice]:
        if prepared.num_ignored and not len(prepared.detections):
            message = (
                f"all {prepared.num_ignored} detections are of ignored classes "
                f"({', '.join(self.config.input.ignored_classes)}); see input.ignored_classes"
            )
            return [Notice("ignored", message)]
        return []

    def _read(self, prepared: Prepared, outlines: Outlines, decisions: Decisions) -> Tracks:
        """What the user is told of the frame."""
        num = len(prepared.detections)
        if bad := int(decisions.num_bad_patches):
            message = f"{bad} patches were left out for a feature that is not finite"
            self.notices.append(Notice("features", message))
        empty = [i for i in range(num) if not prepared.masks.valid[i]]
        if empty:
            self.notices.append(Notice("dropped", f"{len(empty)} empty masks were dropped"))
        return read_tracks(prepared.frame, prepared.detections, outlines, decisions)

    def _announce_nothing(self) -> Announcements:
        """What is announced of an empty memory."""
        return (
            Announcements.none(self._static.first_object_id)
            if self.announce_after > 1
            else Announcements()
        )

    def _announce(self, decided: Tracks) -> Tracks:
        """The frame by what is announced, this frame included; tells of objects that became one."""
        merges = [] if self.method.merges is None else self.method.merges(self._state)
        before, self.decided = self.announcements, decided
        self.announcements = hear(before, decided, self.announce_after, merges)
        for gone, kept in merges:
            old, new = before.id_of(gone), self.announcements.id_of(kept)
            if NO_ID not in (old, new) and old != new:
                self.notices.append(Notice("merged", f"object {old} turned out to be object {new}"))
        return tell(self.announcements, decided)
