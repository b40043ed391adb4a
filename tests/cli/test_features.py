"""`remind features`, and runs that find what it kept."""

from __future__ import annotations

import json

import pytest

from tests.backbone.networks import converted_file


def facts(outcome) -> dict:
    assert (outcome.code, outcome.stderr) == (0, "")
    return json.loads(outcome.stdout)


def test_features_are_kept_and_found_again(command, scene):
    backbone = f"vit:{converted_file('dinov3_tiny_mlp')}"
    words = ("features", scene[0], "--backbone", backbone, "--cache", "kept", "--json")
    first = facts(command(*words, "--max-frames", 3))
    assert (first["computed"], first["found"]) == (3, 0)
    second = facts(command(*words))
    assert (second["computed"], second["found"]) == (1, 3)
    assert first["fingerprint"] == second["fingerprint"]
    other = facts(command(*words, "--set", "input.max_width_px=128"))
    assert (other["computed"], other["found"]) == (4, 0)


def test_a_run_takes_what_was_kept(command, scene, tmp_path):
    words = (scene[0], "--backbone", "patch-statistics")
    command("features", *words, "--cache", "kept", "--quiet")
    files = {path: path.stat().st_mtime_ns for path in (tmp_path / "kept").rglob("*.npy")}
    assert len(files) == 4
    run = ("run", *words, "--masks", scene[1], "--no-overlay", "--json")
    (tmp_path / "frames.yaml").write_text("tracker: plus\ninput:\n  closeups: never\n")
    run = (*run, "--config", "frames.yaml")
    plain = json.loads(command(*run, "--out", "plain").stdout)
    cached = json.loads(command(*run, "--feature-cache", "kept", "--out", "cached").stdout)
    assert cached["identities"] == plain["identities"] == 3
    assert {p: p.stat().st_mtime_ns for p in (tmp_path / "kept").rglob("*.npy")} == files
    assert (tmp_path / "plain" / "tracks.csv").read_bytes() == (
        tmp_path / "cached" / "tracks.csv"
    ).read_bytes()


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
