"""Trackers by name: what turns features and masks into identities, found without importing any.

A method is three pure functions: `init` makes an empty memory, `describe` says what a frame looks
like, `decide` takes the memory to the next frame. Runs, live trackers and sweeps call these and
nothing else, so that a function put around one of them counts everywhere.
"""

from __future__ import annotations

import dataclasses
import functools
import importlib
import operator
import reprlib
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, Protocol

import jax
import numpy as np

from remind_jax.errors import ConfigError, nearest_names
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import AnyFeats, Masks
from remind_jax.settings.method_names import PAPER_METHOD, find_methods
from remind_jax.static import NoSwitches, Static


@dataclasses.dataclass(frozen=True, eq=False)
class Needs:
    """What a method reads of images and masks."""

    # On the host, ahead of the step: `observe(previous_image, image, elapsed_s) -> observed` from
    # two consecutive frames, uint8 RGB [H, W, 3] in the pixels that boxes are given in, and the
    # seconds between them: a pytree of arrays whose shapes never change. The previous one is None
    # in the first frame, both are None where frames come as features; the seconds are None where
    # they are not known. Left out, `observed` is None.
    observe: Callable[[Any, Any, float | None], Any] | None = None
    # On the host, one for each stream: follows the light on its images by what was observed, and
    # gives these in a light that stays, in which they are described.
    steady_light: Callable[[], SteadyLight] | None = None
    # Heads of the backbone whose attention between the patches of a frame it reads, averaged:
    # `attention_heads(static)`; () are all, None is no attention, as where it is left out.
    attention_heads: Callable[[Static], tuple[int, ...] | None] | None = None
    # How gaps between masks are measured, as options of `masks.reduction.reduce_masks`:
    # `gap_options(thresholds)`; left out, no gap is.
    gap_options: Callable[[Any], dict[str, float]] | None = None
    # How many patches beyond those that a mask covers it reads features, diagonally as well; those
    # of others may be zero. Left out, it reads all.
    patch_reach: int | None = None
    # Whether it also takes `observation.CloseupFeats`, of detections each in a picture of its own,
    # instead of features of the frame; and whether it does so of itself where they cost little.
    reads_closeups: bool = False
    prefers_closeups: bool = False


class SteadyLight(Protocol):
    """The light on the images of one stream, uint8 RGB `[H, W, 3]`."""

    def follow(self, image: Any, observed: Any, /) -> None:
        """Takes the next image, None where frames come as features."""
        ...

    def steady(self, image: Any, /) -> Any:
        """The image that was followed last, in the light that stays."""
        ...


class AtRest(Protocol):
    """Objects of a method that rest on the host, while its memory has slots for others."""

    def make_room(self, state: Any, seen: Any, static: Static, needed: int) -> Any:
        """The memory with so many slots that the frame fits; None if that cannot be."""
        ...

    def rest(self, state: Any, static: Static, num: int) -> Any:
        """The memory without so many objects at most that are longest out of view: they rest."""
        ...

    def shrink(self, state: Any, static: Static, smaller: Static) -> Any:
        """The memory in smaller capacities, where objects rest for it; None if that cannot be.

        The last frames had no more detections than they hold.
        """
        ...

    def recall(self, state: Any, seen: Any, static: Static) -> Any:
        """The memory with what the next frame may show; None if nothing comes."""
        ...

    def drop_present(self, state: Any) -> None:
        """Lets go of what is in the memory now; the calls above let nothing go.

        So nothing is lost where one of them is stopped before its answer is kept, as by Ctrl-C.
        """
        ...

    def ids(self) -> list[int]:
        """Ids of all objects at rest."""
        ...

    def num_bytes(self) -> int:
        """What they take, in bytes."""
        ...

    def forget(self, ids: Iterable[int]) -> None:
        """Lets objects go with all that is kept of them."""
        ...

    def forget_least_known(self, num: int) -> list[int]:
        """Lets so many objects at rest go; gives their ids."""
        ...

    def snapshot(self) -> Any:
        """What there is now, for `tensors`."""
        ...

    def tensors(self, since: Any = None) -> dict[str, np.ndarray]:
        """What changed since a snapshot as arrays by name, for a file; all of it without one."""
        ...

    def restore(
        self, parts: Sequence[Mapping[str, np.ndarray]], state: Any, num_classes: int
    ) -> None:
        """Goes on from what `tensors` gave, all and then changes, beside this memory.

        Raises ValueError or KeyError if it cannot.
        """
        ...


