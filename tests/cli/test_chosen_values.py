"""What is set on the command line is what runs, what is told, and what a sweep found."""

import csv
import json

import pytest

from remind_jax.config import Config, load_config
from remind_jax.config.dotted_keys import flatten, flatten_fields
from remind_jax.errors import SourceError
from remind_jax.metrics import evaluate_tracks
from remind_jax.outputs.result import Result
from remind_jax.session.live import Tracker
from tests.cli import scenes

NUM, AWAY = 16, range(6, 12)  # frames; those in which nothing is in view


@pytest.fixture
def visits(tmp_path):
    """Three objects that leave and come back."""
    return scenes.write_scene(tmp_path / "visits", NUM, seen=dict.fromkeys(AWAY, ()))


@pytest.fixture
def only_started(monkeypatch):
    """Runs that end before the first frame is tracked; what they are made with is written."""

    def stop(self, prepared):
        raise SourceError("enough")

    monkeypatch.setattr(Tracker, "advance", stop)


def told(out) -> dict:
    """Values by key that a run says it is made with."""
    info = json.loads((out / "run.json").read_text())["info"]
    return dict(flatten(info["config"]))


@pytest.mark.usefixtures("only_started")
def test_published_values_that_are_set_run(command, scene, tmp_path):
    """All that the profile of the default backbone changes, and others."""
    profile = load_config("remind").for_backbone("patch-statistics")
    keys = [key for key, _, _ in profile.difference(load_config("remind"))]
    others = ("matching.lock_score", "lifecycle.confirm_hits", "diagnosis.close")
    keys += [f"thresholds.{key}" for key in others]
    assert len(set(keys)) == len(keys) == 18
    published = dict(flatten(Config().to_dict()))
    words = [f"{key.removeprefix('thresholds.')}={published[key]}" for key in keys]
    run = ("run", scene[0], "--masks", scene[1], "--no-overlay", "--config", "remind")
    assert command(*run, "--out", "plain").code == 1
    assert command(*run, "--out", "set", "--set", *words).code == 1
    plain, chosen = told(tmp_path / "plain"), told(tmp_path / "set")
    assert {key: chosen[key] for key in keys} == {key: published[key] for key in keys}
    assert plain["thresholds.matching.match"] == 0.7
    assert {key for key in plain if plain[key] != chosen[key]} < set(keys)


@pytest.mark.usefixtures("only_started")
def test_a_sweep_tries_what_a_run_runs_with(command, scene, tmp_path, monkeypatch):
    """Also where a value is the published one, which the profile of the backbone would change."""
    tried = []

    def keep(frames, config, settings, static, batch, budget):
        tried.extend(config.updated({"thresholds": setting}).thresholds for setting in settings)
        raise KeyboardInterrupt

    monkeypatch.setattr("remind_jax.sweeps.worker.describe_scene", lambda *given: None)
    monkeypatch.setattr("remind_jax.sweeps.worker.run_batch", keep)
    words = ("--config", "remind", "--set", "matching.match=0.75,0.5")
    sweep = ("sweep", scene[0], "--masks", scene[1], *words, "--batch", 3)
    assert command(*sweep).code == 130
    for number, values in enumerate([(), ("matching.match=0.75",), ("match=0.5",)]):
        run = ("run", scene[0], "--masks", scene[1], "--no-overlay", "--config", "remind")
        command(*run, "--out", f"run{number}", *(("--set", *values) if values else ()))
        runs = told(tmp_path / f"run{number}")
        swept = {f"thresholds.{key}": value for key, value in flatten_fields(tried[number])}
        assert swept == {key: runs[key] for key in swept}


@pytest.mark.parametrize(
    ("config", "key", "values"),
    [
        ("iou.yaml", "min_iou", ("0.1", "0.99")),
        pytest.param("default", "linking.least", ("-2.0", "50.0"), marks=pytest.mark.heavy),
        pytest.param("remind", "matching.match", ("0.75", "1.0"), marks=pytest.mark.slow),
    ],
)
def test_a_row_is_the_run_with_these_values(command, visits, tmp_path, config, key, values):
    (tmp_path / "iou.yaml").write_text("tracker: iou\n")
    words = (visits[0], "--masks", visits[1], "--config", config)
    sweep = ("sweep", *words, "--set", f"{key}={','.join(values)}", "-o", "swept", "--quiet")
    assert command(*sweep).code == 0
    rows = list(csv.DictReader((tmp_path / "swept" / "rows.csv").read_text().splitlines()))
    found = {row[key]: float(row["IDF1"]) for row in rows if row[key]}
    assert len(set(found.values())) == len(values), "the values must really differ"
    for value in values:
        run = ("run", *words, "--no-overlay", "--quiet", "--out", value)
        assert command(*run, "--set", f"{key}={value}").code == 0
        assert told(tmp_path / value)[f"thresholds.{key}"] == float(value)
        scores = evaluate_tracks(Result.load(tmp_path / value).tracks).scores()
        # Scores of a sweep are made in single precision.
        assert found[value] == pytest.approx(scores["IDF1"], abs=1e-5)
