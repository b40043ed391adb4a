"""Branches and loops that stay lazy under `vmap`.

`jax.vmap` turns a branch on a batched predicate into both branches and a choice, and lets every
turn of a loop choose between its whole state before and after. A memory is tens of megabytes, and
the rare branches are the expensive ones; here a batch takes a branch if any of its members does.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.core import eval_jaxpr
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool

T = TypeVar("T")


def branch(pred: Bool[Array, ""], then: Callable[[], T], otherwise: Callable[[], T]) -> T:
    """One of two results of equal structure; only that one is computed.

    In a batch, `then` is skipped where no member needs it.

    Args:
      pred: Whether it is `then`.
      then: Computes the result; what it needs, it closes over.
      otherwise: Computes the other one; cheap, as a batch computes it for all members.
    """
    run_then, of_then = _explicit(then)
    run_otherwise, of_otherwise = _explicit(otherwise)

    @custom_vmap
    def choose(pred: Array, of_then: list, of_otherwise: list) -> T:
        return jax.lax.cond(pred, lambda: run_then(of_then), lambda: run_otherwise(of_otherwise))

    @choose.def_vmap
    def _(axis_size: int, batched: Sequence, pred: Array, of_then: list, of_otherwise: list):
        pred_batched, *operands_batched = batched
        then_all, otherwise_all = (
            _over_batch(run, operands, is_batched, axis_size)
            for run, operands, is_batched in zip(
                (run_then, run_otherwise), (of_then, of_otherwise), operands_batched, strict=True
            )
        )

        def each_its_own() -> T:
            return jax.tree.map(
                lambda new, old: jnp.where(pred.reshape(-1, *(1,) * (new.ndim - 1)), new, old),
                then_all(),
                otherwise_all(),
            )

        if pred_batched:
            chosen = branch(jnp.any(pred), each_its_own, otherwise_all)
        else:
            chosen = branch(pred, then_all, otherwise_all)
        return chosen, jax.tree.map(lambda _: True, chosen)

    return choose(pred, of_then, of_otherwise)


def repeat(more: Callable[[T], Bool[Array, ""]], turn: Callable[[T], T], start: T) -> T:
    """Takes turns while there is more to do.

    Args:
      more: Whether another turn is needed.
      turn: Must leave the results in a state that needs no more turns as they are: in a batch it
        is applied to all members until the last one is done.
      start: The state before the first turn; `turn` keeps its structure, shapes and types.
    """
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), start)
    run_more, of_more = _explicit(more, shapes)
    run_turn, of_turn = _explicit(turn, shapes)

    @custom_vmap
    def loop(start: T, of_more: list, of_turn: list) -> T:
        return jax.lax.while_loop(
            lambda state: run_more(of_more, state), lambda state: run_turn(of_turn, state), start
        )

    @loop.def_vmap
    def _(axis_size: int, batched: Sequence, start: T, of_more: list, of_turn: list):
        start_batched, more_batched, turn_batched = batched
        start = jax.tree.map(
            lambda leaf, is_batched: (
                leaf if is_batched else jnp.broadcast_to(leaf, (axis_size, *leaf.shape))
            ),
            start,
            start_batched,
        )

        def any_more(state: Any) -> Array:
            return jnp.any(_over_batch(run_more, of_more, more_batched, axis_size)(state))

        turn_all = _over_batch(run_turn, of_turn, turn_batched, axis_size)
        done = repeat(any_more, turn_all, start)
        return done, jax.tree.map(lambda _: True, done)

    return loop(start, of_more, of_turn)


def _explicit(function: Callable, *shapes: Any) -> tuple[Callable, list]:
    """The function with what it closes over as its first argument, and that."""
    closed, out = jax.make_jaxpr(function, return_shape=True)(*shapes)
    structure = jax.tree.structure(out)

    def run(closed_over: list, *args: Any) -> Any:
        leaves = jax.tree.leaves(args)
        return jax.tree.unflatten(structure, eval_jaxpr(closed.jaxpr, closed_over, *leaves))

    return run, list(closed.consts)


def _over_batch(run: Callable, operands: list, batched: list, axis_size: int) -> Callable[..., Any]:
    """`run` for all members of a batch, whose further arguments are batched."""
    axes = [0 if is_batched else None for is_batched in batched]

    def run_all(*args: Any) -> Any:
        mapped = jax.vmap(run, in_axes=(axes, *(0,) * len(args)), axis_size=axis_size)
        return mapped(operands, *args)

    return run_all
