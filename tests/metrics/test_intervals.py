import dataclasses

import numpy as np
import pytest

from remind_jax.metrics.evaluation import evaluate_sequence, scene_intervals, split_by_object
from tests.metrics.golden import load_case
from tests.metrics.tables import count_clear, count_hota, count_identity, random_sequence


@pytest.mark.parametrize("seed", range(8))
def test_objects_and_remainder_add_up(seed: int):
    sequence = random_sequence(seed)
    parts = split_by_object(sequence)
    whole = (count_hota(sequence), count_clear(sequence), count_identity(sequence))
    for (counts, rest), total in zip(parts, whole, strict=True):
        for field in dataclasses.fields(total):
            summed = getattr(counts, field.name).sum(axis=0) + getattr(rest, field.name)
            # Sums of a few dozen ratios in another order.
            np.testing.assert_allclose(summed, getattr(total, field.name), atol=1e-12)


def test_intervals_hold_the_score_and_shrink_with_more_objects():
    few, many = load_case("boxes", "one_switch")[0], load_case("masks", "crowded_12x60")[0]
    evaluation = evaluate_sequence(many)
    intervals, scores = evaluation.intervals(num_resamples=200), evaluation.scores()
    for name in ("HOTA", "IDF1", "MOTA", "AssA"):
        low, high = intervals[name]
        assert low <= scores[name] <= high
        assert 0 < high - low < 0.5
    assert evaluation.intervals(num_resamples=200) == intervals
    assert evaluate_sequence(few).intervals() == {}  # one object only


def test_scenes_are_the_units_where_there_are_several():
    scenes = [evaluate_sequence(random_sequence(seed)) for seed in range(6)]
    low, high = scene_intervals(scenes, num_resamples=300)["IDF1"]
    each = [scene.scores()["IDF1"] for scene in scenes]
    assert min(each) <= low < high <= max(each)
