"""`remind config`."""

from __future__ import annotations

import pytest
import yaml

from remind_jax.config import Config, load_config


def test_list_names_the_shipped_configurations(command):
    assert {"default", "published"} <= set(command("config", "list").stdout.split())


def test_show_can_be_read_back(command, tmp_path):
    shown = command("config", "show", "published", "--set", "static.num_objects=7").stdout
    (tmp_path / "mine.yaml").write_text(shown)
    changed = {"static": {"num_objects": 7}}
    assert load_config(tmp_path / "mine.yaml").to_dict() == Config().updated(changed).to_dict()


def test_diff_prints_keys_that_differ(command, tmp_path):
    (tmp_path / "mine.yaml").write_text("base: remind\nthresholds: {matching: {match: 0.5}}\n")
    outcome = command("config", "diff", "mine.yaml", "remind")
    shipped = load_config("remind").thresholds.matching.match
    assert outcome.stdout == f"thresholds.matching.match: 0.5 -> {shipped}\n"
    assert command("config", "diff", "default").stdout == ""


def test_validate(command, tmp_path):
    (tmp_path / "good.yaml").write_text("input: {close_px: 5}\n")
    (tmp_path / "bad.yaml").write_text("input: {close_pix: 5}\n")
    assert command("config", "validate", "good.yaml", "default").code == 0
    outcome = command("config", "validate", "good.yaml", "bad.yaml")
    assert outcome.code == 1
    assert "bad.yaml" in outcome.stderr
    assert "did you mean 'close_px'" in outcome.stderr


def test_validate_needs_a_name(command):
    outcome = command("config", "validate")
    assert (outcome.code, outcome.stdout) == (1, "")
    assert "name the configurations" in outcome.stderr


@pytest.mark.parametrize("to_file", [False, True])
def test_settings_of_the_original_are_imported(command, tmp_path, to_file):
    settings = {"association": {"matching": {"match_thr": 0.65}}}
    (tmp_path / "reference.yaml").write_text(yaml.safe_dump(settings))
    words = ("--out", "mine.yaml") if to_file else ()
    outcome = command("config", "import-reference", "reference.yaml", *words)
    text = (tmp_path / "mine.yaml").read_text() if to_file else outcome.stdout
    assert yaml.safe_load(text) == {
        "base": "published",
        "thresholds": {"matching": {"match": 0.65}},
    }


def test_file_that_cannot_be_written(command, tmp_path):
    (tmp_path / "reference.yaml").write_text("{}")
    outcome = command("config", "import-reference", "reference.yaml", "--out", "no/where.yaml")
    assert (outcome.code, outcome.stderr) == (
        1,
        "remind: cannot write 'no/where.yaml': No such file or directory\n",
    )
