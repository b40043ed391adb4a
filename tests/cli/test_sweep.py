"""`remind sweep` writes its tables, keeps to what was asked, and refuses in one sentence."""

import csv
import json
import re

import pytest

from remind_jax.cli import process
from remind_jax.cli.main import main
from tests.sweeps.fake_bench import FakeBench, hill


@pytest.fixture
def benches(monkeypatch, tmp_path):
    """Benches that the command opened, with the options that it opened them with."""
    opened = []

    def open_bench(scenes, **options):
        tracker = {"bank": "bank", "remind": "remind"}.get(options["config"], "plus")
        bench = FakeBench(hill, tuple("abcdef"[: len(scenes)]), tracker=tracker)
        options["out"].mkdir(parents=True, exist_ok=True)
        opened.append((bench, options))
        return bench

    monkeypatch.setattr("remind_jax.sweeps.bench.SceneBench", open_bench)
    monkeypatch.chdir(tmp_path)
    return opened


def test_grid_writes_table_and_summary(benches, capsys, tmp_path):
    space = ("matching.match=0.5:0.8:0.1", "influence.enabled=false,true")
    words = ["sweep", "a", "b", "--set", *space]
    assert main([*words, "-o", "out", "--memory-gib", "1", "--batch", "4"]) == process.FINE
    bench, options = benches[0]
    assert (options["memory_gib"], options["batch"], options["workers"]) == (1.0, 4, None)
    assert bench.asked[0][0] == {}
    rows = list(csv.DictReader((tmp_path / "out/rows.csv").read_text().splitlines()))
    assert len(rows) == (1 + 4 * 2) * 2
    summary = (tmp_path / "out/summary.md").read_text()
    assert "9 settings on 2 scenes" in summary
    assert "scene held out" in summary
    assert "as it stands" in summary
    assert "0.7" in capsys.readouterr().out


def test_json_holds_the_best_and_the_front(benches, capsys):
    assert main(["sweep", "a", "--set", "matching.match=0.5:0.8:0.1", "--json"]) == process.FINE
    facts = json.loads(capsys.readouterr().out, parse_constant=pytest.fail)  # no NaN
    assert facts["settings"] == 5
    assert facts["best"][0]["setting"] == {"matching.match": 0.7}
    assert facts["as_it_stands"][0]["setting"] == {}
    assert facts["pareto"]
    assert facts["complete"] is True


def test_random_settings_lie_in_the_range(benches):
    words = ["sweep", "a", "--set", "matching.match=0.5,0.9", "--random", "20", "--seed", "3"]
    assert main([*words, "--quiet"]) == process.FINE
    given, *drawn = benches[0][0].asked[0]
    assert given == {}
    assert len({s["matching.match"] for s in drawn}) == 20
    assert all(0.5 <= s["matching.match"] <= 0.9 for s in drawn)


def test_settings_come_from_a_file(benches, tmp_path):
    (tmp_path / "mine.csv").write_text("matching.match,influence.enabled\n0.6,true\n0.7,false\n")
    assert main(["sweep", "a", "--settings", "mine.csv", "--quiet"]) == process.FINE
    assert benches[0][0].asked[0][1:] == [
        {"matching.match": 0.6, "influence.enabled": True},
        {"matching.match": 0.7, "influence.enabled": False},
    ]


@pytest.mark.parametrize("method", ["tpe", "nsga2"])
def test_search_proposes_settings(benches, method):
    pytest.importorskip("optuna")
    words = ["sweep", "a", "b", "--set", "matching.match=0.3,1.0", "--search", method, "--quiet"]
    assert main([*words, "--number", "9", "--at-once", "3"]) == process.FINE
    bench, options = benches[0]
    assert options["keep_scenes"]
    assert len(bench.asked) >= 3


@pytest.mark.parametrize(
    ("config", "named"), [("default", "decision.new"), ("remind", "matching.match")]
)
def test_sensitivity_has_thresholds_of_its_own(benches, capsys, config, named):
    words = ["sweep", "a", "--config", config, "--sensitivity", "--number", "3"]
    assert main(words) == process.FINE
    cells = re.split(r"[|│]", capsys.readouterr().out)
    assert named in [cell.strip() for cell in cells]


def test_a_tracker_without_usual_ranges_has_no_sensitivity(benches, capsys):
    assert main(["sweep", "a", "--config", "bank", "--sensitivity"]) == process.ERROR
    assert "no usual ranges for thresholds of 'bank'" in capsys.readouterr().err
