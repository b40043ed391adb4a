"""The memory on the device, which grows with what it meets: a step is repeated until all fits."""

from __future__ import annotations

import contextlib
import ctypes
import dataclasses
import gc
import logging
import os
from pathlib import Path
from typing import Any

import jax

from remind_jax.compiled.frame_step import FrameInput, FrameStep, Readout, pack_thresholds
from remind_jax.compiled.packing import Bundle, Packed
from remind_jax.decision import Decisions
from remind_jax.errors import ConfigError, SourceError
from remind_jax.masks.reduction import pad_feats, pad_masks
from remind_jax.method import Method
from remind_jax.observation import AnyFeats
from remind_jax.printing.words import listing
from remind_jax.session.ahead import PRESSED, Ahead
from remind_jax.session.answers import Outlines, outline
from remind_jax.session.preparation import Prepared
from remind_jax.static import GROWTH_STEP, MOST_DETECTIONS, Static

_CAPACITIES = {
    "detections": "num_detections",
    "objects": "num_objects",
    "undecided tracks": "num_pending",
}

SETTLED_FRAMES = 100  # after which a loop that must not wait has twice of everything prepared
MAX_IDLE_BYTES = 1 << 28  # of memory and step, that may lie ready for a growth nobody foresees

# Frames after which freed memory goes back: what a compiler freed lies scattered, and a loop would
# touch more and more of its pages.
_RETURN_EVERY = 1000

_log = logging.getLogger("remind_jax")


BUDGET_SHARE = 0.75  # of the memory of the device; the rest is for frames, masks and the network
GIB = 2**30
MAX_FRAME_BYTES = 1 << 29  # what follows from one frame may take so much of it; see `check_room`
MAX_UNCOUNTED = 2048  # detections in a frame, of methods that do not count their bytes
_GROUP_LIMIT = Path("/sys/fs/cgroup/memory.max")  # of a container, where there is one


