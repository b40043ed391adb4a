"""Features that are kept beside runs, and found again."""

from __future__ import annotations


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
