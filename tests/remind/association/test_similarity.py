"""From channels to one score (method.md#channel-scores, method.md#visual-score)."""

from __future__ import annotations

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association import channel_scores, similarity
from remind_jax.remind.association.channel_scores import ChannelScores, Score
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import (
    AUTO,
    OBJECT,
    PARTS,
    Terms,
)
from remind_jax.remind.memory.prototypes import Bank, empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
from tests.remind.memory.small_banks import with_records
from tests.statics import change_static, make_static

STATIC = make_static(feature_dim=3)
DENSE = (0.5 - 0.15) / (0.60 - 0.15)


def rules() -> Similarity:
    return Thresholds().as_arrays(jnp.float64).similarity


def score(*values: float | None) -> Score:
    """One detection, one object; a value per channel."""
    present = np.array([value is not None for value in values])
    filled = np.array([value or 0.0 for value in values])
    return Score(filled[:, None, None], present[:, None, None])


def authority(*values: float) -> Any:
    return np.array(values)[:, None, None]


# The example of method.md#visual-score.
EXAMPLE = {
    "object_work": score(0.86, 0.80), "object_stable": score(0.82, None),
    "authority_work": authority(0.9, 0.5), "authority_stable": authority(0.6, 0.0),
    "rings_work": score(0.70, None), "rings_stable": score(0.66, None),
    "parts_work": score(0.78), "parts_stable": score(0.71),
}  # fmt: skip
QUALITY = Quality(*(np.array([q]) for q in (0.5, 0.5, (0.4 + 0.5 + 2.5 / 3) / 3, DENSE, DENSE)))


@jax.jit
def joint(channels: ChannelScores, t: Similarity) -> tuple[dict[str, Terms], dict[str, Any]]:
    """Terms and visual score under each policy."""
    rules: Any = {
        "auto": similarity._WAYS[AUTO],
        "stable": ("stable",) * 4,
        "work": ("work",) * 4,
        "comparable": similarity._WAYS[similarity._NEUTRAL],
    }
    ways = similarity.collapse(channels, tuple(rules.values()), STATIC, t)
    terms = {
        name: jax.tree.map(lambda leaf, way=way: leaf[way], ways) for way, name in enumerate(rules)
    }
    scores = {
        name: similarity.weighted_mean(
            found.value,
            found.present,
            similarity.term_weights(QUALITY, None if name == "comparable" else found.authority, t),
            t,
        )
        for name, found in terms.items()
    }
    return terms, scores


@pytest.mark.parametrize(
    ("policy", "values", "expected"),
    [
        ("auto", (0.82, 0.66, 0.78), 0.772517),
        ("stable", (0.82, 0.66, 0.71), 0.767330),
        ("work", (0.86, 0.70, 0.78), 0.811172),
        ("comparable", (0.86, 0.70, 0.78), 0.808897),
    ],
)
def test_worked_example(x64, policy, values, expected):
    terms, scores = joint(ChannelScores(**EXAMPLE), rules())
    np.testing.assert_allclose(terms[policy].value[:, 0, 0], values)
    assert float(scores[policy][0, 0]) == pytest.approx(expected, abs=5e-7)  # six decimals given


@pytest.mark.parametrize(
    ("inner", "outer", "expected"),
    [(0.5, 1.0, 0.7), (0.5, None, 0.5), (None, 1.0, 1.0), (None, None, None)],
)
def test_one_ring_alone_counts_in_full(x64, inner, outer, expected):
    rings = similarity._combine_rings(score(inner, outer), STATIC, rules())
    assert bool(rings.present[0, 0]) == (expected is not None)
    assert float(rings.value[0, 0]) == pytest.approx(expected or 0.0)
    even = dataclasses.replace(rules(), inner_share=jnp.zeros(()), outer_share=jnp.zeros(()))
    if inner is not None and outer is not None:
        assert (
            float(similarity._combine_rings(score(inner, outer), STATIC, even).value[0, 0]) == 0.75
        )


@pytest.mark.parametrize(("channel", "value"), [("inner", 0.5), ("outer", 1.0)])
def test_a_chosen_ring_stands_alone(x64, channel, value):
    static = change_static(STATIC, ring_channel=channel)
    rings = similarity._combine_rings(score(0.5, 1.0), static, rules())
    assert float(rings.value[0, 0]) == value


