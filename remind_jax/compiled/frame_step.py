"""The step of any method as compiled programs: one describes a frame, the other decides.

The first depends on the size of frames, the second does not, so that a video of another size
compiles only the first, and objects that are met later only the second.
"""

from __future__ import annotations

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.compiled.packing import Bundle, Layout, Packed
from remind_jax.compiled.programs import (
    Program,
    Recipe,
    get_program,
    identify,
    is_jit_off,
    is_of_this_package,
    shapes_of,
    structure_of,
)
from remind_jax.method import Method
from remind_jax.numerics.pytree import pytree
from remind_jax.observation import AnyFeats
from remind_jax.static import Static

# A memory of so many bytes at most stays beside the one after the frame, so that Ctrl-C within a
# step loses nothing. For two larger ones there may be no room, and to copy them takes its time.
_SMALL_BYTES = 128 << 20


@pytree
class FrameInput:
    """What enters the step beside the memory."""

    frame_feats: AnyFeats
    given: Packed  # `observation.Masks`, and what the method observed beside them or None
    thresholds: Packed  # those of the method


@pytree
class Readout:
    """What the host reads of the memory after a frame."""

    decisions: Any  # `decision.Decisions`
    overflow: Any  # slots that the frame lacks, 0 if they sufficed
    occupied: Any  # slots in use


def pack_thresholds(thresholds: Any, scalar: Any) -> Packed:
    """Thresholds in the types that a step takes them in: hundreds of numbers in few arrays."""
    kinds = {bool: bool, int: np.int32, float: scalar}
    return Packed.of(jax.tree.map(lambda v: np.asarray(v, kinds.get(type(v))), thresholds))


def settle_types(state: Any) -> Any:
    """Strong types throughout: a weak one that comes or goes costs a second compilation."""
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), state)


