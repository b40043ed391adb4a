"""Where looks are clear they decide, whatever stands where: no one is taken for another."""

import jax
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_ID
from remind_jax.static import Static
from tests.plus.frames import detections, motion
from tests.plus.walls import Walk, follow

PER_PLACE, NUM_PLACES, NUM_FRAMES, DIM = 12, 5, 10, 64
STATIC = Static(num_detections=PER_PLACE, num_objects=128, feature_dim=DIM)
GRID = np.array([[0.8 + 1.5 * (k % 4), 0.8 + 1.4 * (k // 4)] for k in range(PER_PLACE)])


@pytest.mark.parametrize("num_classes", [40, 8, 1])
@pytest.mark.parametrize("seed", [0, 1])
def test_places_that_lie_alike_are_told_apart_over_cuts(num_classes, seed):
    rng = np.random.default_rng(seed)
    num = PER_PLACE * NUM_PLACES
    looks = rng.normal(size=(num, DIM))  # nearly orthogonal
    classes = rng.integers(0, num_classes, num)
    order = [*range(NUM_PLACES), *rng.permutation(NUM_PLACES)]
    things = np.repeat(np.array(order), NUM_FRAMES)[:, None] * PER_PLACE + np.arange(PER_PLACE)
    seen = [
        detections(
            GRID + rng.normal(scale=0.01, size=GRID.shape),
            looks[row] + rng.normal(scale=0.1, size=(PER_PLACE, DIM)),
            class_id=classes[row],
        )
        for row in things
    ]
    sightings = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    unknown = jax.tree.map(lambda leaf: np.stack([leaf] * len(things)), motion(score=0.0))
    _, verdicts, _, _ = follow(Walk(sightings, unknown, things), static=STATIC)
    answers = verdicts.answer_id
    last = answers[NUM_FRAMES - 1 :: NUM_FRAMES]
    first, again = (
        dict(zip(things[rows].ravel().tolist(), last[half].ravel().tolist(), strict=True))
        for rows, half in (
            (slice(0, NUM_PLACES * NUM_FRAMES, NUM_FRAMES), slice(0, NUM_PLACES)),
            (slice(NUM_PLACES * NUM_FRAMES, None, NUM_FRAMES), slice(NUM_PLACES, None)),
        )
    )
    assert NO_ID not in first.values()
    assert len(set(first.values())) == num, "each has an identity of its own"
    assert again == first
