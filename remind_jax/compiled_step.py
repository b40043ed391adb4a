"""The step of any method as one compiled program: types settled, memory handed over in place."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax

from remind_jax.config.static import Static
from remind_jax.observation import FrameFeats, Masks
from remind_jax.trace import Trace
from remind_jax.tracker import step, step_traced

# Nearly all of a step's compilation is spent on machine code. On a CPU, level 1 takes a fifth off
# it, and the step is not slower for it; level 0 is six times as slow.
COMPILER_OPTIONS = {"cpu": {"xla_backend_optimization_level": 1}}


def step_once(
    state: Any,
    frame_feats: FrameFeats,
    masks: Masks,
    observed: Any = None,
    *,
    static: Static,
    thresholds: Any,
    step: Callable[..., Any] = step,
) -> Any:
    """One step of a method; the memory comes back in the types that it is given in."""
    more = {} if observed is None else {"observed": observed}
    stepped = step(state, frame_feats, masks, static=static, thresholds=thresholds, **more)
    return settle_types(stepped)


def step_once_traced(
    state: Any,
    frame_feats: FrameFeats,
    masks: Masks,
    observed: Any = None,
    *,
    static: Static,
    thresholds: Any,
    step: Callable[..., tuple[Any, Trace]] = step_traced,
) -> tuple[Any, Trace]:
    """As `step_once`, with an account of the decisions; `step` is a method's `step_traced`."""
    more = {} if observed is None else {"observed": observed}
    stepped, trace = step(state, frame_feats, masks, static=static, thresholds=thresholds, **more)
    return settle_types(stepped), trace


def settle_types(state: Any) -> Any:
    """Strong types throughout: a weak one that comes or goes costs a second compilation."""
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), state)


@functools.cache
def compiled_step(traced: bool = False) -> Callable[..., Any]:
    """`step_once` or `step_once_traced`, compiled for the device in use.

    `static` and `step` select the program; the buffers of the memory given are used up.
    """
    return jax.jit(
        step_once_traced if traced else step_once,
        static_argnames=("static", "step"),
        donate_argnames="state",
        compiler_options=COMPILER_OPTIONS.get(jax.default_backend()),
    )