class FrameStep:
    """The step of one method, `describe` and `decide`, compiled for whatever sizes it is given."""

    def __init__(self, method: Method, *, traced: bool = False) -> None:
        """Compiles nothing yet."""
        self._method, self._is_traced = method, traced
        self._prepared: dict[Any, _Programs] = {}

    def describe(self, frame_input: FrameInput, static: Static) -> Described:
        """What the frame looks like."""
        leaves, structure = jax.tree.flatten(frame_input)
        programs = self._programs(leaves, structure, static)
        return Described(programs, programs.describe(*leaves), frame_input.thresholds)

    def decide(self, memory: Bundle, described: Described) -> tuple[Bundle, Packed, Any]:
        """Decides and remembers: the memory, `Readout` packed, and the trace if it is asked for."""
        programs = described.programs
        memory_leaves, memory_structure = jax.tree.flatten(memory)
        placed = jax.tree.leaves(described.thresholds)
        answer = programs.decide(*memory_leaves, *described.leaves, *placed)
        memory_leaves, rest = answer[: len(memory_leaves)], answer[len(memory_leaves) :]
        types = programs.readout.vector_types
        readout = Packed(dict(zip(types, rest, strict=False)), programs.readout)
        trace = None
        if programs.trace_structure is not None:
            trace = jax.tree.unflatten(programs.trace_structure, rest[len(types) :])
        return jax.tree.unflatten(memory_structure, memory_leaves), readout, trace

    def prepare(self, frame_input: FrameInput, static: Static) -> None:
        """Makes the programs for inputs of such sizes, in whatever thread this is."""
        programs = self._programs(*jax.tree.flatten(frame_input), static)
        if self._method.host.at_rest is not None:
            # The frame that first asks would wait for a trace, where the program was kept.
            programs.seen_structure()

    def programs(self) -> list[Program]:
        """Those made so far."""
        return [one for both in self._prepared.values() for one in (both.describe, both.decide)]

    def _programs(self, leaves: list[Any], structure: Any, static: Static) -> _Programs:
        shapes = tuple((leaf.shape, leaf.dtype) for leaf in leaves)
        key = (structure, shapes, static, is_jit_off())
        found = self._prepared.get(key)
        if found is None:
            found = self._prepared[key] = self._make(structure, shapes_of(leaves), static)
        return found

    def _make(self, structure: Any, shapes: Any, static: Static) -> _Programs:
        method = self._method
        state = jax.eval_shape(functools.partial(method.init, static))  # takes no memory
        readout = jax.eval_shape(functools.partial(_read_out, method), state)
        example: FrameInput = jax.tree.unflatten(structure, shapes)
        # What a frame looks like does not depend on how much is remembered.
        own = dataclasses.replace(static, num_objects=1, num_pending=1)
        describe = functools.partial(_describe, method.describe, own)
        description = Recipe(
            "describe",
            lambda *leaves: describe(jax.tree.unflatten(structure, leaves)),
            shapes,
            (identify(method.describe), own, structure),
            is_kept=self._is_kept(method.describe, static),
        )
        described = get_program(description)
        seen_structure = functools.cache(lambda: structure_of(described, description))

        def decide_seen(state: Any, given: tuple[tuple, Packed]) -> Any:
            seen = jax.tree.unflatten(seen_structure(), given[0])
            return method.decide(state, seen, static=static, thresholds=given[1].unpack())

        given = (described.outputs, example.thresholds)
        # What one's own function gives may differ in what is no array; to learn it takes a trace.
        is_ours = is_of_this_package(method.describe)
        seen = identify(method.describe) if is_ours else seen_structure()
        decision = self._decision(decide_seen, state, given, seen, static)
        decide = get_program(decision)
        trace_structure = structure_of(decide, decision).children()[2] if self._is_traced else None
        return _Programs(described, decide, Layout.of(readout), trace_structure, seen_structure)

    def _decision(
        self,
        run: Callable[[Any, Any], tuple[Any, Any]],
        state: Any,
        given: Any,
        seen: Any,
        static: Static,
    ) -> Recipe:
        """That of `run(state, given)` and of its readout; may take over a large memory.

        `seen` tells what frames look like here from what they look like elsewhere.
        """
        memory = jax.eval_shape(Bundle.of, state)
        memory_shapes, memory_structure = shapes_of(memory), jax.tree.structure(memory)
        given_leaves, given_structure = jax.tree.flatten(given)
        num_bytes = sum(math.prod(one.shape) * one.dtype.itemsize for one in memory_shapes)
        # Where own code fails, the memory before stays as well.
        is_ours = all(map(is_of_this_package, (self._method.describe, self._method.decide)))
        counts = self._method.host.occupied or Method.count_occupied

        def on_leaves(*leaves: Any) -> Any:
            before = jax.tree.unflatten(memory_structure, leaves[: len(memory_shapes)]).unpack()
            given = jax.tree.unflatten(given_structure, leaves[len(memory_shapes) :])
            after, trace = self._method.as_before(run(before, given), before)
            return (
                Bundle.of(after),
                Packed.of(_read_out(self._method, after)),
                trace if self._is_traced else None,
            )

        return Recipe(
            "decide",
            on_leaves,
            (*memory_shapes, *shapes_of(given_leaves)),
            (
                *map(identify, (self._method.decide, counts)),
                *(self._is_traced, static, given_structure, seen),
            ),
            num_donated=len(memory_shapes) if is_ours and num_bytes > _SMALL_BYTES else 0,
            is_kept=is_of_this_package(counts) and self._is_kept(self._method.decide, static),
        )

    def _is_kept(self, function: Callable[..., Any], static: Static) -> bool:
        """A program that calls the host holds pointers into this process."""
        return is_of_this_package(function) and static.solver != "host"


@dataclasses.dataclass(frozen=True)
class _Programs:
    """Those for one size of inputs and capacities."""

    describe: Program
    decide: Program
    readout: Layout
    trace_structure: Any
    seen_structure: Callable[[], Any]


@dataclasses.dataclass(frozen=True)
class Described:
    """A frame as it looks, for the step of the capacities that it was described for."""

    programs: _Programs
    leaves: list[jax.Array]
    thresholds: Packed

    @property
    def seen(self) -> Any:
        """What `method.describe` gave."""
        return jax.tree.unflatten(self.programs.seen_structure(), self.leaves)


def _describe(describe: Callable[..., Any], static: Static, frame_input: FrameInput) -> Any:
    masks, observed = frame_input.given.unpack()
    thresholds = frame_input.thresholds.unpack()
    return describe(frame_input.frame_feats, masks, observed, static=static, thresholds=thresholds)


def _read_out(method: Method, state: Any) -> Readout:
    occupied = method.count_occupied(state)
    return Readout(state.decisions, state.overflow, jax.tree.map(jnp.int32, occupied))
