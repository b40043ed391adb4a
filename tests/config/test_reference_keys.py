import pytest

from remind_jax.config import Config, dotted_keys
from remind_jax.config.dotted_keys import flatten
from remind_jax.config.reference_keys import CHOICES, FIXED, INERT, RENAMED, SLOTS, SWITCHES
from remind_jax.errors import ConfigError


def nested(key, value):
    for name in reversed(key.split(".")):
        value = {name: value}
    return value


def value_at(config, path):
    return dict(flatten(config.to_dict()))[path]


def test_nothing_given_is_published():
    assert Config.from_reference({}) == Config()


def test_every_name_here_exists_and_is_set_once():
    fields = dict(flatten(Config().to_dict()))
    targets = [*RENAMED.values(), *(name for name, _ in CHOICES.values())]
    assert set(targets) <= set(fields)
    assert len(targets) == len(set(targets))
    assert {name for pairs in SLOTS.values() for name, _ in pairs} <= set(fields)


def test_no_key_has_two_meanings():
    tables = [RENAMED, CHOICES, SLOTS, FIXED, *SWITCHES.values()]
    tables = [key for table in tables for key in table]
    assert len(tables) == len(set(tables))
    assert not set(tables) & set(INERT)


@pytest.mark.parametrize("key", RENAMED)
def test_every_renamed_key_reaches_its_field(key):
    path, old = RENAMED[key], value_at(Config(), RENAMED[key])
    new = {bool: lambda: not old, int: lambda: old + 1, float: lambda: old + 0.125}.get(
        type(old), lambda: ["mirror"]
    )()
    config = Config.from_reference(nested(key, new))
    assert value_at(config, path) == new
    changed = {name for name, _, _ in config.difference(Config())}
    # Larger rings and deferred relations need room in the compiled program.
    assert changed - {path} <= {"static.ring_max_radius", "static.pending_relations"}


@pytest.mark.parametrize("key", CHOICES)
def test_every_choice_is_accepted(key):
    path, values = CHOICES[key]
    for theirs, ours in values.items():
        assert value_at(Config.from_reference(nested(key, theirs)), path) == ours
    with pytest.raises(ConfigError, match="supported here"):
        Config.from_reference(nested(key, "nonsense"))


def test_capacities_of_work_and_stable_banks():
    config = Config.from_reference(
        {"memory": {"appearance": {"max_prototypes_per_channel": 3},
                    "parts": {"max_prototypes_per_channel": 7},
                    "background": {"max_outer_global_stable": 5}}}
    )  # fmt: skip
    assert config.static.appearance_slots == (3, 20)
    assert config.static.part_slots == (7, 7)
    assert config.static.outer_ring_slots == (30, 5)


@pytest.mark.parametrize("path", SWITCHES)
def test_what_needs_several_keys_is_on_where_all_are_true(path):
    keys = SWITCHES[path]
    for off in (None, *keys):
        settings = dotted_keys.nest({key: key != off for key in keys})
        assert value_at(Config.from_reference(settings), path) is (off is None)
    with pytest.raises(ConfigError, match="supported here"):
        Config.from_reference(nested(next(iter(keys)), "nonsense"))


@pytest.mark.parametrize("key", FIXED)
def test_supported_values_pass_and_others_do_not(key):
    value = FIXED[key]
    Config.from_reference(nested(key, value))
    other = (not value) if isinstance(value, bool) else "something else"
    with pytest.raises(ConfigError, match="supported here"):
        Config.from_reference(nested(key, other))


def test_whole_numbers_pass_as_numbers():
    config = Config.from_reference({"association": {"matching": {"match_thr": 1}}})
    assert config.thresholds.matching.match == 1.0
    assert isinstance(config.thresholds.matching.match, float)


@pytest.mark.parametrize(
    ("selection", "threshold", "expected"),
    [("any", 0.3, 0.0), ("threshold", 0.3, 0.3)],
)
def test_the_patch_threshold_counts_only_when_selected(selection, threshold, expected):
    settings = {"dino": {"patch_selection": selection, "patch_threshold": threshold}}
    assert Config.from_reference(settings).thresholds.perception.patch_coverage == expected


def test_rings_of_the_original_are_never_cut_short():
    config = Config.from_reference({"bg_local": {"outer_radius_patches": 14}})
    assert config.static.ring_max_radius == 14


def test_misspelt_keys_are_named():
    with pytest.raises(ConfigError, match=r"association\.matching\.match_thr"):
        Config.from_reference({"association": {"matching": {"match_tr": 0.7}}})


def test_wrong_kinds_are_refused():
    with pytest.raises(ConfigError, match="match"):
        Config.from_reference({"association": {"matching": {"match_thr": "high"}}})
