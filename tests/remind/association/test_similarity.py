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
    BACKGROUND,
    OBJECT,
    PARTS,
    STABLE,
    WORK,
    Comparison,
    Terms,
)
from remind_jax.remind.memory.prototypes import Bank, empty_bank
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
from tests.remind.association.tables import decide_frames, empty_frame, visual_frame
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


def test_weights_of_the_worked_example(x64):
    weights = similarity.term_weights(QUALITY, jnp.array([[0.6]]), rules())[:, 0, 0]
    np.testing.assert_allclose(weights, [0.392795, 0.168750, 0.044938], atol=5e-7)
    weights = similarity.term_weights(QUALITY, None, rules())[:, 0, 0]
    np.testing.assert_allclose(weights, [0.385, 0.168750, 0.044938], atol=5e-7)


def test_absent_terms_do_not_pull_the_score_down(x64):
    only_object = {**EXAMPLE, "parts_work": score(None), "parts_stable": score(None)}
    only_object |= {"rings_work": score(None, None), "rings_stable": score(None, None)}
    terms, scores = joint(ChannelScores(**only_object), rules())
    assert terms["auto"].present[:, 0, 0].tolist() == [True, False, False]
    assert float(scores["auto"][0, 0]) == pytest.approx(0.82)
    plain = dataclasses.replace(rules(), renormalize=jnp.asarray(False))
    assert float(joint(ChannelScores(**only_object), plain)[1]["auto"][0, 0]) == pytest.approx(
        0.82 * 0.392795, abs=1e-6
    )
    nothing = {**only_object, "object_work": score(None, None), "object_stable": score(None, None)}
    terms, scores = joint(ChannelScores(**nothing), rules())
    assert float(scores["auto"][0, 0]) == 0.0
    assert float(terms["auto"].authority[0, 0]) == 1.0


def test_authority_is_that_of_the_winning_prototype(x64):
    terms, _ = joint(ChannelScores(**EXAMPLE), rules())
    assert float(terms["auto"].authority[0, 0]) == 0.6
    assert float(terms["work"].authority[0, 0]) == 0.9
    trimmed = {**EXAMPLE, "object_stable": score(0.79, None)}  # now work of "trimmed" is better
    assert float(joint(ChannelScores(**trimmed), rules())[0]["auto"].authority[0, 0]) == 0.5


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


def compare(frame: Any) -> Comparison:
    verdict = decide_frames([frame])
    return jax.tree.map(lambda leaf: leaf[0], verdict.comparison)


def in_bank(name: str, *values: float | None) -> Score:
    """Scores of the first detection with the first objects, in the first channel."""
    empty = getattr(empty_frame(1, 1).channels, name)
    value, present = empty.value.copy(), empty.present.copy()
    for slot, number in enumerate(values):
        value[0, 0, slot], present[0, 0, slot] = number or 0.0, number is not None
    return Score(value, present)


def test_one_bank_for_all_candidates(x64):
    """Stable if all have it, else work if all have it, else each its own.

    Rule: method.md#bank-source.
    """

    def source(work: tuple, stable: tuple) -> tuple[int, list[float]]:
        frame = empty_frame(1, 2)
        channels = dataclasses.replace(
            frame.channels,
            object_work=in_bank("object_work", *work),
            object_stable=in_bank("object_stable", *stable),
        )
        found = compare(dataclasses.replace(frame, channels=channels))
        return int(found.source[OBJECT, 0]), found.terms.value[OBJECT, 0, :2].tolist()

    assert source((0.9, 0.8), (0.7, 0.6)) == (STABLE, [0.7, 0.6])
    assert source((0.9, 0.8), (0.7, None)) == (WORK, [0.9, 0.8])
    assert source((None, 0.8), (0.7, None)) == (AUTO, [0.7, 0.8])
    assert source((None, 0.8), (0.7, 0.6)) == (STABLE, [0.7, 0.6])


def test_parts_take_the_better_bank_where_no_bank_serves_all(x64):
    frame = empty_frame(1, 2)
    channels = dataclasses.replace(
        frame.channels,
        parts_work=in_bank("parts_work", 0.9, None),
        parts_stable=in_bank("parts_stable", 0.7, None),
    )
    found = compare(dataclasses.replace(frame, channels=channels))
    assert int(found.source[PARTS, 0]) == AUTO
    assert found.terms.value[PARTS, 0, 0] == 0.9
    assert not found.terms.present[PARTS, 0, 1]
    assert not found.terms.present[BACKGROUND, 0].any()


def test_candidates_are_all_objects_of_the_class_and_score_zero_elsewhere(x64):
    frame = visual_frame([{0: 0.9, 1: 0.8}, {2: 0.7}])
    classes = np.where(np.arange(len(frame.object_class)) == 1, 5, frame.object_class)
    found = compare(dataclasses.replace(frame, object_class=classes))
    assert found.candidate[:2, :4].tolist() == [[True, False, True, False]] * 2
    assert not found.candidate[2:].any()
    assert found.score[0, 1] == 0
    np.testing.assert_allclose(found.score[0, [0, 2]], [0.9, 0.3])


def test_scores_of_a_set_are_compared_on_common_evidence(x64):
    frame = visual_frame([{0: 0.9, 1: 0.8}])
    rings = in_bank("rings_work", 0.5, None)
    frame = dataclasses.replace(
        frame, channels=dataclasses.replace(frame.channels, rings_work=rings)
    )
    found = jax.tree.map(jnp.asarray, compare(frame))
    assert float(found.score[0, 0]) == pytest.approx((0.6 * 0.9 + 0.25 * 0.5) / 0.85)

    def scores(*slots: int) -> list[float]:
        members = jnp.zeros_like(found.candidate).at[0, jnp.array(slots)].set(True)
        return similarity.comparable_score(found, members, rules())[0, :2].tolist()

    assert scores(0, 1) == pytest.approx([0.9, 0.8])
    assert scores(0)[0] == pytest.approx(float(found.score[0, 0]))
