import dataclasses

import numpy as np
import pytest
import yaml

from remind_jax.config import Config, Input, Static, Thresholds, list_configs, load_config
from remind_jax.config.dotted_keys import flatten
from remind_jax.errors import ConfigError


def test_published_is_the_plain_config():
    assert load_config("published") == Config()


def test_default_differs_where_users_need_it():
    changed = load_config("default").difference(load_config("published"))
    keys = [
        "input.ignored_classes",
        "thresholds.matching.one_detection_each",
        "backbone_profile",
    ]
    assert [key for key, _, _ in changed] == keys


def test_a_profile_fills_in_what_nobody_changed():
    mine = load_config({"thresholds": {"matching": {"match": 0.8}}})
    config = mine.for_backbone("patch-statistics")
    assert config.thresholds.matching.match == 0.8
    assert config.thresholds.appearance.patches_min == 4.0
    assert config.for_backbone("patch-statistics") == config
    assert mine.for_backbone("dinov3-vits16") == mine


def test_published_thresholds_follow_no_profile():
    assert load_config("published").for_backbone("patch-statistics") == Config()


@pytest.mark.parametrize(
    ("name", "keys"),
    [
        ("greedy", {"static.assignment"}),
        (
            "no_background",
            {"thresholds.perception.rings_enabled", "thresholds.similarity.background_weight"},
        ),
        ("no_neighbours", {"thresholds.cooccurrence.enabled", "thresholds.relations.enabled"}),
        (
            "no_parts",
            {"thresholds.perception.parts_enabled", "thresholds.similarity.parts_weight"},
        ),
        ("no_disambiguation", {"thresholds.known_sets.enabled"}),
    ],
)
def test_an_ablation_takes_one_thing_away(name, keys):
    changed = load_config(f"ablation_{name}").difference(load_config("default"))
    assert {key for key, _, _ in changed} == keys


@pytest.mark.parametrize("name", list_configs())
def test_shipped_configurations_load(name):
    assert isinstance(load_config(name), Config)


def test_values_survive_yaml(tmp_path):
    config = load_config({"static": {"appearance_slots": [3, 4]}, "input": {"sanitize": "none"}})
    path = tmp_path / "mine.yaml"
    path.write_text(yaml.safe_dump(config.to_dict()))
    assert load_config(path) == config


def test_a_file_starts_from_its_base(tmp_path):
    (tmp_path / "mine.yaml").write_text("base: default\nthresholds: {matching: {match: 0.5}}")
    expected = load_config("default").updated({"thresholds": {"matching": {"match": 0.5}}})
    assert load_config(tmp_path / "mine.yaml") == expected


def test_an_empty_file_is_published(tmp_path):
    (tmp_path / "empty.yaml").write_text("")
    assert load_config(tmp_path / "empty.yaml") == load_config("published")


def test_a_config_is_returned_as_it_is():
    config = Config()
    assert load_config(config) is config


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"thresholds": {"matching": {"mach": 0.7}}}, "thresholds.matching.mach.*'match'"),
        ({"treshholds": {}}, "'treshholds'.*'thresholds'"),
        ({"thresholds": 3}, "thresholds.*keys and values"),
        (
            {"thresholds": {"matching": {"match": "high"}}},
            "match in changes is 'high'; it must be a number",
        ),
        ({"thresholds": {"matching": {"match": True}}}, "must be a number"),
        ({"thresholds": {"matching": {"locks": 1}}}, "true or false"),
        ({"thresholds": {"appearance": {"promote_hits": 2.5}}}, "a whole number"),
        ({"static": {"num_objects": 0}}, "num_objects is 0.*positive"),
        ({"static": {"part_seed": -1}}, "part_seed is -1.*whole"),
        ({"static": {"appearance_slots": [20]}}, "appearance_slots.*two"),
        ({"static": {"appearance_slots": [20, 0]}}, "appearance_slots.*positive"),
        ({"static": {"appearance_slots": 20}}, "a list"),
        ({"static": {"solver": "magic"}}, "solver is 'magic'; allowed: host, jax"),
        ({"static": {"neighbour_trim": "age"}}, "allowed: weight, recent"),
        ({"input": {"sanitize": "hull"}}, "allowed: convex_hull, morphology, none"),
        ({"input": {"max_width_px": 0}}, "max_width_px is 0"),
        ({"input": {"ignored_classes": "wall"}}, "a list"),
    ],
)
def test_wrong_values_are_answered_in_one_sentence(changes, words):
    with pytest.raises(ConfigError, match=words) as error:
        load_config(changes)
    assert "\n" not in str(error.value)


def test_an_unknown_name_lists_what_there_is():
    with pytest.raises(ConfigError, match="default"):
        load_config("defualt")


@pytest.mark.parametrize("text", ["a: [", "- 1\n- 2", "3"])
def test_broken_files_are_named(tmp_path, text):
    path = tmp_path / "broken.yaml"
    path.write_text(text)
    with pytest.raises(ConfigError, match=r"broken\.yaml"):
        load_config(path)


def test_a_missing_file_is_named(tmp_path):
    with pytest.raises(ConfigError, match=r"nowhere\.yaml"):
        load_config(tmp_path / "nowhere.yaml")


def test_arrays_pass_as_sweeps():
    swept = np.linspace(0.6, 0.8, 5)
    config = Config().updated({"thresholds": {"matching": {"match": swept}}})
    assert config.thresholds.matching.match is swept


def test_flattening_gives_dotted_keys():
    assert dict(flatten({"a": {"b": 1, "c": {"d": 2}}, "e": 3})) == {"a.b": 1, "a.c.d": 2, "e": 3}


def test_static_is_a_key_of_compiled_programs():
    assert hash(Static()) == hash(Static())
    assert Static() != Static(num_objects=65)


def test_growing_doubles_until_it_fits():
    grown = Static(num_objects=64, num_detections=16).grow(num_objects=300, num_detections=5)
    assert (grown.num_objects, grown.num_detections) == (512, 16)


def test_thresholds_become_typed_arrays():
    arrays = Thresholds().as_arrays(np.float32)
    plain = dict(flatten(dataclasses.asdict(Thresholds())))
    for name, array in flatten(dataclasses.asdict(arrays)):
        kind = {bool: np.bool_, int: np.int32, float: np.float32}[type(plain[name])]
        assert array.dtype == kind, name
        assert not array.weak_type, name
        np.testing.assert_allclose(array, plain[name], rtol=1e-7)


def test_input_defaults_are_valid():
    assert Input() == Config().input
