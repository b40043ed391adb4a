import dataclasses

import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.sources.sampling import Sampling


@dataclasses.dataclass(frozen=True)
class Item:
    source_index: int
    time_s: float


def chosen(sampling, num):
    items = [Item(i, i / 30) for i in range(num)]
    return [item.source_index for item in sampling.select(items)]


def test_range_and_stride():
    assert chosen(Sampling(stride=3, start=2, end=12), 20) == [2, 5, 8, 11]
    assert chosen(Sampling(start=3, max_frames=2), 20) == [3, 4]


def test_rate_follows_time_stamps():
    assert chosen(Sampling(fps=20), 10) == [0, 2, 3, 5, 6, 8, 9]
    assert chosen(Sampling(fps=1000), 7) == list(range(7))
    uneven = [Item(i, t) for i, t in enumerate([0.0, 0.1, 0.2, 0.9, 1.0, 2.5])]
    assert [i.source_index for i in Sampling(fps=1).select(uneven)] == [0, 4, 5]


@pytest.mark.parametrize("sampling", [Sampling(end=3), Sampling(max_frames=3)])
def test_nothing_is_asked_for_beyond_the_last(sampling):
    def endless():
        for index in range(3):
            yield Item(index, index / 30)
        pytest.fail("one frame too many was decoded")

    assert len(list(sampling.select(endless()))) == 3


@given(
    num=st.integers(0, 60),
    stride=st.integers(1, 7),
    start=st.integers(0, 20),
    length=st.none() | st.integers(1, 60),
    fps=st.none() | st.sampled_from([0.5, 1, 3, 7.5, 10, 24, 29.97, 30, 60]),
    max_frames=st.none() | st.integers(1, 30),
)
def test_count_says_how_many_are_selected(num, stride, start, length, fps, max_frames):
    sampling = Sampling(
        fps=fps,
        stride=1 if fps else stride,
        start=start,
        end=None if length is None else start + length,
        max_frames=max_frames,
    )
    assert sampling.count(num, 30.0) == len(chosen(sampling, num))


def test_rate_after_sampling_and_what_is_not_known():
    assert Sampling().count(None, 30.0) is None
    assert Sampling(fps=5).count(100, None) is None
    assert Sampling(stride=3).rate(30.0) == 10.0
    assert Sampling(fps=5).rate(30.0) == 5
    assert Sampling(fps=50).rate(30.0) == 30.0
    assert Sampling().rate(None) is None
