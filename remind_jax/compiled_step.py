"""The step of any method as one compiled program: types settled, memory handed over in place."""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from remind_jax.config.static import Static
from remind_jax.observation import FrameFeats, Masks
from remind_jax.packing import Packed
from remind_jax.program_store import is_of_this_package, name_function, trace_once
from remind_jax.trace import Trace
from remind_jax.tracker import step

# Nearly all of a step's compilation is spent on machine code. On a CPU, level 1 takes a fifth off
# it, and the step is not slower for it; level 0 is six times as slow.
COMPILER_OPTIONS = {"cpu": {"xla_backend_optimization_level": 1}}
# One frame is thousands of small operations; to share each between threads costs more than it
# gains.
ONE_FRAME_OPTIONS = {"cpu": {**COMPILER_OPTIONS["cpu"], "xla_cpu_multi_thread_eigen": False}}


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


def step_packed(
    state: Any,
    frame_feats: FrameFeats,
    given: Packed,
    thresholds: Packed,
    *,
    static: Static,
    step: Callable[..., Any] = step,
    traced: bool = False,
) -> tuple[Any, Packed, Trace | None]:
    """`step_once` as the host calls it.

    Args:
      state: The memory.
      frame_feats: What the backbone says.
      given: Masks, and what was observed beside them or None.
      thresholds: Those of the method.
      static: Shapes and structure.
      step: The method's `step`, or its `step_traced`.
      traced: Which of them it is.

    Returns:
      The memory, what the host reads of it at once (decisions and overflow), and the account of
      the decisions if traced.
    """
    masks, observed = given.unpack()
    stepped = step_once(
        state, frame_feats, masks, observed,
        static=static, thresholds=thresholds.unpack(), step=step,
    )  # fmt: skip
    state, trace = stepped if traced else (stepped, None)
    return state, Packed.of((state.decisions, state.overflow)), trace


def settle_types(state: Any) -> Any:
    """Strong types throughout: a weak one that comes or goes costs a second compilation."""
    return jax.tree.map(lambda leaf: jax.lax.convert_element_type(leaf, leaf.dtype), state)


@functools.partial(jax.jit, static_argnums=(0, 1))
def _make_empty(init: Callable[[Static], Any], static: Static) -> Any:
    return settle_types(init(static))


def empty_state(init: Callable[[Static], Any], static: Static) -> Any:
    """The empty memory of a method, in the types that its step takes; one program, not dozens."""
    return stay(_make_empty(init, static))


def stay(state: Any) -> Any:
    """The memory bound to its device, as a kept program returns it: else it compiles once more."""
    return jax.tree.map(lambda leaf: jax.device_put(leaf, jnp.asarray(leaf).sharding), state)


def step_kept(
    *args: Any, static: Static, step: Callable[..., Any] = step, traced: bool = False
) -> tuple[Any, Packed, Trace | None]:
    """`step_packed`, traced once for all processes if the step is one of this package."""
    run = functools.partial(step_packed, static=static, step=step, traced=traced)
    if traced or not is_of_this_package(step):
        return run(*args)
    state = args[0]
    result = (state, Packed.of((state.decisions, state.overflow)), None)
    return trace_once(run, args, result, ("step", static, name_function(step)))


@functools.cache
def compiled_step() -> Callable[..., tuple[Any, Packed, Trace | None]]:
    """`step_kept`, compiled for the device in use.

    `static`, `step` and `traced` select the program; the buffers of the memory given are used up.
    """
    return jax.jit(
        step_kept,
        static_argnames=("static", "step", "traced"),
        donate_argnums=0,
        compiler_options=ONE_FRAME_OPTIONS.get(jax.default_backend()),
    )
