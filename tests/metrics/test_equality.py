"""Every field of HOTA, CLEAR and Identity equals TrackEval's on every stored case."""

import pytest

from remind_jax.metrics.clear import clear_scores
from remind_jax.metrics.evaluation import evaluate_sequence, pool_evaluations
from remind_jax.metrics.hota import ALPHAS, hota_scores
from remind_jax.metrics.identity import identity_scores
from tests.metrics.golden import ALL_CASES, ROOT, assert_same_fields, load_case, read_json
from tests.metrics.tables import count_clear, count_hota, count_identity, from_frames


@pytest.mark.parametrize(("kind", "name"), ALL_CASES)
def test_fields_equal_trackeval(kind: str, name: str):
    sequence, expected = load_case(kind, name)
    ties = tuple(expected["order_sensitive_fields"])
    assert_same_fields(hota_scores(count_hota(sequence)), expected["HOTA"], but=ties)
    assert_same_fields(clear_scores(count_clear(sequence)), expected["CLEAR"], but=ties)
    assert_same_fields(identity_scores(count_identity(sequence)), expected["Identity"], but=ties)
    fields = evaluate_sequence(sequence).fields()
    assert_same_fields({name: fields[name] for name in expected["Count"]}, expected["Count"])


def test_pooled_masks_equal_trackeval():
    expected = read_json(ROOT / "combined_masks.json")
    sequences = [load_case("masks", name)[0] for name in expected["sequences"]]
    pooled = pool_evaluations([evaluate_sequence(sequence) for sequence in sequences]).fields()
    for family in ("HOTA", "CLEAR", "Identity", "Count"):
        assert_same_fields({name: pooled[name] for name in expected[family]}, expected[family])


def test_a_similarity_on_a_threshold_is_a_match():
    for index, alpha in enumerate(ALPHAS):
        sequence = from_frames([[1]], [[1]], [[[float(alpha)]]])
        assert count_hota(sequence).true_positives.sum() == index + 1


def test_without_truth_one_sequence_and_a_sum_differ_as_in_trackeval():
    counts = count_clear(from_frames([[]], [[1, 2]], [[]]))
    assert clear_scores(counts)["MOTA"] == 0
    assert clear_scores(counts, pooled=True)["MOTA"] == -2
