import dataclasses
import itertools

from hypothesis import given
from hypothesis import strategies as st

from remind_jax.decision import Outcome
from remind_jax.outputs.presence import join_positions
from remind_jax.outputs.report import report_data, spans_with
from tests.outputs.fake_run import make_run


def test_rows_follow_first_sight():
    _, result = make_run(30)
    late_first = dataclasses.replace(result, tracks=result.tracks[10:])  # 1, 3, 5 come back at 20
    shown = report_data(late_first, [], None)["identities"]
    assert [row["id"] for row in shown] == [0, 2, 4, 3, 5, 1]


def test_runs_absences_and_doubt():
    _, result = make_run(30)
    rows = result.objects()
    row = rows[1]
    assert row.seen == ((0, 9), (23, 29))
    assert row.absences == ((10, 22),)
    assert row.returns == (23,)
    assert row.candidate == ((20, 22),)
    assert rows[0].candidate == ((20, 22),)
    assert rows[4].absences == ()  # one frame is flicker
    assert spans_with(result, Outcome.AMBIGUOUS) == ((20, 22),)
    assert spans_with(result, Outcome.PROVISIONAL_NEW) == ((20, 20),)


@given(st.lists(st.integers(0, 60)))
def test_spans_hold_all_positions_and_touch_nowhere(positions):
    spans = join_positions(sorted(positions))
    assert [p for first, last in spans for p in range(first, last + 1)] == sorted(set(positions))
    assert all(one[1] + 1 < other[0] for one, other in itertools.pairwise(spans))