@dataclasses.dataclass(frozen=True)
class Joining:
    """One of two memories that become one."""

    state: Any
    at_rest: Any  # as the method makes it
    merged_into: Mapping[int, int]  # its objects that were declared to be another one, and which


@dataclasses.dataclass(frozen=True)
class Joined:
    """What became of the objects of another memory."""

    ids: Mapping[int, int]  # of each object that came: its id here
    matched: tuple[tuple[int, int], ...]  # objects here, and the ids here of those that they are
    # Ids here of objects that may be known as well, and the objects that they may be, best first.
    ambiguous: Mapping[int, tuple[int, ...]]


def no_evidence(state: Any) -> Mapping[str, Any]:
    """What answers that are never revised need."""
    return {}


@dataclasses.dataclass(frozen=True, eq=False)
class Host:
    """What the shell asks of a method beside its steps, on the host; whatever may be left out."""

    # `grow(state, empty)` moves a memory into the arrays of a larger, empty one; left out, each
    # goes to the start of its larger one.
    grow: Callable[[Any, Any], Any] | None = None
    # Slots that are in use, `occupied(state) -> (objects, pending)`, by which a run foresees that
    # more will be needed (also called under `jit`); left out, objects are counted.
    occupied: Callable[[Any], tuple[Any, Any]] | None = None
    # "module:class" of the `explanation.explainer.Explainer` of its traces, imported when needed.
    explainer_name: str | None = None
    # What turned out to be another object: `merges(state)` gives pairs of ids, the one that is gone
    # and the one that it is; those of earlier frames, or never answered, may be among them.
    merges: Callable[[Any], list[tuple[int, int]]] | None = None
    # `delayed(delay)` makes what revises answers that wait: an object with
    # `push(frame, tracks, evidence) -> [(frame, tracks), ...]`, and `flush()`, which gives the
    # rest. Of `tracks` it reads and replaces ids, candidates, outcome, reason, status, score and
    # confidence, and nothing else.
    delayed: Callable[[int], Any] | None = None
    # What that needs of a memory after a frame, `evidence(state) -> {name: [N]}`, whole numbers by
    # detection slot (also called under `jit`).
    evidence: Callable[[Any], Mapping[str, Any]] = no_evidence
    # `remove(state, empty, ids)` takes objects out of memory, with all that only they left behind;
    # `empty` is the memory without any. Left out, it cannot.
    remove: Callable[[Any, Any, np.ndarray], Any] | None = None
    # Ids that were answered for what is no object in memory yet, `coming_ids(state)`.
    coming_ids: Callable[[Any], Iterable[int]] | None = None
    # Phrases about what is wrong with a memory that was read from a file, `find_faults(state)`,
    # beyond what holds for every method (`session.memory_file`).
    find_faults: Callable[[Any], Iterable[str]] | None = None
    # Arrays of memory files of earlier schemas, by name: the axis along which each holds several
    # leaves side by side, and their names (`session.earlier_memory`).
    columns: Mapping[str, tuple[int, tuple[str, ...]]] = dataclasses.field(default_factory=dict)
    # Leaves that these files do not have: what each is by the others of a file; None: as in an
    # empty memory.
    new_leaves: Mapping[str, Callable[[Mapping[str, np.ndarray]], np.ndarray] | None] = (
        dataclasses.field(default_factory=dict)
    )
    # Leaves that only files of earlier versions have, of this schema as well.
    gone_leaves: Sequence[str] = ()
    # Leaves of which files of earlier versions, of this schema as well, may have fewer places along
    # the second axis; what lacks is zero.
    lengthened: Sequence[str] = ()
    # `at_rest()` makes what keeps on the host, empty at first, objects that a step has no room for:
    # Left out, capacities for objects double.
    at_rest: Callable[[], AtRest] | None = None
    # `join(this, that, class_ids, thresholds) -> (state, Joined)` of two `Joining` adds the objects
    # of that, of which `class_ids` says what its classes are here, to those at rest here, and says
    # which of them are known. Left out, it cannot.
    join: Callable[..., tuple[Any, Joined]] | None = None
    # Bytes that memory and step take, `count_bytes(static)`, estimated before anything is made;
    # capacities that take too much are refused. Left out, all are tried.
    count_bytes: Callable[[Static], int] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Sweeping:
    """What settings of a sweep may share.

    Names of settings are dotted, below `thresholds`; a section stands for all that it holds.
    """

    # Settings that `describe` reads; those that agree on them share what it returns. None: any.
    described_by: tuple[str, ...] | None = None
    # Settings that the reduction of masks reads; the largest value of all serves all.
    reduced_by: tuple[str, ...] = ()
    # On a CPU settings go one after the other, which rounds as the step alone does; side by side,
    # sums have another order. For a method that is no slower for it.
    in_turn_on_cpu: bool = False


