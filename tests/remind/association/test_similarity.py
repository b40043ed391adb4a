"""From channels to one score (method.md#channel-scores, method.md#visual-score)."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association import similarity
from remind_jax.remind.association.channel_scores import ChannelScores, Score
from remind_jax.remind.association.similarity import (
    AUTO,
    BACKGROUND,
    OBJECT,
    PARTS,
)
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
from tests.statics import change_static, make_static

STATIC = make_static(feature_dim=3)


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
