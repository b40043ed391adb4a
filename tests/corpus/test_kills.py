"""A small share of `make kills`, and that it sees what it looks for."""

from __future__ import annotations

import random
import shutil
from pathlib import Path

import pytest

from tests.corpus.kills import Course, compare_runs

NUM_KILLS = 3


@pytest.fixture(scope="module")
def course(tmp_path_factory) -> Course:
    return Course(tmp_path_factory.mktemp("kills"))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["run", "features", "sweep"])
def test_killed_commands_go_on(course, kind):
    case = course.try_kind(kind, NUM_KILLS, random.Random(1))
    assert case.failures == []


def test_a_killed_run_goes_on(course):
    """The cheapest kind; three kills."""
    case = course.try_kind("run of the bank", NUM_KILLS, random.Random(2))
    assert case.failures == []


def test_a_difference_is_seen(course, tmp_path):
    one, _ = course._expect("run of the bank")
    other = Path(shutil.copytree(one, tmp_path / "other"))
    assert compare_runs(one, other) == []
    table = other / "tracks.csv"
    table.write_text(table.read_text().replace("match", "new", 1))
    assert compare_runs(one, other) == ["tracks.csv"]