@pytree
class Seen:
    """A frame as it comes: what `decide` is given by a method that describes nothing first."""

    frame_feats: AnyFeats
    masks: Masks
    observed: Any


def see(
    frame_feats: AnyFeats, masks: Masks, observed: Any, *, static: Static, thresholds: Any
) -> Seen:
    """Hands a frame over."""
    return Seen(frame_feats, masks, observed)


@dataclasses.dataclass(frozen=True, eq=False)
class Method:
    """A tracker as pure functions: `jit` (with `static` static), `vmap` and `scan` apply.

    The memory is a pytree of arrays in which a run reads `objects.id` `[O]` (-1 in free slots),
    `next_id` (no object had that id or a higher one), `frame` (frames processed so far, the number
    of the next one), `decisions` (`decision.Decisions` about the last frame) and `overflow`
    (`objects`, `pending`: slots that the frame needs, 0 if they sufficed; a frame that overflows
    changes nothing else).
    """

    name: str
    settings: Callable[[], Any]  # published values of its numbers: a dataclass that is a pytree
    init: Callable[[Static], Any]  # an empty memory of these capacities
    # `decide(state, seen, *, static, thresholds) -> (state, trace)`: who is who, and what is
    # remembered of it. The trace is a pytree of arrays, what decisions were made of, or None;
    # where nobody reads it, the compiler leaves it out. Nothing may overflow for `seen` of zeros
    # only, which fills up the end of a scene.
    decide: Callable[..., tuple[Any, Any]]
    # `describe(frame_feats, masks, observed, *, static, thresholds) -> seen`, a pytree of arrays:
    # what a frame looks like, whatever is remembered. `static` counts no objects there.
    describe: Callable[..., Any] = see
    needs: Needs = Needs()
    host: Host = Host()
    sweeping: Sweeping = Sweeping()
    # Its structural switches as published, a hashable dataclass of settings: `static.switches`.
    switches: Callable[[], Any] = NoSwitches
    title: str = ""  # as tables call it; by its name if left out

    def step(
        self,
        state: Any,
        frame_feats: AnyFeats,
        masks: Masks,
        observed: Any = None,
        *,
        static: Static,
        thresholds: Any = None,
    ) -> Any:
        """The memory after a frame, with `decisions` about it; whoever runs a method does this.

        Args:
          state: Memory before the frame, from `init` or an earlier step.
          frame_feats: Patch features of the frame, or of closeups of its detections.
          masks: Its detections.
          observed: What `needs.observe` gave for it; as of a frame without an image if left out.
          static: Capacities; those that `state` was made with.
          thresholds: Its numbers; the published ones if left out.

        Returns:
          If the frame needs more slots than there are, only `overflow` is changed.

        Raises:
          ConfigError: If memory or frame were not made for these capacities.
        """
        self._check_capacities(state, frame_feats, masks, static)
        if observed is None and self.needs.observe is not None:
            observed = self.needs.observe(None, None, None)
        thresholds = self.settings() if thresholds is None else thresholds
        options = {"static": static, "thresholds": thresholds}
        seen = self.describe(frame_feats, masks, observed, **options)
        return self.as_before(self.decide(state, seen, **options), state)[0]

    def as_before(self, decided: Any, before: Any) -> tuple[Any, Any]:
        """What `decide` returned, the memory in the types that it came in, to be scanned.

        Raises:
          ConfigError: If it is no pair, or the memory has other leaves, or one of another shape.
        """
        if not isinstance(decided, tuple) or len(decided) != 2:
            raise ConfigError(
                f"'decide' of tracker '{self.name}' returns {type(decided).__name__}; return a "
                "pair: the memory after the frame, and a trace or None"
            )
        after, trace = decided
        found = _difference(after, before)
        if found is not None:
            raise ConfigError(
                f"'decide' of tracker '{self.name}' returns a memory of another structure or "
                f"shapes than it was given: {found}; return that, changed, and a trace or None"
            )
        after = jax.tree.map(
            lambda new, old: jax.lax.convert_element_type(new, old.dtype), after, before
        )
        return after, trace

    def _check_capacities(
        self, state: Any, frame_feats: AnyFeats, masks: Masks, static: Static
    ) -> None:
        """Raises ConfigError where arrays that do not fit would fail within, or be cut silently."""
        width, slots = frame_feats.patches.shape[-1], len(masks.valid)
        made_for = _shapes_of_empty(self.init, static)
        # A memory that keeps no features fits them all.
        fitting = dataclasses.replace(static, feature_dim=width)
        if _difference(made_for, _shapes_of_empty(self.init, fitting)) is not None:
            raise ConfigError(
                f"the frame has features of {width} numbers, static.feature_dim is "
                f"{static.feature_dim}; make `static`, and the memory, for such features"
            )
        if slots != static.num_detections:
            raise ConfigError(
                f"the frame has {slots} detection slots, static.num_detections is "
                f"{static.num_detections}; make `static`, and the memory, for as many"
            )
        found = _difference(state, made_for)
        if found is not None:
            raise ConfigError(
                f"the memory was not made by tracker '{self.name}' for this `static`: {found}; "
                "give that of its `init`, or enlarge it: `method.enlarge(state, static)`"
            )

    def static(self, **capacities: Any) -> Static:
        """Capacities, the published ones where they are left out, with its switches as published.

        Raises:
          ConfigError: If one of them is not allowed.
        """
        return Static(**{"switches": self.switches(), **capacities})

    @property
    def explainer(self) -> Any:
        """The class that explains the traces of a run; None if there is none."""
        name = self.host.explainer_name
        return None if name is None else _import_attribute(name)

    def make_empty(self, static: Static) -> Any:
        """The empty memory of these capacities, as arrays of the host that may be written to."""
        return jax.tree.map(np.array, jax.device_get(self.init(static)))

    def enlarge(self, state: Any, static: Static) -> Any:
        """The memory with the larger capacities of `static`; results do not change.

        Raises:
          ConfigError: If one of them is smaller than that of the memory.
        """
        # On the host, where reading a column compiles nothing: a frame waits for this.
        state = jax.device_get(state)
        empty = self.make_empty(static)
        for (name, leaf), room in zip(named_leaves(state), jax.tree.leaves(empty), strict=False):
            if any(map(operator.gt, np.shape(leaf), room.shape)):
                raise ConfigError(
                    f"the memory of tracker '{self.name}' does not fit into this `static`: "
                    f"'{name}' is {list(leaf.shape)}, and there is room for {list(room.shape)}; "
                    "make a `static` that is no smaller than that of the memory"
                )
        return (self.host.grow or extend)(state, empty)

    def forget(self, state: Any, object_ids: Iterable[int], static: Static) -> Any:
        """The memory without these objects, on the host; ids that it does not have are left out.

        Raises:
          ConfigError: If this method cannot do so.
        """
        if self.host.remove is None:
            raise ConfigError(
                f"tracker '{self.name}' cannot forget single objects; start without the memory"
            )
        state, empty = jax.device_get((state, self.init(static)))
        return self.host.remove(state, empty, np.array(list(object_ids), int))

    def known_ids(self, state: Any) -> set[int]:
        """Ids of all objects in memory, and of those that are coming to be; none of None."""
        if state is None:
            return set()
        # On the host: of an array on a device, programs would be compiled.
        ids = np.asarray(state.objects.id)
        return {*ids[ids >= 0].tolist(), *self.coming_ids(state)}

    def coming_ids(self, state: Any) -> set[int]:
        """Ids that were answered for what is no object in memory yet; none of None."""
        if state is None or self.host.coming_ids is None:
            return set()
        return {int(one) for one in self.host.coming_ids(state)}

    def count_occupied(self, state: Any) -> tuple[Any, Any]:
        """Slots of objects and of pending tracks that are in use."""
        if self.host.occupied is not None:
            return self.host.occupied(state)
        return (state.objects.id >= 0).sum(), 0


