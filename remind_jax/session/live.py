"""`Tracker`: the same tracker for a robot's loop, one frame in, identities out, no files.

`prepare` (host only) and `advance` (device) are the two halves of `update`, so that a run can do
the first ahead of the second in another thread.
"""

from __future__ import annotations

import contextlib
import dataclasses
import functools
import threading
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from remind_jax.backbone.registry import Backbone, get_backbone
from remind_jax.compiled.programs import waited_s
from remind_jax.config import Config, load_config
from remind_jax.crops import require_room
from remind_jax.errors import ConfigError, OutputError, RemindError, SourceError
from remind_jax.files import as_path, resolve
from remind_jax.frame import Detections, Frame, check_frame, check_size, frame_of
from remind_jax.method import get_method
from remind_jax.observation import AnyFeats
from remind_jax.outputs.run_records import Event, MemoryUse
from remind_jax.printing.small_table import Printable, SmallTable
from remind_jax.printing.words import plural
from remind_jax.session import memory_file
from remind_jax.session.announcement import choose_after
from remind_jax.session.answers import note_omissions, read_tracks
from remind_jax.session.changed_memory import JoinedObjects, forget_object, join_memories
from remind_jax.session.frame_features import FrameFeatures
from remind_jax.session.growing_memory import GrowingMemory
from remind_jax.session.identities import Identities
from remind_jax.session.machine_memory import most_detections
from remind_jax.session.memory_fit import check_backbone, check_classes, check_tracker, static_of
from remind_jax.session.object_records import ObjectRecords, RememberedObject
from remind_jax.session.preparation import FramePreparer, Prepared
from remind_jax.settings.ranges import check_option, check_switch
from remind_jax.static import MOST_DETECTIONS, MOST_OBJECTS, Static
from remind_jax.tracks import Tracks

FEATURES_GIVEN = "features"  # name of the backbone of sources that bring their own features


