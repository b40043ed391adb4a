"""`remind sweep` writes its tables, keeps to what was asked, and refuses in one sentence."""

import csv
import dataclasses
import json
import math
import re

import pytest

from remind_jax.cli import process
from tests.sweeps.fake_bench import FakeBench, hill


@pytest.fixture
def benches(monkeypatch):
    """Benches that the command opened, with the options that it opened them with."""
    opened = []

    def open_bench(scenes, **options):
        tracker = {"bank": "bank", "remind": "remind"}.get(options["config"], "plus")
        bench = FakeBench(hill, tuple("abcdef"[: len(scenes)]), tracker=tracker)
        options["out"].mkdir(parents=True, exist_ok=True)
        opened.append((bench, options))
        return bench

    monkeypatch.setattr("remind_jax.sweeps.bench.SceneBench", open_bench)
    return opened


def test_grid_writes_table_and_summary(benches, command, tmp_path):
    space = ("matching.match=0.5:0.8:0.1", "influence.enabled=false,true")
    words = ("sweep", "a", "b", "--set", *space, "-o", "out", "--memory-gib", 1, "--batch", 4)
    outcome = command(*words)
    assert outcome.code == process.FINE
    bench, options = benches[0]
    assert (options["memory_gib"], options["batch"], options["workers"]) == (1.0, 4, None)
    assert bench.asked[0][0] == {}
    rows = list(csv.DictReader((tmp_path / "out/rows.csv").read_text().splitlines()))
    assert len(rows) == (1 + 4 * 2) * 2
    summary = (tmp_path / "out/summary.md").read_text()
    for said in ("9 settings on 2 scenes", "scene held out", "as it stands"):
        assert said in summary
    assert "0.7" in outcome.stdout


@pytest.mark.parametrize("sensitivity", [(), ("--sensitivity", "--number", 2)])
@pytest.mark.parametrize("known", ["a", ""])
def test_what_no_other_scene_has_a_score_for_is_written_all_the_same(
    benches, command, tmp_path, monkeypatch, known, sensitivity
):
    run = FakeBench.run

    def run_few(bench, settings):
        result = run(bench, settings)
        rows = tuple(tuple(_only(row, known) for row in of_setting) for of_setting in result.rows)
        return dataclasses.replace(result, rows=rows)

    monkeypatch.setattr(FakeBench, "run", run_few)
    words = ("sweep", "a", "b", "--set", "matching.match=0.5,0.7", "-o", "out", *sensitivity)
    outcome = command(*words, "--metric", "HardRecovery")
    assert outcome.code == process.FINE
    assert (tmp_path / "out/rows.csv").exists()
    summary = (tmp_path / "out/summary.md").read_text()
    assert "nan" not in summary
    assert ("No scene has a HardRecovery to choose by." in summary) is (not known)
    if not sensitivity:
        assert "Not possible: no scene but 'a' has a HardRecovery" in summary


def _only(row, known):
    score = row.scores["IDF1"] if row.scene == known else math.nan
    return dataclasses.replace(row, scores={**row.scores, "HardRecovery": score})


def test_json_holds_the_best_and_the_front(benches, command):
    outcome = command("sweep", "a", "--set", "matching.match=0.5:0.8:0.1", "--json")
    facts = json.loads(outcome.stdout, parse_constant=pytest.fail)  # no NaN
    assert (outcome.code, facts["settings"]) == (process.FINE, 5)
    assert facts["best"][0]["setting"] == {"matching.match": 0.7}
    assert facts["as_it_stands"][0]["setting"] == {}
    assert facts["pareto"]
    assert facts["complete"] is True


def test_random_settings_lie_in_the_range(benches, command):
    words = ("sweep", "a", "--set", "matching.match=0.5,0.9", "--random", 20, "--seed", 3)
    assert command(*words, "--quiet").code == process.FINE
    given, *drawn = benches[0][0].asked[0]
    assert given == {}
    assert len({s["matching.match"] for s in drawn}) == 20
    assert all(0.5 <= s["matching.match"] <= 0.9 for s in drawn)


def test_settings_come_from_a_file(benches, command, tmp_path):
    (tmp_path / "mine.csv").write_text("matching.match,influence.enabled\n0.6,true\n0.7,false\n")
    assert command("sweep", "a", "--settings", "mine.csv", "--quiet").code == process.FINE
    assert benches[0][0].asked[0][1:] == [
        {"matching.match": 0.6, "influence.enabled": True},
        {"matching.match": 0.7, "influence.enabled": False},
    ]


@pytest.mark.parametrize("method", ["tpe", "nsga2"])
def test_search_proposes_settings(benches, command, method):
    pytest.importorskip("optuna")
    words = ("sweep", "a", "b", "--set", "matching.match=0.3,1.0", "--search", method, "--quiet")
    assert command(*words, "--number", 9, "--at-once", 3).code == process.FINE
    bench, options = benches[0]
    assert options["keep_scenes"]
    assert len(bench.asked) >= 3


@pytest.mark.parametrize(
    ("config", "named"), [("default", "decision.new"), ("remind", "matching.match")]
)
def test_sensitivity_has_thresholds_of_its_own(benches, command, config, named):
    outcome = command("sweep", "a", "--config", config, "--sensitivity", "--number", 3)
    assert outcome.code == process.FINE
    cells = re.split(r"[|│]", outcome.stdout)
    assert named in [cell.strip() for cell in cells]


def test_a_tracker_without_usual_ranges_has_no_sensitivity(benches, command):
    outcome = command("sweep", "a", "--config", "bank", "--sensitivity")
    assert outcome.code == process.ERROR
    assert "no usual ranges for thresholds of 'bank'" in outcome.stderr