def extend(state: Any, empty: Any) -> Any:
    """A memory in the first slots of an empty one of the host; nothing overflows there."""
    return jax.tree.map(_fill, dataclasses.replace(state, overflow=empty.overflow), empty)


def named_leaves(tree: Any) -> list[tuple[str, Any]]:
    """The leaves of a memory or of a trace, by dotted path."""
    paths, _ = jax.tree_util.tree_flatten_with_path(tree)
    return [(jax.tree_util.keystr(path, simple=True, separator="."), leaf) for path, leaf in paths]


@functools.lru_cache(maxsize=64)
def _shapes_of_empty(init: Callable[[Static], Any], static: Static) -> Any:
    return jax.eval_shape(functools.partial(init, static))


def _difference(found: Any, wanted: Any) -> str | None:
    """How a memory differs from another; None if it does not."""
    old, new = dict(named_leaves(wanted)), dict(named_leaves(found))
    wrong = next((name for name in old if np.shape(new.get(name, 0)) != old[name].shape), None)
    if wrong is not None:
        return f"'{wrong}' is not {list(old[wrong].shape)}"
    same = jax.tree.structure(found) == jax.tree.structure(wanted)
    return None if same else "it has another structure"


def _fill(small: np.ndarray, large: np.ndarray) -> np.ndarray:
    """The larger array with the values of the other in its first places."""
    if small is not large:  # is filled already
        large[tuple(slice(0, length) for length in small.shape)] = small
    return large


