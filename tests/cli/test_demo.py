"""`remind demo`, on a tour of four small frames; the real one is a slow test."""

import dataclasses
import json
from pathlib import Path

import pytest

import remind_jax.synthetic
from remind_jax.outputs.result import Result
from remind_jax.synthetic import SceneOptions, demo_options


@pytest.fixture
def short_tour(monkeypatch):
    options = SceneOptions(
        name="demo", num_rooms=1, objects_per_room=3, frames=4, absence_frames=0,
        width=256, height=192, min_mask_px=400,
    )  # fmt: skip
    monkeypatch.setattr(
        remind_jax.synthetic, "demo_options", lambda seed: dataclasses.replace(options, seed=seed)
    )


@pytest.mark.usefixtures("short_tour")
def test_demo_prints_what_was_recovered(command):
    words = ("demo", "--out", "tour")
    outcome = command(*words)
    assert (outcome.code, outcome.stderr) == (0, "")
    assert "demo: 4 frames" in outcome.stdout
    assert "IDF1" in outcome.stdout
    result = Result.load("tour")
    assert result.info.config["tracker"] == "plus"
    compared = {name: found for name, found, _, _ in result.comparison}
    assert compared["returns"] == str(result.summary()["returns"])
    assert f"{compared['returns']} returns" in outcome.stdout
    page = Path("tour", "report.html").read_text(encoding="utf-8")
    assert json.dumps(result.comparison[0], separators=(",", ":")) in page
    assert command("run", "tour/scene", "--out", "again", "--quiet").code == 0
    for one, other in zip(result.tracks, Result.load("again").tracks, strict=True):
        assert one.object_id.tolist() == other.object_id.tolist()
    again = command(*words, "--json", "--seed", 1)
    facts = json.loads(again.stdout)
    assert facts["frames"] == 4
    assert 0 <= facts["metrics"]["IDF1"] <= 1


@pytest.mark.usefixtures("short_tour")
def test_demo_of_another_configuration(command, tmp_path):
    (tmp_path / "bank.yaml").write_text("base: default\ntracker: bank\n")
    assert command("demo", "--out", "tour", "--quiet", "--config", "bank.yaml").code == 0
    assert Result.load("tour").info.config["tracker"] == "bank"


@pytest.mark.usefixtures("short_tour")
def test_folder_of_somebody_else_is_left_alone(command, tmp_path):
    (tmp_path / "tour").mkdir()
    (tmp_path / "tour" / "notes.txt").write_text("mine")
    outcome = command("demo", "--out", "tour")
    assert outcome.code == 1
    assert "not empty" in outcome.stderr
    assert [path.name for path in (tmp_path / "tour").iterdir()] == ["notes.txt"]


@pytest.mark.slow
def test_the_real_demo_recovers_identities(command):
    facts = json.loads(command("demo", "--json").stdout)
    assert facts["frames"] == demo_options().frames == 120
    assert facts["metrics"]["IDF1"] >= 0.97
