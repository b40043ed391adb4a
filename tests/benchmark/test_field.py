"""Absence against recovery: what is counted, what the others get, and what is written."""

import json
import sys

import numpy as np
import pytest

from benchmarks import field
from benchmarks.field_page import write_tables
from benchmarks.field_peers.neutral import identities, read
from benchmarks.field_scoring import judge, pool, truth_of
from benchmarks.field_worlds import COVERED, OTHER, Pictures, Question, Trial, questions

BEFORE, AWAY, AFTER = 4, 5, 6


@pytest.fixture
def trial(tmp_path):
    """Objects 1, 2 and 3 are seen before and after; 4 is met while they are away."""
    num = BEFORE + 1 + AFTER
    instances = np.zeros((num, 8, 16), np.uint8)
    instances[:, 1:3, 1:4], instances[:, 5:7, 1:4], instances[:, 1:3, 8:12] = 1, 2, 3
    instances[BEFORE] = 0
    instances[BEFORE, 2:6, 2:6] = 4
    pictures = np.zeros((num, 8, 16, 3), np.uint8)
    pictures[:] = np.arange(num)[:, None, None, None]
    np.save(tmp_path / "pictures.npy", pictures)
    every = np.arange(num)
    parts = every[:BEFORE], every[BEFORE : BEFORE + 1], every[BEFORE + 1 :]
    seen = Pictures(tmp_path / "pictures.npy", instances, *parts)
    shown = np.concatenate([parts[0], parts[1], np.full(AWAY - 1, COVERED), parts[2]])
    return Trial("three", Question("absence", OTHER, AWAY), seen, shown, BEFORE, BEFORE + AWAY)


def answers(trial, name):
    """Identities of all detections, by a function of frame and instance."""
    truth = truth_of(trial)
    pairs = zip(truth.frame.tolist(), truth.instance.tolist(), strict=True)
    return np.array([name(frame, instance) for frame, instance in pairs])


def scores(trial, name):
    return pool([judge(trial, truth_of(trial), answers(trial, name))])


def test_the_truth_recovers_everything(trial):
    found = scores(trial, lambda frame, instance: instance)
    assert found["returned"] == 3
    assert (found["idf1"], found["recovery"], found["hard"], found["ids"]) == (100, 100, 100, 1)
    assert found["another"] == found["unanswered"] == 0


def test_a_new_name_recovers_nothing_however_long_it_lasts(trial):
    found = scores(trial, lambda frame, who: who + 10 * (frame >= trial.back))
    assert AFTER > BEFORE
    assert (found["recovery"], found["hard"], found["another"]) == (0, 0, 0)
    assert found["ids"] == 7 / 4


def test_who_is_taken_for_another_is_told_apart_from_who_is_new(trial):
    swapped = {1: 2, 2: 1, 3: 30, 4: 4}
    found = scores(trial, lambda frame, who: swapped[who] if frame >= trial.back else who)
    assert found["recovery"] == 0
    assert found["another"] == pytest.approx(200 / 3)


def test_the_others_get_every_frame_and_no_truth(trial, tmp_path):
    truth = truth_of(trial)
    num = len(truth.frame)
    rng = np.random.default_rng(0)
    content = {
        "frame": truth.frame,
        "boxes": rng.uniform(0, 8, (num, 4)).astype(np.float32),
        "scores": np.ones(num, np.float32),
        "classes": np.zeros(num, np.int64),
        "embeddings": rng.normal(size=(num, 5)).astype(np.float32),
        "picture": trial.picture,
        "pictures": str(trial.pictures.file),
        "fps": 10.0,
    }
    np.savez(tmp_path / "three.npz", **content)
    fps, frames = read(tmp_path / "three.npz")
    seen = list(frames)
    assert fps == 10
    assert [len(one) for one in seen] == [len(frame.detections) for frame in trial.frames()]
    np.testing.assert_array_equal(np.concatenate([one.boxes for one in seen]), content["boxes"])
    assert int(seen[1].picture.max()) == 1  # the second picture
    assert int(seen[BEFORE + 1].picture.max()) == 40  # covered
    assert identities(3, [2, 0], [5, 6]).tolist() == [6, -1, 5]


def test_the_page_has_a_place_for_every_table():
    result = {"rows": [], "contenders": {}, "versions": {}, "absent": {}}
    rows = [
        {"varied": q.varied, "world": q.world, "value": q.value, "contender": "x"}
        for q in questions()
    ]
    names = {
        "all",
        "quick",
        "peers",
        *(f"{r['varied']}-{r['world'].replace(' ', '-')}" for r in rows),
    }
    page = field.PAGE.read_text()
    assert {name for name in names if f"<!-- field:{name} -->" in page} == names
    assert set(write_tables(result)) <= names


@pytest.mark.slow
def test_ours_answer_the_quick_form(tmp_path, monkeypatch, capsys):
    words = ["field.py", "--out", str(tmp_path), "--quick", "--peers", "none"]
    monkeypatch.setattr(sys, "argv", words)
    assert field.main() == 0
    result = json.loads((tmp_path / "field.json").read_text())
    overall = {row["contender"]: row for row in result["rows"] if row["varied"] == "all"}
    bank = "bank of 12 + Hungarian, closeups"
    assert set(overall) == {"REMIND plus (default)", "REMIND", bank}
    for row in overall.values():
        assert row["recovery"] > 40
        assert row["hard"] <= row["recovery"]
    assert "frames away" in capsys.readouterr().out