# "module:attribute" is imported when the method is first asked for.
_methods: dict[str, Method | str] = {**find_methods()}

# Configurations that are a method with its published numbers.
_CONFIGURED = {"default": "plus", "published": PAPER_METHOD}


def get_method(name: str) -> Method:
    """Gives a method by name, or by that of the configuration `default` or `published`.

    Raises:
      ConfigError: If there is no such method.
    """
    name = _CONFIGURED.get(name, name)
    if name not in _methods:
        raise ConfigError(f"there is no tracker {name!r}; {nearest_names(str(name), _methods)}")
    method = _methods[name]
    if isinstance(method, str):
        method = _methods[name] = _import_attribute(method)
    return method


def register_method(method: Method) -> None:
    """Adds a method under its name, or takes it anew, as where a notebook runs a cell again.

    Raises:
      ConfigError: If it is no `Method`, what it is made of is no function, its settings are no
        dataclass that is a pytree, or its name is none or that of another.
    """
    if not isinstance(method, Method) or not isinstance(method.name, str) or not method.name:
        raise ConfigError("only a Method that has a name can be registered")
    for name in ("init", "describe", "decide"):
        function = getattr(method, name)
        try:
            is_fit = callable(function) and isinstance(hash(function), int)
        except TypeError:
            is_fit = False
        if not is_fit:
            raise ConfigError(
                f"'{name}' of tracker '{method.name}' is {reprlib.repr(function)}; give a "
                "function, or an object that can be called and hashed"
            )
    settings = method.settings()
    if not dataclasses.is_dataclass(settings) or jax.tree_util.all_leaves([settings]):
        raise ConfigError(
            f"settings of tracker '{method.name}' are of type {type(settings).__name__}; give a "
            "dataclass that is a pytree (`jax.tree_util.register_dataclass`)"
        )
    taken = _methods.get(method.name, method)
    is_another = method.name in find_methods() or _origin(taken) != _origin(method)
    if method.name in _CONFIGURED or (taken is not method and is_another):
        raise ConfigError(f"a tracker {method.name!r} is registered already; choose another name")
    _methods[method.name] = method


def _origin(method: Any) -> tuple[str, str]:
    """Where what it decides by is defined."""
    decide = method.decide
    while hasattr(decide, "func"):  # partial
        decide = decide.func
    decide = decide if hasattr(decide, "__qualname__") else type(decide)
    return decide.__module__, decide.__qualname__


def list_methods() -> list[str]:
    """Names of all methods, that of the configuration `default` first."""
    return list(_methods)


def _import_attribute(path: str) -> Any:
    """What `module:attribute` names."""
    module, _, attribute = path.partition(":")
    return getattr(importlib.import_module(module), attribute)
