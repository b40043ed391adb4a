"""From channels to one score (method.md#channel-scores, method.md#visual-score)."""

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.association import similarity
from remind_jax.remind.association.channel_scores import ChannelScores, Score
from remind_jax.remind.association.similarity import AUTO, BACKGROUND, OBJECT, PARTS
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.thresholds.association import Similarity
from tests.statics import change_static, make_static

STATIC = make_static(feature_dim=3)


def rules() -> Similarity:
    return Thresholds().as_arrays(jnp.float64).similarity


Values = tuple[float | None, ...]


def score(work: Values, stable: Values) -> Score:
    """One detection, one object; of either bank a value per channel."""
    values = np.array([work, stable], float)[..., None, None]
    return Score(np.nan_to_num(values), ~np.isnan(values))  # pyright: ignore[reportArgumentType]


# The example of method.md#visual-score.
EXAMPLE = {
    "objects": score((0.86, 0.80), (0.82, None)),
    "authority": np.array([[0.9, 0.5], [0.6, 0.0]])[..., None, None],
    "rings": score((0.70, None), (0.66, None)),
    "parts": score((0.78,), (0.71,)),
}


def parts(*values: float) -> dict[str, Score]:
    return {"parts": score(values, (None,) * len(values))}


RINGS = {"rings": score((0.5, 1.0), (None, None))}


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
    ways = similarity.collapse(channels, static, rules())
    assert bool(ways.present[AUTO, term, 0, 0]) == (value is not None)
    assert float(ways.value[AUTO, term, 0, 0]) == pytest.approx(value or 0.0)
