"""From channels to one score (method.md#channel-scores, method.md#visual-score)."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association import similarity
from remind_jax.remind.association.channel_scores import ChannelScores, Score
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import (
    AUTO,
    BACKGROUND,
    OBJECT,
    PARTS,
    Terms,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
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


def parts(*values: float) -> dict[str, Score]:
    work = score(*values)
    return {"parts_work": work, "parts_stable": jax.tree.map(np.zeros_like, work)}


RINGS = {"rings_work": score(0.5, 1.0), "rings_stable": score(None, None)}


@pytest.mark.parametrize(
    ("switches", "known", "term", "value"),
    [
        ({"ring_channel": "inner"}, RINGS, BACKGROUND, 0.5),
        ({"ring_channel": "outer"}, RINGS, BACKGROUND, 1.0),
        ({"object_channel": "best"}, {}, OBJECT, 0.82),
        ({"object_channel": "global"}, {}, OBJECT, 0.82),
        ({"object_channel": "trimmed"}, {}, OBJECT, 0.80),
        ({"part_source": "both", "part_channel": "best"}, parts(0.6, 0.9), PARTS, 0.9),
        ({"part_source": "both", "part_channel": "kmeans"}, parts(0.6, 0.9), PARTS, 0.6),
        ({"part_source": "both", "part_channel": "attention"}, parts(0.6, 0.9), PARTS, 0.9),
        ({"part_source": "kmeans", "part_channel": "kmeans"}, parts(0.6), PARTS, 0.6),
        ({"part_source": "kmeans", "part_channel": "attention"}, parts(0.6), PARTS, None),
    ],
)
def test_a_chosen_channel_stands_alone(x64, switches, known, term, value):
    """method.md#visual-score; a channel that there is not leaves the term absent."""
    channels, static = ChannelScores(**{**EXAMPLE, **known}), change_static(STATIC, **switches)
    ways = similarity.collapse(channels, similarity._WAYS, static, rules())
    assert bool(ways.present[AUTO, term, 0, 0]) == (value is not None)
    assert float(ways.value[AUTO, term, 0, 0]) == pytest.approx(value or 0.0)
