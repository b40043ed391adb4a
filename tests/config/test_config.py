import dataclasses
from typing import Any

import numpy as np
import pytest
import yaml

from benchmarks.plus import BARE, LADDER
from remind_jax.config import Config, list_configs, load_config
from remind_jax.config.dotted_keys import flatten, nest
from remind_jax.errors import ConfigError
from remind_jax.method import get_method
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.remind.thresholds import Thresholds
from remind_jax.static import Static


def test_default_is_plus_and_published_is_the_plain_config_that_follows_no_profile():
    assert load_config("published") == Config() == Config().for_backbone("patch-statistics")
    changed = load_config("default").difference(load_config("plus"))
    assert changed == [("backbone_profile", True, False)]
    assert load_config("default").thresholds == PlusThresholds()


def test_remind_differs_from_published_where_users_need_it():
    changed = load_config("remind").difference(load_config("published"))
    keys = [
        "input.ignored_classes",
        "thresholds.similarity.nominal_if_silent",
        "thresholds.matching.one_detection_each",
        "thresholds.update.keep_first",
        "backbone_profile",
    ]
    assert [key for key, _, _ in changed] == keys


BACKBONE = "patch-statistics"
WITH_PROFILE = ("remind", "bank", "momentum", "running-mean")


@pytest.mark.parametrize("match", [0.8, 0.75])
def test_a_profile_fills_in_what_nobody_chose(match):
    """0.75 is the published value: who writes it down has chosen it."""
    mine = load_config({"base": "remind", "thresholds": {"matching": {"match": match}}})
    config = mine.for_backbone(BACKBONE)
    assert config.thresholds.matching.match == match
    assert config.thresholds.appearance.patches_min == 4.0
    assert config.for_backbone(BACKBONE) == config
    assert mine.for_backbone("dinov3-vits16") == mine


@pytest.mark.parametrize("tracker", WITH_PROFILE)
def test_every_threshold_set_to_its_published_value_runs_with_it(tracker):
    default = load_config("default").with_tracker(tracker)
    published = Config(tracker=tracker, thresholds=get_method(tracker).settings())
    profile = {key for key, _, _ in default.for_backbone(BACKBONE).difference(default)}
    assert profile
    values = dict(flatten(published.to_dict()["thresholds"]))
    keys = [key for key in values if f"thresholds.{key}" in profile]
    for key in [*keys, *list(values)[::40]]:
        value = values[key]
        config = default.updated({key: value}).for_backbone(BACKBONE)
        told = dict(flatten(config.to_dict()["thresholds"]))
        assert told[key] == value, key
        left = {f"thresholds.{name}" for name in told if told[name] != values[name]}
        assert profile - left == profile & {f"thresholds.{key}"}
    everything = default.updated({"thresholds": nest(values)})
    assert everything.for_backbone(BACKBONE).thresholds == published.thresholds


def test_what_a_shipped_configuration_says_is_chosen(tmp_path):
    """Though it is the published value, and whatever starts from it."""
    (tmp_path / "mine.yaml").write_text(
        "base: remind\nthresholds: {similarity: {parts_weight: 0.1}}"
    )
    for start in (tmp_path / "mine.yaml", {"base": str(tmp_path / "mine.yaml"), "input": {}}):
        config = load_config(start)
        assert Thresholds().similarity.parts_weight == 0.1
        assert config.for_backbone(BACKBONE).thresholds.similarity.parts_weight == 0.1
    assert load_config("remind").for_backbone(BACKBONE).thresholds.similarity.parts_weight == 0.3


def test_values_of_a_configuration_made_in_python_are_chosen_where_they_differ():
    matching = dataclasses.replace(Thresholds().matching, match=0.8)
    made = Config(thresholds=dataclasses.replace(Thresholds(), matching=matching))
    config = dataclasses.replace(made, backbone_profile=True).for_backbone(BACKBONE)
    assert config.thresholds.matching.match == 0.8
    assert config.thresholds.appearance.patches_min == 4.0


