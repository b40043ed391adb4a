import itertools

import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.errors import ConfigError
from remind_jax.remind.disambiguation.joint_assignments import (
    NUMBERS,
    AssignmentScores,
    GroupStatus,
    list_injections,
    settle,
)

from .scenes import thresholds


@pytest.mark.parametrize(("rows", "columns"), [(2, 2), (3, 4), (4, 5)])
def test_each_leading_choice_occurs_once_and_in_order(rows, columns):
    table, leading = list_injections(rows, columns)
    for used in range(1, rows + 1):
        found = [tuple(row[:used]) for row in table[leading[used]]]
        assert found == list(itertools.permutations(range(columns), used))


def test_too_large_groups_are_refused():
    with pytest.raises(ConfigError, match="group_candidates"):
        list_injections(7, 9)


def settle_rows(*rows, **changes):
    """Settles assignments of (score, core, evidence), and reads the solution."""
    score, core, evidence = jnp.array(rows, jnp.float32).T
    valid, choice = score > -1, jnp.arange(len(rows))[:, None]
    solution = settle(
        AssignmentScores(valid, choice, score, core, evidence), thresholds("float32", **changes)
    )
    numbers = dict(zip(NUMBERS, np.asarray(solution.numbers).tolist(), strict=True))
    return GroupStatus(int(solution.status)), int(solution.choice[0]), numbers


@pytest.mark.parametrize(
    ("rows", "status", "best"),
    [
        ([(-2, 0, 0), (-2, 0, 0)], GroupStatus.NO_ASSIGNMENT, None),
        ([(0.1, 0.1, 0.19), (0.3, 0.3, 0.19)], GroupStatus.LOW_EVIDENCE, 1),
        ([(0.19, 0.15, 0.5), (0.1, 0.3, 0.5)], GroupStatus.LOW_SCORE, 0),
        ([(0.9, 0.3, 0.5), (0.8, 0.31, 0.5)], GroupStatus.VISUAL_RANK_FLIP, 0),
        ([(0.9, 0.17, 0.5), (0.8, 0.1, 0.5)], GroupStatus.LOW_CORE_SCORE, 0),
        ([(0.9, 0.3, 0.5), (0.8, 0.25, 0.5)], GroupStatus.LOW_CORE_GAP, 0),
        # Of equal cores the better score is first, so nothing flips.
        ([(0.8, 0.3, 0.5), (0.9, 0.3, 0.5)], GroupStatus.LOW_CORE_GAP, 1),
        ([(0.9, 0.3, 0.5), (0.85, 0.2, 0.5)], GroupStatus.PARTIAL_RESOLVED, 0),
        ([(0.7, 0.2, 0.5), (0.9, 0.3, 0.5), (0.1, 0.1, 9)], GroupStatus.RESOLVED, 1),
        ([(-2, 0.9, 0.5), (0.5, 0.3, 0.5)], GroupStatus.RESOLVED, 1),
    ],
)
def test_order_of_the_tests(rows, status, best):
    found, choice, numbers = settle_rows(*rows)
    assert found == status
    if best is None:
        assert set(numbers.values()) == {0.0}
    else:
        assert choice == best
        assert numbers["score"] == pytest.approx(rows[best][0])


def test_lead_without_a_runner_up():
    _, _, numbers = settle_rows((0.5, 0.3, 0.5), (-2, 0.0, 0.0))
    assert numbers["second"] == -1
    assert numbers["gap"] == numbers["score"]
    assert numbers["core_gap"] == numbers["core"]
