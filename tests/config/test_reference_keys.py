import itertools

import pytest

from remind_jax.config import Config, dotted_keys, reference_switches
from remind_jax.config.dotted_keys import flatten
from remind_jax.config.reference_keys import CHOICES, FIXED, INERT, RENAMED, SLOTS, SUBSETS
from remind_jax.errors import ConfigError
from remind_jax.remind.thresholds.outcome import EMPTY_IS_ALL, LIMITS


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
    targets += [name for gates in SUBSETS.values() for name in gates.values()]
    assert set(targets) <= set(fields)
    assert len(targets) == len(set(targets))
    assert {name for pairs in SLOTS.values() for name, _ in pairs} <= set(fields)


def test_no_key_has_two_meanings():
    tables = [RENAMED, CHOICES, SLOTS, SUBSETS, FIXED, reference_switches.SHIPPED]
    tables = [key for table in tables for key in table]
    assert len(tables) == len(set(tables))
    assert not set(tables) & set(INERT)


@pytest.mark.parametrize("key", RENAMED)
def test_every_renamed_key_reaches_its_field(key):
    path, old = RENAMED[key], value_at(Config(), RENAMED[key])
    step = -1 if key in LIMITS else 1
    new = {bool: lambda: not old, int: lambda: old + step, float: lambda: old + 0.125}.get(
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


@pytest.mark.parametrize("key", LIMITS)
def test_values_above_a_limit_are_refused_with_the_reason(key):
    most, why = LIMITS[key]
    assert value_at(Config.from_reference(nested(key, most)), RENAMED[key]) == most
    with pytest.raises(ConfigError, match=f"up to {most}, {why}"):
        Config.from_reference(nested(key, most + 1))


@pytest.mark.parametrize("key", SUBSETS)
def test_lists_open_a_gate_for_every_name(key):
    gates = SUBSETS[key]
    for chosen in itertools.product([False, True], repeat=len(gates)):
        listed = [name for name, open_ in zip(gates, chosen, strict=True) if open_]
        config = Config.from_reference(nested(key, [name.lower() for name in reversed(listed)]))
        everyone = not listed and key in EMPTY_IS_ALL
        for name, path in gates.items():
            assert value_at(config, path) == (name in listed or everyone), listed
        names = {name for name, _, _ in config.difference(Config())}
        assert names <= set(gates.values())


@pytest.mark.parametrize("key", SUBSETS)
def test_names_that_cannot_be_listed_are_refused(key):
    with pytest.raises(ConfigError, match="supported here: S"):
        Config.from_reference(nested(key, ["nonsense"]))
    with pytest.raises(ConfigError, match="must be null or a list"):
        Config.from_reference(nested(key, "WEAK"))


def test_published_lists():
    """As the original ships them; nothing at all is the empty list."""
    for key in SUBSETS:
        shipped = ["WEAK", "AMBIGUOUS"] if key.endswith("allow_status") else ["SETS_RESCUE"]
        assert Config.from_reference(nested(key, shipped)) == Config()
        empty = Config.from_reference(nested(key, []))
        assert Config.from_reference(nested(key, None)) == empty != Config()


def test_capacities_of_work_and_stable_banks():
    config = Config.from_reference(
        {"memory": {"appearance": {"max_prototypes_per_channel": 3},
                    "parts": {"max_prototypes_per_channel": 7},
                    "background": {"max_outer_global_stable": 5}}}
    )  # fmt: skip
    assert config.static.appearance_slots == (3, 20)
    assert config.static.part_slots == (7, 7)
    assert config.static.outer_ring_slots == (30, 5)


# Keys of one setting, what it is with all of them as shipped, and with other values.
SWITCHED = [
    ({"dino.patch_threshold": 0.3}, {"thresholds.perception.patch_coverage": 0.0}),
    (
        {"dino.patch_threshold": 0.3, "dino.patch_selection": "threshold"},
        {"thresholds.perception.patch_coverage": 0.3},
    ),
    ({"davis.mask_erosion_px": 2}, {"input.erosion_px": 2}),
    ({"davis.mask_erosion_px": 2, "davis.mask_erosion_iters": 3}, {"input.erosion_px": 6}),
    ({"object_features.global.enabled": False}, {"thresholds.perception.global_enabled": False}),
    (
        {"memory.appearance.channels.global_trimmed.enabled": False},
        {
            "thresholds.perception.trimmed_enabled": False,
            "thresholds.perception.global_enabled": True,
        },
    ),
    (  # a memory without any channel gets all
        {
            "memory.appearance.channels.global.enabled": False,
            "memory.appearance.channels.global_trimmed.enabled": False,
        },
        {
            "thresholds.perception.trimmed_enabled": True,
            "thresholds.perception.global_enabled": True,
        },
    ),
    (
        {
            "memory.appearance.channels.patch.enabled": True,
            "memory.appearance.channels.global.enabled": False,
            "memory.appearance.channels.global_trimmed.enabled": False,
        },
        {
            "thresholds.perception.trimmed_enabled": False,
            "thresholds.perception.global_enabled": False,
        },
    ),
    (
        {"memory.appearance.enabled": False},
        {
            "thresholds.perception.trimmed_enabled": False,
            "thresholds.perception.global_enabled": False,
        },
    ),
    ({"part_descriptors.enabled": False}, {"thresholds.perception.parts_enabled": False}),
    ({"part_descriptors.kmeans.enabled": False}, {"thresholds.perception.parts_enabled": False}),
    (
        {"part_descriptors.kmeans.enabled": False, "part_descriptors.attention.enabled": True},
        {"thresholds.perception.parts_enabled": True, "static.part_source": "attention"},
    ),
    ({"part_descriptors.attention.enabled": True}, {"static.part_source": "both"}),
    ({"part_descriptors.attention.head_ids": [0, 3]}, {"static.attention_heads": [0, 3]}),
    ({"part_descriptors.kmeans.merge.enabled": False}, {"static.part_resembling": "keep"}),
    ({"part_descriptors.kmeans.merge.mode": "weighted_mean"}, {"static.part_resembling": "join"}),
    (
        {"memory.parts.channels.attention.enabled": False},
        {
            "thresholds.perception.attention_parts_kept": False,
            "thresholds.perception.kmeans_parts_kept": True,
        },
    ),
    (
        {"memory.parts.channels.kmeans.enabled": False},
        {"thresholds.perception.kmeans_parts_kept": False},
    ),
    (
        {"object_features.global_trimmed.enabled": False},
        {"thresholds.perception.trimmed_enabled": False},
    ),
    ({"memory.parts.enabled": False}, {"thresholds.perception.kmeans_parts_kept": False}),
    ({"bg_local.sanitize.enabled": False}, {"input.sanitize": "none"}),
    ({"bg_local.sanitize.mode": "morphology"}, {"input.sanitize": "morphology"}),
    (
        {"association.similarity.background_partials.enabled": True},
        {"static.ring_prototypes": True},
    ),
    (
        {
            "association.similarity.background_partials.enabled": True,
            "bg_local.prototypes.enabled": False,
        },
        {"static.ring_prototypes": False},
    ),
    (
        {"association.scores.neighbor_sets.context.k": 3},
        {"static.context_hypotheses": 3, "static.expected_neighbours": 6},
    ),
    (  # as the original reads them: at least one
        {"association.scores.neighbor_sets.context.k": 0},
        {"static.context_hypotheses": 1, "static.expected_neighbours": 2},
    ),
    (
        {
            "association.matching.neighbor_sets_context_veto.local.expected_topk_scale": 1.1,
            "association.scores.neighbor_sets.context.k": 4,
        },
        {"static.context_hypotheses": 4, "static.expected_neighbours": 5},
    ),
    (  # less than one is one
        {"association.matching.neighbor_sets_context_veto.local.expected_topk_scale": 0.5},
        {"static.context_hypotheses": 6, "static.expected_neighbours": 6},
    ),
    ({"memory.background.enabled": False}, {"thresholds.background.enabled": False}),
    ({"update.background_memory.enabled": False}, {"thresholds.background.enabled": False}),
]


@pytest.mark.parametrize(("given", "expected"), SWITCHED)
def test_what_several_keys_decide_together(given, expected):
    config = Config.from_reference(dotted_keys.nest(given))
    assert {path: value_at(config, path) for path in expected} == expected


def test_every_such_key_is_tried():
    assert {key for given, _ in SWITCHED for key in given} == set(reference_switches.SHIPPED)


@pytest.mark.parametrize("key", reference_switches.SHIPPED)
def test_values_that_such_a_key_cannot_have_are_named(key):
    with pytest.raises(ConfigError, match=key):
        Config.from_reference(nested(key, "nonsense"))


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


def test_rings_of_the_original_are_never_cut_short():
    config = Config.from_reference({"bg_local": {"outer_radius_patches": 14}})
    assert config.static.ring_max_radius == 14


def test_misspelt_keys_are_named():
    with pytest.raises(ConfigError, match=r"association\.matching\.match_thr"):
        Config.from_reference({"association": {"matching": {"match_tr": 0.7}}})


def test_wrong_kinds_are_refused():
    with pytest.raises(ConfigError, match="match"):
        Config.from_reference({"association": {"matching": {"match_thr": "high"}}})
