import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.outputs.ticks import choose_step, frame_steps, time_label, time_steps


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


@pytest.mark.parametrize(
    ("time_s", "step_s", "label"),
    [
        (0, 1, "0:00"),
        (5, 5, "0:05"),
        (80, 20, "1:20"),
        (600, 60, "10:00"),
        (0.5, 0.5, "0:00.5"),
        (59.9999999, 0.5, "1:00.0"),
        (61.25, 0.05, "1:01.25"),
    ],
)
def test_labels_are_minutes_and_seconds(time_s, step_s, label):
    assert time_label(time_s, step_s) == label