@pytest.mark.parametrize(
    ("channel", "value"), [("best", 0.82), ("global", 0.82), ("trimmed", 0.80)]
)
def test_a_chosen_object_channel_stands_alone(x64, channel, value):
    static = change_static(STATIC, object_channel=channel)
    ways = similarity.collapse(ChannelScores(**EXAMPLE), similarity._WAYS, static, rules())
    terms = jax.tree.map(lambda leaf: leaf[AUTO], ways)
    assert float(terms.value[OBJECT, 0, 0]) == pytest.approx(value)


def bank(prototypes: list[tuple[float, float, float]], **columns: list[float]) -> Bank:
    """One channel, one object, three slots."""
    made = jax.device_put(empty_bank((1, 1), 3, 3, jnp.dtype("float64")))
    embedding = np.zeros((1, 1, 3, 3), np.float32)
    if prototypes:
        embedding[0, 0, : len(prototypes)] = prototypes
    size = jnp.full((1, 1), len(prototypes), jnp.int32)
    made = dataclasses.replace(made, embedding=jnp.asarray(embedding), size=size)
    padded = {name: [*values, *[0] * (3 - len(values))] for name, values in columns.items()}
    return with_records(made, **padded)


X, Y, Z = np.eye(3, dtype=np.float32)


def best_of(made: Bank, vector: np.ndarray, seen: bool = True) -> tuple[float, bool, float]:
    found, won = channel_scores._best_of_bank(
        made, jnp.asarray(vector)[None, None], jnp.array([[seen]]), jnp.int32(5)
    )
    return float(found.value[0, 0, 0]), bool(found.present[0, 0, 0]), float(won[0, 0, 0])


@pytest.mark.parametrize(
    ("source", "channel", "value"),
    [("both", "best", 0.9), ("both", "kmeans", 0.6), ("both", "attention", 0.9),
     ("kmeans", "kmeans", 0.6), ("kmeans", "attention", None)],
)  # fmt: skip
def test_a_chosen_part_channel_stands_alone(x64, source, channel, value):
    """method.md#visual-score; a channel that there is not leaves the term absent."""
    static = change_static(STATIC, part_source=source, part_channel=channel)
    parts = score(0.6, 0.9) if source == "both" else score(0.6)
    known = {**EXAMPLE, "parts_work": parts, "parts_stable": jax.tree.map(np.zeros_like, parts)}
    ways = similarity.collapse(ChannelScores(**known), similarity._WAYS, static, rules())
    terms = jax.tree.map(lambda leaf: leaf[AUTO], ways)
    assert bool(terms.present[PARTS, 0, 0]) == (value is not None)
    assert float(terms.value[PARTS, 0, 0]) == pytest.approx(value or 0.0)


def test_best_prototype_and_how_proven_it_is(x64):
    made = bank(
        [tuple(X), tuple(Y)], hits=[1, 4], quality_sum=[0.5, 2.0], num_qualities=[1, 4],
        quality_recent=[0.4, 0.6],
    )  # fmt: skip
    # Quality 0.6 (recent above mean 0.5), stability 0.6 * 4 / 5: sqrt of the product.
    assert best_of(made, Y) == (1.0, True, pytest.approx(np.sqrt(0.6 * 0.48)))
    assert best_of(made, X) == (1.0, True, pytest.approx(np.sqrt(0.5 * 0.1)))
    assert best_of(made, Z)[:2] == (0.0, True)
    assert best_of(made, (-X - Y) / np.sqrt(2).astype(np.float32))[:2] == (0.0, True)  # clamped


def test_nothing_to_compare_is_absent(x64):
    assert best_of(bank([]), X)[:2] == (0.0, False)
    assert best_of(bank([tuple(X)]), X, seen=False)[:2] == (0.0, False)
    assert best_of(bank([tuple(-X)]), X)[:2] == (0.0, False)  # a cosine of -1


def test_parts_are_a_mean_over_the_best(x64):
    made = bank([tuple(X), tuple(Y)])
    lean = np.array([0.6, 0.0, 0.8], np.float32)

    def mean(*parts: np.ndarray, top: int = 3) -> tuple[float, bool]:
        vectors = np.zeros((1, 1, 4, 3), np.float32)
        vectors[0, 0, : len(parts)] = parts or 0.0
        seen = jnp.arange(4)[None, None] < len(parts)
        found = channel_scores._best_parts(made, jnp.asarray(vectors), seen, top)
        return float(found.value[0, 0, 0]), bool(found.present[0, 0, 0])

    assert mean(X, lean) == (pytest.approx(0.8), True)
    assert mean(X, Y, lean, Z) == (pytest.approx((1 + 1 + 0.6) / 3), True)
    assert mean(X, Y, lean, Z, top=1) == (1.0, True)
    assert mean(Z) == (0.0, True)
    assert mean() == (0.0, False)
