"""A small share of `make kills`, and that it sees what it looks for."""

import json
import random
import shutil
import signal
import time
from pathlib import Path

import pytest

from remind_jax.cli import process
from remind_jax.outputs.result import Result
from tests.corpus.kills import KINDS, Course, _count, compare_runs

NUM_KILLS = 3
TERMINATED = 128 + signal.SIGTERM


@pytest.fixture(scope="module")
def course(tmp_path_factory) -> Course:
    return Course(tmp_path_factory.mktemp("kills"))


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGTERM])
@pytest.mark.parametrize("kind", ["run", "sweep"])
def test_stopped_commands_go_on(course, kind, number):
    case = course.try_kind(kind, NUM_KILLS, random.Random(1), number)
    assert case.failures == []


@pytest.mark.heavy
def test_a_killed_run_goes_on(course):
    """The cheapest kind; two kills."""
    case = course.try_kind("run of the bank", 2, random.Random(2))
    assert case.failures == []


@pytest.mark.heavy
def test_a_run_that_is_asked_to_end_ends_well(course):
    """Half-way: what was done is finished, and is gone on with."""
    kind, (expected, _) = KINDS["run of the bank"], course._expect("run of the bank")
    out = course._folder / "asked"
    child = course._start(kind, out)
    while _count(out, kind) < 10 and child.poll() is None:
        time.sleep(0.01)
    child.send_signal(signal.SIGTERM)
    said = child.communicate(timeout=120)[1]
    assert (child.returncode, said) == (TERMINATED, "")
    content = json.loads((out / "run.json").read_text())
    assert not content["complete"]
    assert (out / "report.html").exists()
    assert (out / "checkpoint").exists()
    child = course._start(kind, out)
    assert (child.communicate(timeout=120)[1], child.returncode) == ("", 0)
    assert compare_runs(expected, out) == []


@pytest.mark.slow
@pytest.mark.parametrize(
    "words",
    [
        ("view", "RUN", "--quiet"),
        ("eval", "RUN", "RUN", "--quiet"),
        ("export", "RUN", "--overwrite", "--quiet"),
        ("warmup", "320x240", "--quiet"),
    ],
    ids=lambda words: words[0],
)
def test_verbs_without_results_to_keep_end_at_once(course, words, tmp_path):
    """At any moment: with the exit code of the signal, at most a word, and what was there whole."""
    expected, _ = course._expect("run of the bank")
    run = Path(shutil.copytree(expected, tmp_path / "run"))
    given = [run if word == "RUN" else word for word in words]
    start = time.monotonic()
    child = course.start(*given)
    said = child.communicate(timeout=300)[1]
    assert (child.returncode, said) == (process.FINE, "")
    usual_s = time.monotonic() - start
    for share in (0.4, 0.6, 0.8, 0.95):
        child = course.start(*given)
        time.sleep(share * usual_s)
        child.send_signal(signal.SIGTERM)
        said = child.communicate(timeout=60)[1]
        # A signal may come before the command, when Python itself starts.
        assert child.returncode in (process.FINE, TERMINATED, -signal.SIGTERM), said
        if child.returncode == TERMINATED:
            assert said in ("", "remind: stopped\n")
        assert len(Result.load(run)) == len(Result.load(expected))


@pytest.mark.heavy
def test_a_difference_is_seen(course, tmp_path):
    one, _ = course._expect("run of the bank")
    other = Path(shutil.copytree(one, tmp_path / "other"))
    assert compare_runs(one, other) == []
    table = other / "tracks.csv"
    table.write_text(table.read_text().replace("match", "new", 1))
    assert compare_runs(one, other) == ["tracks.csv"]