class GrowingMemory:
    """The memory of a method and its compiled step; results do not depend on capacities.

    The next larger capacities are prepared in a thread of their own before they are needed: their
    program is compiled, and the memory to move into is made.

    Attributes:
      static: Capacities as grown so far.
      traced: Whether it keeps what decisions were made of.
      trace: What the decisions of the last frame were made of, on the host.
      has_grown: Whether it did so in the last frame.
      keeps_reserve: Whether twice of all capacities is prepared as well, once it has been in use
        for a while: for loops that must not wait when a frame suddenly shows much more.
    """

    def __init__(self, method: Method, static: Static, *, traced: bool) -> None:
        self._state: Any = None  # as it was read or set last; None where it has to be read
        self._bundle: Bundle | None = None  # as the last step left it
        self.static = static
        self.trace: Any = None
        self.has_grown = self.keeps_reserve = False
        self.traced = traced
        self.frame_step = FrameStep(method, traced=traced)
        self.ahead = Ahead(method)
        self._method = method
        self._num_steps = 0
        self._placed: tuple[Any, Packed | None] = (None, None)  # thresholds on the device

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

    def prepare_programs(
        self,
        frame_feats: AnyFeats,
        prepared: Prepared,
        thresholds: Any,
        num_objects: int,
    ) -> None:
        """Compiles or loads what such frames need, for up to `num_objects` objects at least.

        With a number of objects, that is all that a loop will need: every capacity on the way, and
        for what comes suddenly twice of the detections and undecided tracks, with room for as many
        more objects. Nothing is compiled then before it is sure that something else is needed.

        Raises:
          SourceError: If so many do not fit this machine.
        """
        static = self._with_feature_dim(frame_feats.patches.shape[-1])
        ready = [static]
        while ready[-1].num_objects < num_objects:
            ready.append(ready[-1].grow(num_objects=ready[-1].num_objects + 1))
        for static in ready:
            self._prepare(frame_feats, prepared, thresholds, static)
        if num_objects:
            with contextlib.suppress(ConfigError, SourceError):  # nothing larger, or no room for it
                reserve = static.grow(
                    num_detections=static.num_detections + 1, num_pending=static.num_pending + 1
                )
                reserve = reserve.grow(num_objects=num_objects + reserve.num_detections)
                self._prepare(frame_feats, prepared, thresholds, reserve)
                ready.append(reserve)
            self.ahead.at_hand += [one for one in ready if one not in self.ahead.at_hand]
            self._make_spare(ready[0])
            self.ahead.finish()
        # What tracing left behind takes a tenth of a second to go through: better now than within
        # a frame.
        gc.collect()

    def step(
        self, frame_feats: AnyFeats, prepared: Prepared, thresholds: Any
    ) -> tuple[Decisions, Outlines]:
        """Steps, growing capacities until the frame fits; outlines the masks meanwhile.

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
            # Each may be open in one frame, and be an object beside a new one in the next.
            needed["num_objects"] = 2 * num
        before = self.static
        self.make_room(**needed)
        if self.state is None:
            self.state = self._method.init(self.static)
        outlines: Outlines | None = None
        while True:
            self._bundle, self._state = self._bundle or Bundle.of(self._state), None
            frame_input = self._input(frame_feats, prepared, thresholds, self.static)
            # Kept at once: the step takes over the memory of the old state, and Ctrl-C may come
            # while its result is waited for.
            self._bundle, packed, trace = self.frame_step(self._bundle, frame_input, self.static)
            outlines = outlines or outline(prepared.detections.masks)
            readout: Readout = jax.device_get(packed).unpack()
            if not readout.overflow.objects and not readout.overflow.pending:
                break
            self.make_room(
                num_objects=int(readout.overflow.objects), num_pending=int(readout.overflow.pending)
            )
        self._num_steps += 1
        if self._num_steps % _RETURN_EVERY == 0:
            _return_freed_memory()
        self.has_grown = self.static != before
        self.trace = jax.device_get(trace)
        self._look_ahead(frame_feats, prepared, thresholds, readout.occupied)
        return readout.decisions, outlines

    def make_room(self, **needed: int) -> None:
        """Moves the memory into larger capacities; the programs are often ready by then."""
        larger = self.static.grow(**needed)
        if larger == self.static:
            return
        check_room(self._method, larger)
        before, self.static = self.static, self.ahead.room_for(larger)
        if self.state is not None:
            empty = self.ahead.take_spare(self.static)
            self.state = self._method.enlarge(self.state, self.static, empty)
        grown = [
            f"{getattr(self.static, name)} {what}"
            for what, name in _CAPACITIES.items()
            if getattr(self.static, name) != getattr(before, name)
        ]
        _log.debug("there is room for %s now", listing(grown))

    def _with_feature_dim(self, dim: int) -> Static:
        """The capacities with the width of the features, which the first frame brings."""
        if self.static.feature_dim not in (0, dim):
            raise SourceError(
                f"the frame has features of {dim} numbers, the memory knows "
                f"{self.static.feature_dim}; go on with the features that it was made with"
            )
        if self.static.feature_dim == dim:  # as in all frames but the first
            return self.static
        return dataclasses.replace(self.static, feature_dim=dim)

    def _prepare(
        self,
        frame_feats: AnyFeats,
        prepared: Prepared,
        thresholds: Any,
        static: Static,
    ) -> None:
        check_room(self._method, static)
        frame_input = self._input(frame_feats, prepared, thresholds, static)
        self.frame_step.prepare(frame_input, static)

    def _input(
        self,
        frame_feats: AnyFeats,
        prepared: Prepared,
        thresholds: Any,
        static: Static,
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
        frame_feats: AnyFeats,
        prepared: Prepared,
        thresholds: Any,
        occupied: tuple[Any, Any],
    ) -> None:
        """Has twice prepared of each capacity that is nearly full, or for a live loop of all."""
        num_objects, num_pending = (int(count) for count in occupied)
        counts = {
            "num_detections": len(prepared.masks.valid),
            "num_objects": num_objects,
            "num_pending": num_pending,
        }
        grown = [n for n, num in counts.items() if num >= PRESSED[n] * getattr(self.static, n)]
        if not grown and self.keeps_reserve and self._num_steps >= SETTLED_FRAMES:
            grown = list(counts)
        try:
            wanted = self.static.grow(**{name: getattr(self.static, name) + 1 for name in grown})
        except ConfigError:
            return  # there is nothing larger; the frame that needs it will tell
        if grown and not self.ahead.is_near(wanted):
            # The size of this frame is that of the next ones.
            self.ahead.start(
                wanted,
                lambda: self._prepare(frame_feats, prepared, thresholds, wanted),
                with_spare=counts["num_objects"] >= PRESSED["num_objects"] * self.static.num_objects
                or self._is_small(wanted),
            )
        else:
            self._make_spare(self.static)

    def _make_spare(self, present: Static) -> None:
        """Has the memory made that the next growth moves into, if it is small."""
        following = self.ahead.following(present)
        if following is not None and self._is_small(following):
            self.ahead.start(following, None, with_spare=True)

    def _is_small(self, static: Static) -> bool:
        count = self._method.host.count_bytes
        return count is None or count(static) <= MAX_IDLE_BYTES


def check_room(method: Method, static: Static) -> None:
    """Makes sure that memory and step of a method fit into three quarters of the device's memory.

    Raises:
      SourceError: If they do not.
    """
    if method.host.count_bytes is None:
        return
    needed, total = method.host.count_bytes(static), device_bytes()
    if total and needed > BUDGET_SHARE * total:
        raise SourceError(
            f"room for {static.num_detections} detections in a frame and {static.num_objects} "
            f"objects takes about {needed / GIB:.1f} GiB, and {BUDGET_SHARE * total / GIB:.1f} GiB "
            "of this machine's memory may be used; keep fewer detections (best ones or "
            "wanted classes only), or start with an empty memory"
        )


def most_detections(method: Method, static: Static, feature_dim: int) -> int:
    """How many detections a frame may have, so that no single frame takes much memory.

    Args:
      method: The tracker.
      static: Capacities that were chosen; what there is room for is allowed.
      feature_dim: Width of the features, where `static` does not say it yet.
    """
    if method.host.count_bytes is None:
        return max(static.num_detections, MAX_UNCOUNTED)
    empty = dataclasses.replace(
        static, num_objects=1, num_pending=1, feature_dim=static.feature_dim or feature_dim
    )
    most = static.num_detections
    while most * GROWTH_STEP <= MOST_DETECTIONS:
        # Each may be open in one frame, and be an object beside a new one in the next.
        needed = most * GROWTH_STEP
        room = empty.grow(num_detections=needed, num_objects=2 * needed, num_pending=needed)
        if method.host.count_bytes(room) > MAX_FRAME_BYTES:
            break
        most = needed
    return most


def device_bytes() -> int:
    """Memory of the device that steps run on, 0 where that is not known."""
    stats = jax.local_devices()[0].memory_stats()
    if stats and stats.get("bytes_limit"):
        return int(stats["bytes_limit"])
    if jax.default_backend() != "cpu" or not hasattr(os, "sysconf"):
        return 0
    total = os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    try:
        return min(total, int(_GROUP_LIMIT.read_text(encoding="ascii")))
    except (OSError, ValueError):  # no such group, or "max"
        return total


def _return_freed_memory() -> None:
    """Gives what was freed back to the system, where its C library can: that of GNU."""
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).malloc_trim(0)
