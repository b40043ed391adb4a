"""The memory on the device, which grows with what it meets: a step is repeated until all fits."""

from __future__ import annotations

import collections
import contextlib
import dataclasses
import functools
import gc
import logging
import math
from collections.abc import Callable
from typing import Any

import jax
import numpy as np

from remind_jax.compiled.frame_step import FrameInput, FrameStep, Readout, pack_thresholds
from remind_jax.compiled.packing import Bundle, Packed
from remind_jax.compiled.programs import is_of_this_package
from remind_jax.decision import Decisions
from remind_jax.errors import ConfigError, SourceError
from remind_jax.masks.reduction import pad_feats, pad_masks
from remind_jax.method import AtRest, Method
from remind_jax.numerics.absent import NO_ID
from remind_jax.observation import AnyFeats
from remind_jax.outputs.run_records import MemoryUse
from remind_jax.printing.words import listing
from remind_jax.session.ahead import Ahead
from remind_jax.session.answers import Outlines, outline
from remind_jax.session.machine_memory import check_room, return_freed_memory
from remind_jax.session.memory_faults import check_first
from remind_jax.session.preparation import Prepared
from remind_jax.static import OBJECTS_PER_DETECTION, Static

_CAPACITIES = {
    "detections": "num_detections",
    "objects": "num_objects",
    "undecided tracks": "num_pending",
}

# Share of a capacity from which on twice of it is prepared: objects stay, the rest comes and goes.
PRESSED = {"num_detections": 3 / 4, "num_objects": 1 / 2, "num_pending": 3 / 4}

# Room that so many frames in a row had no use for goes; after the first of them the program of what
# is left is made.
UNUSED_FRAMES, UNUSED_AT_FIRST = 50, 10

# Frames after which freed memory goes back: what a compiler freed lies scattered, and a loop would
# touch more and more of its pages.
_RETURN_EVERY = 1000

_log = logging.getLogger("remind_jax")


