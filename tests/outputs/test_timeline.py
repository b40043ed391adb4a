import dataclasses
import itertools

import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.decision import Outcome
from remind_jax.outputs.presence import join_positions
from remind_jax.outputs.report import (
    by_first_sight,
    frame_steps,
    spans_with,
    time_steps,
)
from tests.outputs.fake_run import make_run


def choose_step(length: float, steps) -> float:
    """As the page does: the smallest step with at most twelve ticks."""
    return next(step for step in steps if length <= 12 * step)


def test_rows_follow_first_sight():
    _, result = make_run(30)
    late_first = dataclasses.replace(result, tracks=result.tracks[10:])  # 1, 3, 5 come back at 20
    assert [row.object_id for row in by_first_sight(late_first)] == [0, 2, 4, 3, 5, 1]


def test_runs_absences_and_doubt():
    _, result = make_run(30)
    rows = by_first_sight(result)
    row = rows[1]
    assert row.seen == ((0, 9), (23, 29))
    assert row.absences == ((10, 22),)
    assert row.returns == (23,)
    assert row.candidate == ((20, 22),)
    assert rows[0].candidate == ((20, 22),)
    assert rows[4].absences == ()  # one frame is flicker
    assert spans_with(result, Outcome.AMBIGUOUS) == ((20, 22),)
    assert spans_with(result, Outcome.PROVISIONAL_NEW) == ((20, 20),)


@given(st.integers(0, 1_000_000))
def test_steps_of_frames_are_round_and_few(num_frames):
    step = choose_step(num_frames, frame_steps(num_frames))
    assert str(step).rstrip("0") in {"1", "2", "5"}
    assert num_frames / step <= 12
    assert step == 1 or num_frames / step > 12 / 2.5  # no step that is smaller would do


@given(st.floats(0.01, 1_000_000))
def test_steps_of_time_are_round_seconds_or_minutes(duration_s):
    step = choose_step(duration_s, time_steps(duration_s))
    unit = 60 if step >= 60 else 1
    assert f"{step / unit:.0e}"[0] in {"1", "2", "5"}
    assert float(f"{step / unit:.0e}") == pytest.approx(step / unit, rel=1e-12)
    assert duration_s / step <= 12
    assert duration_s / step > 12 / 3.0001  # from 20 s to a minute it is three times


def test_from_half_a_minute_on_steps_are_minutes():
    steps = time_steps(1000.0)
    assert 20 in steps
    assert 50 not in steps
    assert [step for step in steps if step > 20] == [60, 120, 300, 600, 1200]


@given(st.lists(st.integers(0, 60)))
def test_spans_hold_all_positions_and_touch_nowhere(positions):
    spans = join_positions(sorted(positions))
    assert [p for first, last in spans for p in range(first, last + 1)] == sorted(set(positions))
    assert all(one[1] + 1 < other[0] for one, other in itertools.pairwise(spans))