def test_the_record_of_what_was_chosen_is_no_value():
    config = load_config({"decision.new": 0.8})
    assert "thresholds.decision.new" in config.chosen
    assert config == load_config("default")
    assert "chosen" not in config.to_dict()


def test_another_tracker_keeps_what_was_chosen_of_the_rest():
    config = load_config({"decision.new": 1.0, "input": {"open_px": 0}}).with_tracker("remind")
    assert "input.open_px" in config.chosen
    assert "thresholds.decision.new" not in config.chosen
    assert "thresholds.matching.one_detection_each" in config.chosen


@pytest.mark.parametrize(
    "values",
    [
        {"thresholds": {"matching": {"match": 0.6}}},
        {"matching": {"match": 0.6}},
        {"matching.match": 0.6},
        {"thresholds.matching": {"match": 0.6}},
        {"match": 0.6},
    ],
)
def test_thresholds_may_go_without_their_prefix(values, tmp_path):
    (tmp_path / "mine.yaml").write_text(yaml.safe_dump({"base": "remind", **values}))
    for config in (load_config({"base": "remind", **values}), load_config(tmp_path / "mine.yaml")):
        assert config.thresholds.matching.match == 0.6
        assert {"thresholds.matching.match"} == config.chosen - load_config("remind").chosen


# Steps of the ladder of benchmarks/plus.py that an ablation of plus takes away.
ABLATED = {
    "no_layout": ["+ layout"],
    "no_place": ["+ place"],
    "no_companions": ["+ companions"],
    "no_background": ["+ background"],
    "no_whitening": ["+ whitening"],
    "no_calibration": ["+ calibration"],
    "no_familiarity": ["+ familiarity", "+ familiarity of what is in view"],
}


def test_an_ablation_of_plus_takes_steps_of_the_ladder_away():
    for name, steps in ABLATED.items():
        bare = {}
        for step in steps:
            for group, values in dict(LADDER)[step].items():
                bare.setdefault(group, {}).update({key: BARE[group][key] for key in values})
        assert load_config(f"ablation_plus_{name}") == load_config({"thresholds": bare}), name
    shipped = {name for name in list_configs() if name.startswith("ablation_plus_")}
    assert shipped == {f"ablation_plus_{name}" for name in ABLATED}


def test_a_tracker_by_name_brings_the_thresholds_of_its_configuration():
    default, remind = load_config("default"), load_config("remind")
    assert default.with_tracker("remind").thresholds == remind.thresholds
    assert default.with_tracker("remind").input == default.input
    assert load_config({"tracker": "remind"}) == default.with_tracker("remind")
    assert load_config("published").with_tracker("plus").thresholds == PlusThresholds()
    assert load_config("published").with_tracker("remind") == Config()


def test_a_tracker_by_name_brings_its_capacities_unless_others_were_chosen():
    default, remind = load_config("default"), load_config("remind")
    assert default.static.num_detections > remind.static.num_detections
    assert default.with_tracker("remind").static == remind.static
    other = remind.updated({"static.part_top": 2}).with_tracker("plus")
    assert other.static == default.static
    assert not any("part_top" in key for key in other.chosen)
    assert remind.with_tracker("plus").static == default.static
    chosen = default.updated({"static": {"num_objects": 7}})
    switches = remind.static.switches
    assert chosen.with_tracker("remind").static == dataclasses.replace(
        chosen.static, switches=switches
    )


def test_a_file_starts_from_the_file_beside_it(tmp_path, monkeypatch):
    (tmp_path / "first.yaml").write_text("base: remind\nmatching: {match: 0.5}")
    (tmp_path / "second.yaml").write_text("base: first.yaml")
    assert load_config(tmp_path / "second.yaml") == load_config(tmp_path / "first.yaml")
    (tmp_path / "rooms").mkdir()
    (tmp_path / "rooms" / "third.yaml").write_text("base: first.yaml")
    monkeypatch.chdir(tmp_path)  # else from where the command runs
    assert load_config("rooms/third.yaml") == load_config("first.yaml")


