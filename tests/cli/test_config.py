"""`remind config`."""

import dataclasses

import pytest
import yaml

from remind_jax.config import Config, list_configs, load_config


def test_list_says_what_the_shipped_configurations_are(command):
    lines = command("config", "list").stdout.splitlines()
    assert [line.split()[0] for line in lines] == list_configs()
    assert all(len(line.split("  ")[-1]) > 10 for line in lines)


@pytest.mark.parametrize("backbone", ["patch-statistics", "dinov3-vits16"])
def test_show_prints_what_runs_and_a_file_of_it_runs_the_same(command, tmp_path, backbone):
    words = ("--backbone", backbone, "--set", "similarity.parts_weight=0.1")
    shown = yaml.safe_load(command("config", "show", "remind", *words).stdout)
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump(shown))
    runs = load_config({"base": "remind", "similarity.parts_weight": 0.1}).for_backbone(backbone)
    assert shown == runs.to_dict()
    again = load_config(tmp_path / "mine.yaml")
    assert again == again.for_backbone("patch-statistics") == runs
    assert shown["thresholds"]["similarity"]["parts_weight"] == 0.1
    is_default = backbone == "patch-statistics"
    assert (shown["thresholds"]["matching"]["match"] == 0.7) == is_default
    by_default = yaml.safe_load(command("config", "show", "remind", *words[2:]).stdout)
    assert (by_default == shown) == is_default


def test_describe_takes_sections_and_knows_limits(command):
    outcome = command("config", "describe", "ambiguous", "--config", "remind")
    heads = [line for line in outcome.stdout.splitlines() if not line.startswith(" ")]
    assert len(heads) == len(dataclasses.fields(Config().thresholds.ambiguous))
    assert "  at most 3: an undecided detection names three objects at most" in outcome.stdout


def test_describe_tells_the_value_that_runs(command):
    said = command("config", "describe", "matching.match", "--config", "remind").stdout
    assert said.startswith("thresholds.matching.match: 0.7 ")
    refused = command("config", "describe", "match")
    assert "give --tracker bank" in refused.stderr
    said = command("config", "describe", "match", "--tracker", "bank").stdout
    assert said.startswith("thresholds.match: 0.66 ")


def test_diff_prints_keys_that_differ(command, tmp_path):
    (tmp_path / "mine.yaml").write_text("base: remind\nthresholds: {matching: {match: 0.5}}\n")
    outcome = command("config", "diff", "mine.yaml", "remind")
    runs = load_config("remind").for_backbone("patch-statistics").thresholds.matching.match
    assert outcome.stdout == f"thresholds.matching.match: 0.5 -> {runs}\n"
    assert command("config", "diff", "default").stdout == ""


def test_validate(command, tmp_path):
    (tmp_path / "good.yaml").write_text("input: {close_px: 5}\n")
    (tmp_path / "bad.yaml").write_text("input: {close_pix: 5}\n")
    assert command("config", "validate", "good.yaml", "default").code == 0
    outcome = command("config", "validate", "good.yaml", "bad.yaml")
    assert outcome.code == 1
    assert "bad.yaml" in outcome.stderr
    assert "did you mean 'close_px'" in outcome.stderr


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
