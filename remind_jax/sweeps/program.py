"""The compiled part of a sweep: many settings go through the same frames.

Letters: `S` settings, `T` frames, `N` detection slots.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Callable, Mapping
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh, NamedSharding, PartitionSpec
from jaxtyping import Array, Float, Int

from remind_jax.compiled.compiler_options import compile_lowered
from remind_jax.compiled.frame_step import settle_types
from remind_jax.compiled.programs import (
    Recipe,
    Shapes,
    count_bytes,
    get_program,
    identify,
    is_of_this_package,
    shapes_of,
)
from remind_jax.decision import NO_ID, Outcome
from remind_jax.method import Method
from remind_jax.metrics.in_graph import GraphScores, score_labels
from remind_jax.numerics.pytree import pytree
from remind_jax.static import Static

_AXIS = "settings"  # that devices share
# Of a setting on a scene.
SCORES = (
    *("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery", "Ambiguous", "Provisional", "Firm"),
    "Identities",
)


@pytree
class Answers:
    """What every setting said about every detection."""

    outcome: Int[Array, "T S N"]  # decision.Outcome
    object_id: Int[Array, "T S N"]  # -1 where undecided
    score: Float[Array, "T S N"]
    evidence: Mapping[str, Int[Array, "T S N"]]  # what the method revises answers by
    needed_objects: Int[Array, "T S"]  # slots that the frame lacked, 0 if they sufficed
    needed_pending: Int[Array, "T S"]


@functools.partial(jax.jit, static_argnums=(0, 1, 2))
def empty_memories(method: Method, static: Static, num_settings: int) -> Any:
    """One empty memory per setting, leading axis `S`."""
    empty = settle_types(method.init(static))
    return jax.tree.map(lambda leaf: jnp.broadcast_to(leaf, (num_settings, *leaf.shape)), empty)


def goes_in_turn(method: Method) -> bool:
    """Whether settings go one after the other here (`method.Sweeping.in_turn_on_cpu`)."""
    return method.sweeping.in_turn_on_cpu and jax.default_backend() == "cpu"


def follow(
    states: Any, thresholds: Any, frames: Any, *, method: Method, static: Static
) -> tuple[Any, Answers]:
    """Takes the memories of all settings through some described frames.

    Memories and thresholds have a leading axis `S`, frames one of `T`.
    """

    def advance(state: Any, t: Any, frame: Any) -> tuple[Any, Answers]:
        decided = method.decide(state, frame, static=static, thresholds=t)
        state, _ = method.as_before(decided, state)
        said, lacks = state.decisions, state.overflow
        answers = Answers(
            outcome=said.outcome,
            object_id=said.object_id,
            score=said.score,
            evidence=method.host.evidence(state),
            needed_objects=lacks.objects,
            needed_pending=lacks.pending,
        )
        return state, answers

    def follow_one(given: tuple[Any, Any]) -> tuple[Any, Answers]:
        state, t = given
        return jax.lax.scan(lambda state, frame: advance(state, t, frame), state, frames)

    if goes_in_turn(method):
        states, answers = jax.lax.map(follow_one, (states, thresholds))
        return states, jax.tree.map(lambda leaf: leaf.swapaxes(0, 1), answers)
    advance_all = jax.vmap(advance, in_axes=(0, 0, None))
    return jax.lax.scan(
        lambda states, frame: advance_all(states, thresholds, frame), states, frames
    )


def score(
    object_index: Int[Array, "T N"], answers: Answers, *, num_objects: int, num_labels: int
) -> dict[str, Array]:
    """Scores of every setting, each `[S]`, by the rules of `metrics`, undecided ones strictly.

    `overflow` beside them says whether a setting made more ids than there are labels.
    """
    said = answers.outcome
    is_firm = (said == Outcome.MATCH) | (said == Outcome.NEW)
    firm = jnp.where(is_firm, answers.object_id, NO_ID)
    real = object_index >= 0

    def one(ids: Array, certainty: Array) -> tuple[GraphScores, Array]:
        scores = score_labels(
            object_index, ids, score=certainty, num_objects=num_objects, num_labels=num_labels
        )
        label = jnp.where(ids >= 0, ids, num_labels)
        return scores, jnp.sum(jnp.zeros(num_labels, bool).at[label].set(True, mode="drop"))

    scores, num_ids = jax.vmap(one, in_axes=(1, 1))(firm, answers.score)
    num_real = jnp.maximum(1, jnp.sum(real))

    def share(chosen: Array) -> Array:
        return jnp.sum(chosen & real[:, None], axis=(0, 2)) / num_real

    provisional = (said == Outcome.PROVISIONAL_NEW) | (said == Outcome.PROVISIONAL_PARENT)
    return {
        "IDF1": scores.idf1,
        "HOTA": scores.hota,
        "AssA": scores.ass_a,
        "Recovery": scores.recovery,
        "HardRecovery": scores.hard_recovery,
        "Ambiguous": share(said == Outcome.AMBIGUOUS),
        "Provisional": share(provisional),
        "Firm": share(is_firm),
        "Identities": num_ids,
        "overflow": scores.overflow,
    }


def spread(tree: Any) -> Any:
    """Puts arrays on the devices, each of which takes an equal share of the settings."""
    where = _shardings()
    return jax.device_put(tree) if where is None else jax.device_put(tree, where[0])


def repeat(tree: Any) -> Any:
    """Puts arrays on the devices, each of which takes all of them."""
    where = _shardings()
    return jax.device_put(tree) if where is None else jax.device_put(tree, where[1])


@functools.cache
def _shardings() -> tuple[NamedSharding, NamedSharding, NamedSharding] | None:
    """Settings along the first axis, none, settings along the second; None with one device."""
    devices = jax.local_devices()
    if len(devices) == 1:
        return None
    mesh = Mesh(np.array(devices), (_AXIS,))
    first, none, second = PartitionSpec(_AXIS), PartitionSpec(), PartitionSpec(None, _AXIS)
    return NamedSharding(mesh, first), NamedSharding(mesh, none), NamedSharding(mesh, second)


@dataclasses.dataclass(frozen=True)
class Program:
    """`follow` for so many settings, compiled; the memories that it is given are used up."""

    run: Callable[[Any, Any, Any], tuple[Any, Answers]]
    # That it needs on each device: arguments, results and scratch space, as the compiler counts.
    num_bytes: int


def compile_follow(
    method: Method, static: Static, num_settings: int, thresholds: Any, frames: Any
) -> Program:
    """Compiles `follow` for the shapes of the arguments, once per process."""
    given = (thresholds, frames)
    return _compile(method, static, num_settings, shapes_of(given), jax.tree.structure(given))


@functools.lru_cache(maxsize=8)
def _compile(
    method: Method, static: Static, num_settings: int, shapes: Shapes, structure: Any
) -> Program:
    states = jax.eval_shape(lambda: empty_memories(method, static, num_settings))
    run = functools.partial(follow, method=method, static=static)
    if (where := _shardings()) is None:
        return _compile_kept(run, states, shapes, structure)
    settings, frame, answers = where
    # Every device goes its own way: a branch is taken where one of its own settings needs it.
    program = jax.jit(
        jax.shard_map(
            run,
            mesh=settings.mesh,
            in_specs=(settings.spec, settings.spec, frame.spec),
            out_specs=(settings.spec, answers.spec),
            check_vma=False,
        ),
        donate_argnums=0,
        in_shardings=(settings, settings, frame),
        out_shardings=(settings, answers),
    )
    lowered = program.lower(states, *jax.tree.unflatten(structure, shapes))
    compiled = compile_lowered(lowered, "step")
    return Program(compiled, count_bytes(compiled))


def _compile_kept(run: functools.partial, states: Any, shapes: Shapes, structure: Any) -> Program:
    """The program of one device, kept for other processes if the method is of this package."""
    method, static = run.keywords["method"], run.keywords["static"]
    state_leaves, state_structure = jax.tree.flatten(states)
    num = len(state_leaves)
    evidence = dict(jax.eval_shape(method.host.evidence, states))
    blank: Any = 0
    answers = jax.tree.structure(Answers(blank, blank, blank, evidence, blank, blank))

    def on_leaves(*leaves: Any) -> Any:
        thresholds, frames = jax.tree.unflatten(structure, leaves[num:])
        return run(jax.tree.unflatten(state_structure, leaves[:num]), thresholds, frames)

    program = get_program(
        Recipe(
            "follow",
            on_leaves,
            (*shapes_of(states), *shapes),
            (identify(method.decide), static, structure),
            num_donated=num,
            is_kept=is_of_this_package(method.decide) and static.solver != "host",
        )
    )

    def follow_leaves(states: Any, thresholds: Any, frames: Any) -> tuple[Any, Answers]:
        results = program(*jax.tree.leaves((states, thresholds, frames)))
        states = jax.tree.unflatten(state_structure, results[:num])
        return states, jax.tree.unflatten(answers, results[num:])

    return Program(follow_leaves, program.num_bytes)


def compiled_score(
    object_index: Int[np.ndarray, "T N"], answers: Answers, *, num_objects: int, num_labels: int
) -> dict[str, np.ndarray]:
    """`score`, compiled once per process and kept for others."""
    leaves, structure = jax.tree.flatten((object_index, answers))

    def on_leaves(*leaves: Any) -> list[Array]:
        given = jax.tree.unflatten(structure, leaves)
        scores = score(*given, num_objects=num_objects, num_labels=num_labels)
        return [scores[name] for name in (*SCORES, "overflow")]

    program = get_program(Recipe("score", on_leaves, shapes_of(leaves), (num_objects, num_labels)))
    return dict(zip((*SCORES, "overflow"), jax.device_get(program(*leaves)), strict=True))
