"""Branches and loops that stay branches and loops under `vmap`: the one rule for all methods.

`jax.vmap` turns a branch on a batched predicate into both branches and a choice, and lets every
turn of a loop choose between its whole state before and after. A memory is tens of megabytes, and
the rare branches are the expensive ones. So whatever takes long or is rarely needed goes through
this module, and a batch takes a branch, or another turn, if any of its members does. What is cheap
is computed for all and chosen by `jnp.where`. `jax.lax.cond` and `while_loop` are used here only.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax import lax
from jax.custom_batching import custom_vmap
from jaxtyping import Array, Bool, Int, Shaped

from remind_jax.numerics.pytree import choose
from remind_jax.numerics.slices import give_axis, put_slice, take_slice

T = TypeVar("T")


def branch(
    pred: Bool[Array, ""],
    then: Callable[[], T],
    otherwise: Callable[[], T],
    *,
    suits_all: bool = False,
) -> T:
    """One of two results of equal structure; only that one is computed.

    In a batch, `then` is skipped where no member needs it.

    Args:
      pred: Whether it is `then`.
      then: Computes the result; what it needs, it closes over.
      otherwise: Computes the other one; cheap, as a batch computes it for all members.
      suits_all: The members of a batch that do not need `then` may take it, too: it gives them what
        `otherwise` does, or what nobody reads.
    """

    def choose() -> T:
        return then() if suits_all else _choose_in_batch(pred, then(), otherwise())

    return lax.cond(batch_max(pred), choose, otherwise)


def repeat(more: Callable[[T], Bool[Array, ""]], turn: Callable[[T], T], start: T) -> T:
    """Takes turns while there is more to do.

    Args:
      more: Whether another turn is needed.
      turn: Must leave the results in a state that needs no more turns as they are: in a batch it
        is applied to all members until the last one is done.
      start: The state before the first turn; `turn` keeps its structure, shapes and types.
    """
    return lax.while_loop(lambda state: batch_max(more(state)), turn, start)


def count_up(
    stop: Int[Array, ""],
    turn: Callable[[Int[Array, ""], T], T],
    start: T,
    first: int = 0,
    *,
    suits_all: bool = False,
) -> T:
    """Takes the turns that are numbered from `first` to `stop - 1`.

    In a batch all members take the turns of the longest, and one that is done keeps what it has.
    The number of the turn stays that of all, so that what it picks out is a slice and no gather.

    Args:
      stop: Number of turns.
      turn: Takes the number of the turn and the state; keeps structure, shapes and types.
      start: The state before the first turn.
      first: Number of the first turn.
      suits_all: The members of a batch that are done may take further turns, too: these change
        nothing, or what nobody reads. So no turn chooses between whole states.
    """

    def take(number: Int[Array, ""], state: T) -> T:
        if suits_all:
            return turn(number, state)
        return _choose_in_batch(number < stop, turn(number, state), state)

    return lax.fori_loop(first, batch_max(stop), take, start)


def fill_blocks(
    make: Callable[[Callable[[Array], Array]], T], used: Bool[Array, "M"], rows: T, size: int
) -> T:
    """Makes rows anew up to the last one in use, a block at a time; most others stay as they are.

    Args:
      make: Gives the rows of a block; is given what takes those of this block from any array that
        has `M` rows.
      used: Rows in use; what the others become, nobody reads.
      rows: Arrays of `M` rows.
      size: Rows of a block on a CPU; elsewhere, where a loop costs by its turns, all make one.
    """
    num = len(used)
    size = min(size, num) if jax.default_backend() == "cpu" else num
    stop = jnp.max(jnp.where(used, jnp.arange(num), -1)) + 1

    def turn(number: Int[Array, ""], rows: T) -> T:
        start = jnp.minimum(number * size, num - size)
        made = make(lambda of_all: take_slice(of_all, start, size))
        return jax.tree.map(lambda leaf, new: put_slice(leaf, new, start), rows, made)

    return count_up(-(-stop // size), turn, rows, suits_all=True)


def in_turn(needed: Bool[Array, ""], function: Callable[..., T], *given: Any) -> T:
    """`function(*given)`; on a CPU each member of a batch that needs it by itself.

    For what has loops of its own: on a CPU a batch goes one after the other through the members
    that need it, and each takes its own turns, as many as they are. Elsewhere, where a loop costs
    by its turns, all take them together.

    Args:
      needed: Whether anybody reads the result; that of a member where nobody does is anything.
      function: Takes all that it needs as arguments.
      *given: These arguments, trees of arrays.
    """

    @custom_vmap
    def run(needed: Array, *given: Any) -> T:
        del needed
        return function(*given)

    @run.def_vmap
    def run_in_batch(
        size: int, is_batched: Sequence[Any], needed: Array, *given: Any
    ) -> tuple[T, Any]:
        if jax.default_backend() != "cpu":
            axes = jax.tree.map(lambda own: 0 if own else None, tuple(is_batched[1:]))
            results = jax.vmap(function, axes)(*given)
            return results, jax.tree.map(lambda _: True, results)

        def pick(member: Array | int, leaf: Array, own: bool) -> Array:
            return lax.dynamic_index_in_dim(leaf, member, keepdims=False) if own else leaf

        def of_member(member: Array | int) -> Any:
            return jax.tree.map(functools.partial(pick, member), given, tuple(is_batched[1:]))

        needed = give_axis(needed, is_batched[0], size)
        order = jnp.argsort(~needed, stable=True)

        def turn(k: Array, results: T) -> T:
            found = function(*of_member(order[k]))
            return jax.tree.map(
                lambda all_of, one: lax.dynamic_update_index_in_dim(all_of, one, order[k], 0),
                results,
                found,
            )

        shapes = jax.eval_shape(lambda: function(*of_member(0)))
        nothing = jax.tree.map(lambda leaf: jnp.zeros((size, *leaf.shape), leaf.dtype), shapes)
        results = lax.fori_loop(0, jnp.sum(needed), turn, nothing)
        return results, jax.tree.map(lambda _: True, results)

    return run(needed, *jax.tree.map(jnp.asarray, given))


@custom_vmap
def batch_max(value: Shaped[Array, ""]) -> Shaped[Array, ""]:
    """Largest value (or any flag) over whatever batch the caller is mapped to; itself if none.

    For capacities, which a batch shares; branches and loops take it from `branch` and `repeat`.
    """
    return value


@batch_max.def_vmap
def _batch_max_mapped(axis_size, in_batched, value):
    del axis_size
    (batched,) = in_batched
    return (batch_max(jnp.max(value, axis=0)) if batched else batch_max(value)), False


@custom_vmap
def _choose_in_batch(pred: Bool[Array, ""], then: T, otherwise: T) -> T:
    """`then`, which is asked for only where `pred` holds; in a batch each member has its own."""
    del pred, otherwise
    return then


@_choose_in_batch.def_vmap
def _choose_mapped(axis_size, in_batched, pred, then, otherwise):
    pred_batched, *sides_batched = in_batched
    then, otherwise = (
        jax.tree.map(lambda leaf, own: give_axis(leaf, own, axis_size), side, side_batched)
        for side, side_batched in zip((then, otherwise), sides_batched, strict=True)
    )
    if pred_batched:
        chosen = choose(pred, then, otherwise)
    else:
        chosen = _choose_in_batch(pred, then, otherwise)
    return chosen, jax.tree.map(lambda _: True, chosen)