def test_bases_in_a_circle_are_refused(tmp_path):
    first, second = tmp_path / "first.yaml", tmp_path / "second.yaml"
    first.write_text(f"base: {second}")
    second.write_text(f"base: {first}")
    for start in (first, {"base": str(second)}):
        with pytest.raises(ConfigError, match=r"circle: .*\.yaml -> .*\.yaml -> .*\.yaml$"):
            load_config(start)


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"base": "remind", "thresholds": {"matching": {"mach": 0.7}}},
            "thresholds.matching.mach.*'match'",
        ),
        ({"treshholds": {}}, "'treshholds'.*'thresholds'"),
        ({"thresholds": 3}, "thresholds.*keys and values"),
        (
            {"base": "remind", "thresholds": {"matching": {"match": "high"}}},
            "match in changes is 'high'; it must be a number",
        ),
        ({"thresholds": {"looks": {"whitening": 1}}}, "true or false"),
        ({"base": "remind", "static": {"appearance_slots": 20}}, "a list"),
        ({"static.part_seed": 1}, "'static.part_seed' .* is a switch of tracker 'remind', and"),
        ({"static": {"solver": "magic"}}, "solver is 'magic'; allowed: host, jax"),
        (
            {"tracker": 3},
            "tracker in changes is 3; it must be the name of a tracker .`register_method`",
        ),
        (
            {"matching": {"match": 0.7}},
            "'matching.match' in changes is a threshold of tracker 'remi",
        ),
        ({"thresholds": {"match": 0.7}}, r"'thresholds\.match' .* of trackers .*'bank'"),
        ({"num_objects": 7}, r"did you mean 'static\.num_objects'"),
        ({"decisions": {"new": 0.5}}, r"did you mean 'decision\.new'"),
        ({"decision.nwe": 0.5}, "did you mean 'new'"),
        ({"gain": 0.5}, r"may be thresholds\.mobility\.gain or thresholds\.looks\.gain"),
        ({"decision": 3}, "decision in changes is 3; it must hold keys and values"),
        (
            {"looks.gain": 1.0, "thresholds": {"looks": {"gain": 1.0}}},
            r"twice, as 'looks\.gain' and as 'thresholds\.looks\.gain'",
        ),
        ({"base": 3}, "base in changes is 3; it must be the name"),
        ({"base": "remnid"}, "no configuration 'remnid'.*'remind'"),
        ({"base": "bank"}, "'bank' is a tracker and no configuration; choose it by --tracker"),
    ],
)
def test_wrong_values_are_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        load_config(changes)


def test_broken_files_are_named(tmp_path):
    for text in ("a: [", "- 1\n- 2", "3"):
        (tmp_path / "broken.yaml").write_text(text)
        with pytest.raises(ConfigError, match=r"broken\.yaml"):
            load_config(tmp_path / "broken.yaml")


def test_arrays_pass_as_sweeps():
    swept = np.linspace(0.6, 0.8, 5)
    config = Config().updated({"thresholds": {"matching": {"match": swept}}})
    assert config.thresholds.matching.match is swept


def test_numbers_of_numpy_are_checked_like_others():
    with pytest.raises(ConfigError, match=r"firm in changes is -5\.0"):
        load_config({"decision.firm": np.float32(-5)})
    with pytest.raises(ConfigError, match=r"commit_age in changes is 3\.5"):
        load_config({"decision.commit_age": np.float64(3.5)})
    config = load_config({"decision.commit_age": np.int64(3), "motion.checked": np.False_})
    thresholds: Any = config.thresholds
    assert type(thresholds.decision.commit_age) is int
    assert thresholds.motion.checked is False


def test_growing_doubles_until_it_fits():
    grown = Static(num_objects=64, num_detections=16).grow(num_objects=300, num_detections=5)
    assert (grown.num_objects, grown.num_detections) == (512, 16)
