"""Features that are kept beside runs, and found again."""

from __future__ import annotations

import json

import pytest

from tests.backbone.networks import converted_file


def test_closeups_are_kept_as_runs_go(command, scene, tmp_path):
    run = ("run", scene[0], "--masks", scene[1], "--no-overlay", "--json")
    command(*run, "--out", "plain")
    tables = [(tmp_path / "plain" / "tracks.csv").read_bytes()]
    kept = []
    for name in ("first", "second"):
        command(*run, "--feature-cache", "kept", "--out", name)
        tables.append((tmp_path / name / "tracks.csv").read_bytes())
        files = (tmp_path / "kept").rglob("*.npy")
        kept.append({path: path.stat().st_mtime_ns for path in files})
    assert len(set(tables)) == 1
    assert kept[0] == kept[1]
    assert kept[0]


@pytest.mark.slow
def test_a_run_with_a_transformer(command, scene):
    weights = converted_file("dinov3_s16")
    words = ("run", scene[0], "--masks", scene[1], "--no-overlay", "--json")
    outcome = command(*words, "--backbone", "dinov3-vits16", "--weights", weights)
    summary = json.loads(outcome.stdout)
    assert (summary["frames"], summary["complete"]) == (4, True)