class Tracker(Printable):
    """Remembers objects over an unbounded stream of frames.

    For one thread at a time: a second one is refused. Touches no file but in `save` and `load`, and
    for the compiled programs that it keeps (`remind_jax.compiled.kept`); programs for larger
    capacities are compiled in a thread of its own before they are needed. Results depend on
    neither.

    Example:
      >>> import numpy as np
      >>> import remind_jax as rj
      >>> tracker = rj.Tracker()
      >>> image = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8)
      >>> masks = np.zeros((1, 96, 128), bool)
      >>> masks[0, 16:80, 32:96] = True
      >>> tracker.update(image, rj.Detections.create(masks, ["mug"])).display_name(0)
      'mug 0'
    """

    def __init__(
        self,
        config: str | Path | Config | Mapping[str, Any] = "default",
        backbone: str | Backbone = "patch-statistics",
        *,
        tracker: str | None = None,
        trace: bool = False,
        announce_after: int | None = None,
        memory: str | Path | None = None,
        **backbone_options: Any,
    ) -> None:
        """Makes an empty memory, or takes one up.

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
          memory: File that it goes on from, as with `load`.
          **backbone_options: Options of a backbone given by name.

        Raises:
          RemindError: If one of them is unknown or does not fit.
        """
        check_switch("trace", trace)
        self.config = load_config(config)
        if tracker is not None:
            self.config = self.config.with_tracker(tracker)
        self.announce_after = choose_after(announce_after, self.config.input.announce_after, False)
        self.method = get_method(self.config.tracker)
        if trace and self.method.explainer is None:
            raise ConfigError(
                f"tracker '{self.method.name}' does not explain its decisions; leave out trace"
            )
        self.backbone = get_backbone(backbone, **backbone_options)
        static = self.config.static
        memory_file.check_precision(static, "the configuration has", ConfigError)
        self.features = FrameFeatures(self.method, self.backbone, self.config.input.closeups)
        self.features.check(static)
        self.traces = trace  # whether it keeps what decisions were made of
        self.preparer = self._new_preparer()
        self._memory = GrowingMemory(
            self.method, static, traced=trace, max_objects=self.config.input.max_objects
        )
        # Of one thread: what Ctrl-C kept from being released, it may take again.
        self._locks = {part: threading.RLock() for part in ("prepare", "advance")}
        # Those that were read or written, by path: others may change them meanwhile.
        self._memory_files: dict[Path, memory_file.MemoryFile] = {}
        self._features_given = False
        self._has_profile = False
        self.identities = Identities(self.announce_after, static.first_object_id)
        self.events: list[Event] = []  # of the last frame
        self.stage_ms: dict[str, float] = {}  # of the last frame
        self.compile_s = 0.0  # waited for programs to be compiled or loaded, so far
        if memory is not None:
            self.load(memory)

    def _summarize(self) -> SmallTable:
        with self._alone("advance"):
            seen = 0 if self.state is None else int(self.state.frame)
            known = self.objects()
        return SmallTable(
            f"tracker '{self.method.name}' on {self.backbone.name}: {plural(len(known), 'object')} "
            f"after {plural(seen, 'frame')}",
            heads=("object", "frames seen", "last seen"),
            rows=[(one.title, str(one.num_frames), str(one.last)) for one in known],
        )

    @property
    def num_objects(self) -> int:
        """Objects in memory."""
        return self.memory_use.objects

    @property
    def memory_use(self) -> MemoryUse:
        """How many objects it holds, where they lie, and what that takes."""
        with self._alone("advance"):
            return self._memory.use()

    def objects(self) -> tuple[RememberedObject, ...]:
        """What is known of each object in memory that got an id, by rising id."""
        with self._alone("advance"):
            return self._records().objects()

    def rename(self, object_id: int, name: str) -> None:
        """Gives an object a name, which answers and outputs show from now on; "" takes it back.

        Raises:
          SourceError: If there is no such object, the name is no short line of text, or another
            object has it.
        """
        with self._alone("advance"):
            self._records().rename(object_id, name)

    def merge(self, object_id: int, *others: int) -> None:
        """Declares others to be this object: from now on, all of them are answered by its id.

        Each keeps what is remembered of it, so that `split` can take it back.

        Raises:
          SourceError: If there is no such object, or one is named twice.
        """
        with self._alone("advance"):
            self._records().merge(object_id, others)

    def split(self, object_id: int) -> tuple[int, ...]:
        """Takes back what `merge` made one with this object; gives the ids of the others.

        Raises:
          SourceError: If there is no such object, or nothing was merged into it.
        """
        with self._alone("advance"):
            return self._records().split(object_id)

    def forget(self, object_id: int) -> None:
        """Removes an object with all that was merged into it, its looks and its pictures.

        When it is seen again it is new, and has another id.

        Raises:
          SourceError: If there is no such object.
        """
        with self._alone("advance"):
            self._records()
            self._memory.state = forget_object(self._saved(), object_id).state

    @property
    def state(self) -> Any:
        """The memory as a pytree; None before the first frame."""
        with self._alone("advance"):
            return self._memory.state

    @property
    def static(self) -> Static:
        """Capacities as grown so far."""
        return self._memory.static

    @property
    def has_grown(self) -> bool:
        """Whether the memory got more room in the last frame."""
        return self._memory.has_grown

    @property
    def trace(self) -> Any:
        """What the decisions of the last frame were made of, on the host; None if not asked for."""
        return self._memory.trace

    @functools.cached_property
    def most_detections(self) -> int:
        """Detections that a frame may have; room for more can be chosen (`static`)."""
        return most_detections(self.method, self.config.static, self.backbone.dim)

    @property
    def class_names(self) -> tuple[str, ...]:
        """Classes met so far; by class id, with those of a loaded memory, if they are compared."""
        is_agnostic = self.config.input.class_agnostic
        return tuple(self.preparer.labels if is_agnostic else self.preparer.class_ids)

    def reset(self) -> None:
        """Forgets everything; compiled programs stay."""
        with self._alone("prepare"), self._alone("advance"):
            self._memory.forget()
            self._let_files_go()
            self.events = []
            self.preparer, self._features_given = self._new_preparer(), False
            self.identities = Identities(self.announce_after, self.static.first_object_id)

    def warm_up(
        self, frame_size: tuple[int, int], *, num_objects: int = 0, num_detections: int = 0
    ) -> float:
        """Compiles or loads all programs for frames of one size, so that not even the first waits.

        Args:
          frame_size: Height and width in pixels.
          num_objects: Prepares the larger capacities as well that so many objects will need.
          num_detections: Makes room for so many detections in a frame at once: how many there are
            cannot be foreseen.

        Returns:
          Seconds that it took.

        Raises:
          SourceError: If frames of this size are too small.
        """
        start = time.perf_counter()
        frame_size = check_size(frame_size)
        check_option("num_objects", num_objects, 0, MOST_OBJECTS)
        check_option("num_detections", num_detections, 0, MOST_DETECTIONS)
        image = np.zeros((*frame_size, 3), np.uint8)
        nothing = Detections.empty(*frame_size)
        # With a preparer of its own: the next frame does not follow this one.
        preparer = self._new_preparer()
        with self._alone("advance"):
            self._memory.reserve(num_detections)
            prepared = preparer.prepare(Frame(0, 0, 0.0, "warm-up", image, nothing), self.config)
            self.follow_profile()
            feats, thresholds = self.describe(prepared), self.config.thresholds
            self._memory.prepare_programs(feats, prepared, thresholds, num_objects)
        return time.perf_counter() - start

    def _new_preparer(self) -> FramePreparer:
        """One that has seen no frame."""
        return FramePreparer(self.method, self.backbone.patch_px, self.features.with_closeups)

    def update(self, frame: Any, detections: Any = None, *, time_s: float | None = None) -> Tracks:
        """Takes the next frame and says who is who in it.

        Args:
          frame: RGB image, uint8 `[H, W, 3]`, or a `Frame` (which may bring its own features).
          detections: `Detections`, what YOLO, RF-DETR or SAM gave, masks `[N, H, W]`, boxes as a
            mapping: any form of `remind_jax.sources.detections_from`; left out for a `Frame` that
            holds them.
          time_s: When it was taken, in seconds of any clock; left out, frames come ten a second,
            or as a `Frame` says.

        Raises:
          SourceError: If the frame is smaller than a patch, or masks and frame do not agree.
        """
        with self._alone("prepare"), self._alone("advance"):
            return self._update(frame, detections, time_s)

    def _update(self, frame: Any, detections: Any, time_s: float | None) -> Tracks:
        number = 0 if self.state is None else int(self.state.frame)
        frame = frame if isinstance(frame, Frame) else frame_of(frame, number)
        if time_s is not None:
            clock: Any = time_s  # maybe an array of no dimensions
            time_s = clock.item() if getattr(clock, "shape", None) == () else clock
            frame = dataclasses.replace(frame, time_s=time_s, is_timed=True)
        check_frame(frame)
        # Those of a source that is opened again begin anew, what is remembered of objects does not.
        frame = dataclasses.replace(frame, index=number)
        if detections is not None:
            from remind_jax.sources.detections import detections_from

            given = detections_from(detections, frame.size)
            frame = dataclasses.replace(frame, detections=given)
        return self.advance(self.prepare(frame))

    def prepare(self, frame: Frame) -> Prepared:
        """The part of `update` that needs no memory: drops ignored classes and reduces masks.

        Raises:
          SourceError: If the frame has no detections or too many, neither image nor features, is
            smaller than a patch, or disagrees with its masks about the size.
        """
        check_frame(frame)
        if frame.detections is not None:
            require_room(len(frame.detections), frame.size, "the frame", self.most_detections)
        with self._alone("prepare"):
            return self.preparer.prepare(frame, self.config)

    def describe(self, prepared: Prepared) -> AnyFeats:
        """What the step will be told of a frame; needs no memory, and changes none.

        Raises:
          SourceError: If it has neither an image nor features.
        """
        return self.features.describe(prepared, self.static)

    def advance(self, prepared: Prepared) -> Tracks:
        """The part of `update` that reads and writes memory.

        Raises:
          RemindError: If another thread is in the middle of it.
        """
        if not isinstance(prepared, Prepared):
            raise SourceError(
                f"what is to be advanced is of type {type(prepared).__name__}; give what 'prepare' "
                "returned"
            )
        with self._alone("advance"):
            return self._advance(prepared)

    def _advance(self, prepared: Prepared) -> Tracks:
        start, waited_before = time.perf_counter(), waited_s()
        if prepared.class_ids is not self.preparer.class_ids:
            raise SourceError(
                f"frame '{prepared.frame.name}' was prepared before 'reset' or 'load', or by "
                "another Tracker; prepare it again"
            )
        self._follow_features(prepared)
        frame_feats = self.describe(prepared)
        described = time.perf_counter()
        self.events = []
        known, coming = self.method.known_ids(self.state), self.method.coming_ids(self.state)
        decisions, outlines = self._memory.step(frame_feats, prepared, self.config.thresholds)
        decided = read_tracks(prepared, outlines, decisions)
        merges = [] if self.method.host.merges is None else self.method.host.merges(self.state)
        merges = [(gone, kept) for gone, kept in merges if gone in known]
        pictured = prepared.frame.image if self.config.input.keep_pictures else None

        def known_ids() -> set[int]:
            return self._saved().known_ids()

        tracks, found = self.identities.add(decided, merges, pictured, known_ids)
        coming -= {*self.method.known_ids(self.state), *(gone for gone, _ in merges)}
        lost = self.identities.tell_lost(coming, prepared.frame.index, known_ids)
        omitted = note_omissions(prepared, decisions, self.config.input.ignored_classes)
        most, gone = self.config.input.max_objects, self._memory.forget_excess()
        excess = self.identities.tell_excess(gone, most, prepared.frame.index, known_ids)
        self.events = [*omitted, *found, *lost, *excess]
        done = time.perf_counter()
        self.compile_s += waited_s() - waited_before
        self.stage_ms = {
            **prepared.stage_ms,
            "backbone": 1000 * (described - start),
            "step": 1000 * (done - described),
        }
        return tracks

    def _follow_features(self, prepared: Prepared) -> None:
        """Notes where the features of a frame come from, which the memory must agree with."""
        given = prepared.features is not None
        if not given and prepared.image is None:
            return
        if self.state is not None and given != self._features_given:
            own, other = "brings its own features", "was made with features of a backbone"
            if not given:
                own, other = "brings none of its own", "was made with such"
            raise SourceError(
                f"frame '{prepared.frame.name}' {own}, the memory {other}; go on as it began, or "
                "'reset' first"
            )
        self._features_given = given
        if not given:
            self.follow_profile()

    def save(self, path: str | Path, *, durably: bool = False) -> None:
        """Writes the memory to a file; an older one is replaced only by a complete one.

        Args:
          durably: Return only when it is on the disk, so that it outlives a power cut.

        Raises:
          OutputError: If the file cannot be written.
          SourceError: If there is nothing to remember yet.
        """
        path = resolve(as_path(path, "the memory file", OutputError))
        with self._alone("advance"):
            memory = self._saved()
            self._memory_files.pop(path, None)
            try:
                memory_file.save_memory(path, memory, durably=durably)
            finally:  # it may be there, as after Ctrl-C
                self._memory_files[path] = memory_file.MemoryFile(path, is_read=True)

    def checkpoint(self, path: str | Path) -> None:
        """As `save`, and returns only when it is on the disk: for loops that may be cut off.

        A crash or a power cut leaves the memory before or this one. The first call writes
        everything, over any file that was not loaded, later ones add to the file what changed
        since: the working set, and other objects that were seen. What another program changed
        since, or since `load` read or `save` wrote the same file last, is not written over. Call it
        every so many seconds, and `load` the file at the next start.

        Raises:
          OutputError: If the file cannot be written, or another program changed it since the last
            call; the memory before is kept.
          SourceError: If there is nothing to remember yet.
        """
        path = resolve(as_path(path, "the memory file", OutputError))
        with self._alone("advance"):
            self._let_files_go(but=path)
            file = self._memory_files.setdefault(path, memory_file.MemoryFile(path))
            file.update(self._saved())

    def _let_files_go(self, but: Path | None = None) -> None:
        """The next memory is written as a whole to them, unless others change them meanwhile."""
        for path, file in self._memory_files.items():
            if path != but:
                file.let_go()

    def load(self, path: str | Path) -> None:
        """Goes on from a memory file; what is in memory now is forgotten.

        Thresholds stay those of this tracker, capacities and structural switches that nobody chose
        become those of the file.

        Raises:
          OutputError: If the file is missing, damaged or of another schema.
          RemindError: If it was made with another backbone, by another tracker, with classes where
            none are compared (or without), or with room for other switches.
        """
        read = memory_file.MemoryFile(
            resolve(as_path(path, "the memory file", OutputError)), is_read=True
        )
        memory = memory_file.load_memory(path)
        check_tracker(memory, self.method.name, path)
        check_classes(memory, self.config.input.class_agnostic, path)
        if memory.backbone != FEATURES_GIVEN:
            fingerprint = self.backbone.fingerprint
            check_backbone(memory, self.features.described_by, fingerprint, path)
        with self._alone("prepare"), self._alone("advance"):
            static = static_of(memory, self.config, path)
            self._let_files_go()
            self._memory.forget()
            self._memory.static, self._memory_files[read.path] = static, read
            self._features_given = memory.backbone == FEATURES_GIVEN
            self.preparer = self._new_preparer()
            self._restore(memory)
            self._memory.reserve()

    def join(self, path: str | Path) -> JoinedObjects:
        """Adds the objects of another memory; those that are known here are merged (`split`).

        Ids of this memory stay, the objects that come get free ones. What may be known and is not
        clear stays apart and is told.

        Raises:
          OutputError: If the file is missing, damaged or of another schema.
          RemindError: If it is of another tracker, another backbone or another width of features.
          ConfigError: If the tracker cannot join memories.
          SourceError: If there is nothing to join it with yet.
        """
        with self._alone("prepare"), self._alone("advance"):
            self._records()
            joined, told = join_memories(
                self._saved(), memory_file.load_memory(path), path, self.config.thresholds
            )
            self._restore(joined)
        return told

    def _restore(self, memory: memory_file.SavedMemory) -> None:
        """Goes on from what a memory knows."""
        self._memory.state = memory.state
        if memory.at_rest is not None:
            self._memory.at_rest = memory.at_rest
        self.preparer.class_ids |= {name: number for number, name in enumerate(memory.class_names)}
        self.identities.restore(memory)

    def __reduce__(self) -> Any:
        """Refuses to be pickled or copied."""
        raise RemindError(
            "a Tracker holds compiled programs and cannot be pickled or copied; write its memory "
            "with 'save' and 'load' it into another Tracker"
        )

    @contextlib.contextmanager
    def _alone(self, part: str) -> Iterator[None]:
        """Refuses a second thread in one half of `update`; the halves may overlap."""
        lock = self._locks[part]
        if not lock.acquire(blocking=False):
            raise RemindError(
                "this Tracker is used by two threads at once; give each its own, or a lock around "
                "every call"
            )
        try:
            yield
        finally:
            lock.release()

    def follow_profile(self) -> None:
        """Takes the thresholds made for the backbone, now that it is known to be used."""
        if not self._has_profile:
            self.config = self.config.for_backbone(*self.backbone.identity)
            self._has_profile = True

    def _records(self) -> ObjectRecords:
        """The records of objects in memory; those of others go, so that their names are free."""
        if self.state is not None:
            self.identities.records.keep(self._saved().object_ids())
        return self.identities.records

    def _saved(self) -> memory_file.SavedMemory:
        """The memory as it is now. Raises SourceError if there is nothing to remember yet."""
        if self.state is None:
            raise SourceError("there is no memory before the first frame; 'load' a file for one")
        if self._memory.at_rest is not None:
            self._memory.at_rest.drop_present(self.state)
        return memory_file.SavedMemory(
            state=self.state,
            static=self.static,
            class_names=tuple(self.preparer.class_ids),
            backbone=FEATURES_GIVEN if self._features_given else self.features.described_by,
            tracker=self.method.name,
            announced=self.identities.announcements,
            records=self.identities.records,
            at_rest=self._memory.at_rest,
            fingerprint="" if self._features_given else self.backbone.fingerprint,
        )