class GrowingMemory:
    """The memory of a method and its compiled step; results do not depend on capacities.

    Capacities double when they overflow, and the program of the next larger ones is compiled in a
    thread of its own before it is needed. Where a method has a place for objects at rest, these
    make room instead, and the program stays the same however many are known; once a crowd of
    detections is over, its room goes.

    Attributes:
      static: Capacities as grown so far.
      trace: What the decisions of the last frame were made of, on the host.
      has_grown: Whether it did so in the last frame.
      at_rest: Objects at rest; None where the method has no place for them.
    """

    def __init__(self, method: Method, static: Static, *, traced: bool, max_objects: int) -> None:
        """Remembers nothing yet.

        Args:
          max_objects: As `input.max_objects`.

        Raises:
          ConfigError: If there is such a limit, and the method forgets no objects.
        """
        if max_objects and method.host.at_rest is None:
            raise ConfigError(
                f"input.max_objects is {max_objects}, but tracker '{method.name}' forgets no "
                "objects; leave it at 0"
            )
        self._max_objects, self._feature_dim = max_objects, static.feature_dim
        self._state: Any = None  # as it was read or set last; None where it has to be read
        self._bundle: Bundle | None = None  # as the last step left it
        self.trace: Any = None
        self.has_grown = False
        self.frame_step = FrameStep(method, traced=traced)
        self.ahead = Ahead()
        self._method = method
        self._num_steps = 0
        self._placed: tuple[Any, Packed | None] = (None, None)  # thresholds on the device
        self._lately = collections.deque[int](maxlen=UNUSED_FRAMES)  # detections of the last frames
        self._most_expected = 0  # detections of a frame that room was made for
        self.at_rest: AtRest | None = self._new_rest()
        self.static = self._reserved = self._grown(static)

    @property
    def state(self) -> Any:
        """A pytree of arrays, of which small ones lie on the host; None before the first frame."""
        if self._state is None and self._bundle is not None:
            self._state = self._bundle.read()
        return self._state

    @state.setter
    def state(self, state: Any) -> None:
        self._state, self._bundle = state, None

    def forget(self) -> None:
        """Empties it; compiled programs stay."""
        self.state = self.trace = None
        self._lately.clear()
        self.static = dataclasses.replace(self._reserved, feature_dim=self._feature_dim)
        self.at_rest = self._new_rest()

    def prepare_programs(
        self, frame_feats: AnyFeats, prepared: Prepared, thresholds: Any, num_objects: int
    ) -> None:
        """Compiles or loads what such frames need, for up to `num_objects` objects at least.

        Raises:
          SourceError: If so many do not fit this machine.
        """
        static = self._with_feature_dim(frame_feats.patches.shape[-1])
        ready = [static]
        while self.at_rest is None and ready[-1].num_objects < num_objects:
            ready.append(ready[-1].grow(num_objects=ready[-1].num_objects + 1))
        make_input = functools.partial(self._input, frame_feats, prepared, thresholds)
        for static in ready:
            self._prepare(make_input, static)
        # What tracing left behind takes a tenth of a second to go through: better now than within
        # a frame.
        gc.collect()

    def step(
        self, frame_feats: AnyFeats, prepared: Prepared, thresholds: Any
    ) -> tuple[Decisions, Outlines]:
        """Steps, making room until the frame fits; outlines the masks meanwhile.

        Raises:
          SourceError: If the features are not as wide as those of earlier frames, or the frame
            needs capacities that do not fit this machine.
        """
        static = self._with_feature_dim(frame_feats.patches.shape[-1])
        num = len(prepared.masks.valid)
        needed = {"num_detections": num}
        if self.state is None:
            check_room(self._method, static)
            self.static = static
            needed["num_objects"] = OBJECTS_PER_DETECTION * num
        before = self.static
        self.grow(**needed)
        if self.state is None:
            first = self._method.init(self.static)
            if not is_of_this_package(self._method.init):
                check_first(first, self._method)
            self.state = first
        make_input = functools.partial(self._input, frame_feats, prepared, thresholds)
        outlines: Outlines | None = None
        while True:
            described = self.frame_step.describe(make_input(self.static), self.static)
            if self.at_rest is not None and outlines is None and self.at_rest.ids():
                self.at_rest.drop_present(self.state)
                recalled = self.at_rest.recall(self.state, described.seen, self.static)
                if recalled is not None:
                    self.state = recalled
                    self.at_rest.drop_present(recalled)
            self._bundle, self._state = self._bundle or Bundle.of(self._state), None
            # Kept at once: the step may take over the memory of the old state, and Ctrl-C may come
            # while its result is waited for.
            before_frame = self._bundle
            self._bundle, packed, trace = self.frame_step.decide(self._bundle, described)
            outlines = outlines or outline(prepared.detections.masks)
            try:
                readout: Readout = jax.device_get(packed).unpack()
            except jax.errors.JaxRuntimeError:
                self._bundle = before_frame
                raise
            if not readout.overflow.objects and not readout.overflow.pending:
                break
            lacks = readout.overflow
            self._make_room(described.seen, int(lacks.objects), int(lacks.pending))
        self._num_steps += 1
        if self._num_steps % _RETURN_EVERY == 0:
            return_freed_memory()
        self.has_grown = self.static != before
        self.trace = jax.device_get(trace)
        self._look_ahead(make_input, num, readout.occupied)
        self._shrink(make_input, num)
        return readout.decisions, outlines

    def forget_excess(self) -> list[int]:
        """Lets objects out of view go where more are known than are to be remembered; their ids."""
        if not self._max_objects or self.at_rest is None:
            return []
        present, resting = self._count()
        excess = present + resting - self._max_objects
        if excess <= 0:
            return []
        if excess > resting:
            self.state = self.at_rest.rest(self.state, self.static, excess - resting)
        return self.at_rest.forget_least_known(excess)

    def use(self) -> MemoryUse:
        """How many objects there are, where they lie, and what that takes."""
        if self.state is None:
            return MemoryUse(0, 0, 0, 0)
        present, resting = self._count()
        num_bytes = sum(leaf.nbytes for leaf in jax.tree.leaves(self.state))
        num_bytes += 0 if self.at_rest is None else self.at_rest.num_bytes()
        return MemoryUse(present + resting, present, resting, num_bytes)

    def _count(self) -> tuple[int, int]:
        """Objects in slots of the step, and at rest."""
        present = int(np.sum(np.asarray(self.state.objects.id) != NO_ID))
        return present, 0 if self.at_rest is None else len(self.at_rest.ids())

    def _new_rest(self) -> AtRest | None:
        make = self._method.host.at_rest
        return None if make is None else make()

    def _make_room(self, seen: Any, num_objects: int, num_pending: int) -> None:
        """After a frame that did not fit: rests objects, or moves into larger capacities."""
        if self.at_rest is not None and num_objects:
            rested = self.at_rest.make_room(self.state, seen, self.static, num_objects)
            if rested is not None:
                self.state = rested
                return
        self.grow(num_objects=num_objects, num_pending=num_pending)

    def reserve(self, num_detections: int = 0) -> None:
        """Makes room for so many detections, or for those of before, and keeps it."""
        self._most_expected = max(self._most_expected, num_detections)
        self.grow(num_detections=self._most_expected)
        self._reserved = self._grown(self._reserved.grow(num_detections=self._most_expected))

    def grow(self, **needed: int) -> None:
        """Moves the memory into larger capacities; their program is often ready by then."""
        larger = self._grown(self.static.grow(**needed))
        if larger == self.static:
            return
        check_room(self._method, larger)
        before, self.static = self.static, self.ahead.room_for(larger)
        if self.state is not None:
            self.state = self._method.enlarge(self.state, self.static)
        grown = [
            f"{getattr(self.static, name)} {what}"
            for what, name in _CAPACITIES.items()
            if getattr(self.static, name) != getattr(before, name)
        ]
        _log.debug("there is room for %s now", listing(grown))

    def _grown(self, static: Static) -> Static:
        """The capacities with a working set that suits the detections, where there is one."""
        if self.at_rest is None:
            return static
        return static.grow(num_objects=OBJECTS_PER_DETECTION * static.num_detections)

    def _with_feature_dim(self, dim: int) -> Static:
        """The capacities with the width of the features, which the first frame brings."""
        if self.static.feature_dim not in (0, dim):
            raise SourceError(
                f"the frame has features of {dim} numbers, the memory knows "
                f"{self.static.feature_dim} (static.feature_dim of a new one, 0 for any); go on "
                "with the features that it was made with"
            )
        if self.static.feature_dim == dim:  # as in all frames but the first
            return self.static
        return dataclasses.replace(self.static, feature_dim=dim)

    def _prepare(self, make_input: Callable[[Static], FrameInput], static: Static) -> None:
        check_room(self._method, static)
        self.frame_step.prepare(make_input(static), static)

    def _input(
        self, frame_feats: AnyFeats, prepared: Prepared, thresholds: Any, static: Static
    ) -> FrameInput:
        masks = pad_masks(prepared.masks, static.num_detections)
        given = Packed.of((masks, prepared.observed))
        frame_feats = pad_feats(frame_feats, static.num_detections)
        return FrameInput(frame_feats, given, self._place(thresholds))

    def _place(self, thresholds: Any) -> Packed:
        """The thresholds, brought to the device once: hundreds of numbers."""
        known, placed = self._placed
        if known is not thresholds or placed is None:
            placed = jax.device_put(pack_thresholds(thresholds, self.static.scalar))
            self._placed = (thresholds, placed)
        return placed

    def _look_ahead(
        self,
        make_input: Callable[[Static], FrameInput],
        num_detections: int,
        occupied: tuple[Any, Any],
    ) -> None:
        """Has twice prepared of each capacity that is nearly full, and not by what is expected."""
        num_objects, num_pending = (int(count) for count in occupied)
        counts = {"num_pending": num_pending}
        if num_detections > self._most_expected:
            counts["num_detections"] = num_detections
        if self.at_rest is None:
            counts["num_objects"] = num_objects
        pressed = [n for n, num in counts.items() if num >= PRESSED[n] * getattr(self.static, n)]
        if not pressed:
            return
        with contextlib.suppress(ConfigError):  # nothing larger; the frame that needs it will tell
            wanted = self.static.grow(**{n: getattr(self.static, n) + 1 for n in pressed})
            wanted = self._grown(wanted)
            # The size of this frame is that of the next ones.
            self.ahead.start(wanted, lambda: self._prepare(make_input, wanted))

    def _shrink(self, make_input: Callable[[Static], FrameInput], num_detections: int) -> None:
        """Goes back to smaller capacities once frames had no use for more for a while."""
        self._lately.append(num_detections)
        if self.at_rest is None or self.static.num_detections <= self._reserved.num_detections:
            return
        lately = list(self._lately)
        soon = self._smaller(max(lately[-UNUSED_AT_FIRST:]))
        if len(lately) >= UNUSED_AT_FIRST and soon != self.static:
            self.ahead.start(soon, lambda: self._prepare(make_input, soon))
        smaller = self._smaller(max(lately))
        if len(lately) < UNUSED_FRAMES or smaller == self.static:
            return
        shrunk = self.at_rest.shrink(self.state, self.static, smaller)
        if shrunk is not None:
            self.state, self.static = shrunk, smaller

    def _smaller(self, num_detections: int) -> Static:
        """The least capacities that so many detections do not press; these if none are less."""
        needed = math.ceil(num_detections / PRESSED["num_detections"])
        if needed > self.static.num_detections:
            return self.static
        kept = {name: getattr(self._reserved, name) for name in _CAPACITIES.values()}
        least = dataclasses.replace(self.static, **kept).grow(num_detections=needed)
        is_less = least.num_detections < self.static.num_detections
        return self._grown(least) if is_less else self.static
