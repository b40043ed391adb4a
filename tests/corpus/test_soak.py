"""A share of `make soak`, and that it sees what it looks for."""

import dataclasses
import subprocess
import sys

import pytest

from tests.corpus.soak import Figures

FINE = Figures(
    num_objects=160,
    median_ms=5.0,
    worst_ms=20.0,
    worst_frame=300,
    grown_at=(250,),
    num_at_rest=0,
    rss_mib=(500.0, 500.2, 500.1, 500.3, 500.2),
    kib_per_1000=200.0,
)


def test_stalls_and_growth_are_seen():
    assert FINE.failures == []
    stalled = dataclasses.replace(FINE, worst_ms=60.0)
    assert stalled.failures == ["frame 300 took 60.0 ms, the median is 5.00 ms"]
    growing = dataclasses.replace(FINE, kib_per_1000=2000.0)
    assert growing.failures == ["memory grows by 2000 KiB in 1,000 frames"]
    short = dataclasses.replace(growing, rss_mib=(500.0, 502.0))
    assert short.failures == []
    swollen = dataclasses.replace(FINE, rss_mib=(500.0, 506.0))
    assert swollen.failures == ["memory grew from 500.0 to 506.0 MiB"]
    empty = dataclasses.replace(FINE, grown_at=())
    assert dataclasses.replace(empty, num_at_rest=40).failures == []
    (said,) = empty.failures
    assert said.startswith("memory never was full")


@pytest.mark.slow
@pytest.mark.parametrize("config", ["default", "remind"])
def test_a_short_soak_stays_within_bounds(config):
    """In a process of its own: what another test left behind would be freed and used meanwhile."""
    words = ["--frames", "3000", "--config", config]
    finished = subprocess.run(
        [sys.executable, "-m", "tests.corpus.soak", *words],
        capture_output=True,
        text=True,
        timeout=3600,
        check=False,
    )
    assert finished.stdout.splitlines()[-1:] == ["all within bounds"], finished.stderr
    assert finished.returncode == 0
