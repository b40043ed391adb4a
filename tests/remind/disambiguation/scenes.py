"""Frozen scenes with look-alikes, and what the reference rules make of them.

The scenes were drawn at random (look-alikes, histories, virtual objects, second matches of an
object); the answers are those of an independent plain implementation of the rules that
agrees with the original. Real inputs are stored in 1/1024. `expected.*` is by detection or by the
root of a group; `expected.numbers` is score, gap, core, core gap and evidence.
"""

import dataclasses
import functools
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.disambiguation.anchors import KnownScores
from remind_jax.remind.disambiguation.distance_evidence import DistanceEvidence, FrameRelations
from remind_jax.remind.disambiguation.groups import Entries
from remind_jax.remind.disambiguation.known_sets import settle_known_sets
from remind_jax.remind.thresholds.known_sets import KnownSets
from remind_jax.static import Static

GOLDEN = Path(__file__).parents[2] / "golden" / "disambiguation" / "known_sets.npz"
UNIT = 1024
NUM_OBJECTS = 8


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Scene:
    entries: Any
    matched_slot: Any
    matched_pass: Any
    scores: Any
    object_exists: Any
    relations: Any
    evidence: Any


@functools.cache
def load_stored() -> dict[str, np.ndarray]:
    with np.load(GOLDEN) as stored:
        return {name: stored[name] for name in stored.files}


def load_scenes(precision: str = "float64") -> Scene:
    """All scenes, with a leading axis."""

    def read(name: str) -> np.ndarray:
        value = load_stored()[name]
        if value.dtype == np.int16:
            return (value / UNIT).astype(precision)
        return value if value.dtype == bool else value.astype(np.int32)

    def read_all(kind: type, prefix: str) -> Any:
        names = [field.name for field in dataclasses.fields(kind)]
        return kind(**{name: read(prefix + name) for name in names})

    low, high = np.triu_indices(NUM_OBJECTS, 1)

    def unfold(above: np.ndarray, below: np.ndarray) -> np.ndarray:
        cube = np.zeros((*above.shape[:-1], NUM_OBJECTS, NUM_OBJECTS), above.dtype)
        cube[..., low, high], cube[..., high, low] = above, below
        return cube

    names = [field.name for field in dataclasses.fields(DistanceEvidence)][:-2]
    squares = {name: read("evidence." + name) for name in names}
    first = read("evidence.pair_first")
    nearer = unfold(first, read("evidence.pair_n") - first)
    mean, squares_sum = (read(f"evidence.pair_margin_{name}") for name in ("mean", "m2"))
    return Scene(
        Entries(read("present"), read("candidates"), read("class_id")),
        read("matched_slot"),
        read("matched_pass"),
        read_all(KnownScores, ""),
        read("object_exists"),
        read_all(FrameRelations, "relations."),
        DistanceEvidence(**squares, nearer=nearer, margin=unfold(mean, squares_sum)),
    )


def thresholds(precision: str = "float64", **changes: Any) -> KnownSets:
    def convert(value: Any) -> jax.Array:
        kinds = {bool: bool, int: jnp.int32, float: precision}
        return jnp.asarray(value, kinds[type(value)])

    return jax.tree.map(convert, KnownSets(**changes))


@functools.partial(jax.jit, static_argnames="static")
def settle_all(scenes: Scene, t: KnownSets, static: Static) -> Any:
    """Settles all scenes of a batch."""

    def one(scene: Scene) -> Any:
        return settle_known_sets(
            **{field.name: getattr(scene, field.name) for field in dataclasses.fields(scene)},
            static=static,
            t=t,
        )

    return jax.vmap(one)(scenes)


def settle_scenes(scenes: Scene, precision: str = "float64", **changes: Any) -> Any:
    static = Static(precision=precision)  # type: ignore[arg-type]
    return jax.device_get(settle_all(scenes, thresholds(precision, **changes), static))
