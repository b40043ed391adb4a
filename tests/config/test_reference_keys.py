import itertools

import pytest

from remind_jax.config import Config, dotted_keys, reference_keys
from remind_jax.config.dotted_keys import flatten
from remind_jax.config.reference_keys import EMPTY_IS_ALL, FIXED, INERT, decided_settings
from remind_jax.errors import ConfigError
from remind_jax.settings.record import walk_settings

DECIDED = decided_settings(Config())
RECORDS = {path: record for path, _, record in walk_settings(Config())}
KEYED = {path: record for path, record in RECORDS.items() if record.key}
CHOICES = {path: record for path, record in KEYED.items() if record.theirs is not None}
PAIRS = {path: record for path, record in KEYED.items() if isinstance(record.key, tuple)}
LISTS = {
    key: {record.listed: path for path, record in settings.items()}
    for key, settings in DECIDED.items()
    if any(record.listed for record in settings.values())
}
RENAMED = [path for path in KEYED if path not in {*CHOICES, *PAIRS} and not KEYED[path].listed]
LIMITED = [path for path in RENAMED if KEYED[path].most is not None]


def nested(key, value):
    for name in reversed(key.split(".")):
        value = {name: value}
    return value


def value_at(config, path):
    return dict(flatten(config.to_dict()))[path]


def test_nothing_given_is_published():
    assert Config.from_reference({}) == Config()


def test_no_key_has_two_meanings():
    for key, settings in DECIDED.items():
        names = [record.listed for record in settings.values()]
        assert len(settings) == 1 or (all(names) and len(set(names)) == len(names)), key
    tables = [*DECIDED, *FIXED, *reference_keys.SHIPPED]
    assert len(tables) == len(set(tables))
    assert not set(tables) & set(INERT)


def test_switches_decide_what_the_records_say():
    decided = {path: record.decided_by for path, record in RECORDS.items() if record.decided_by}
    assert set(decided) == set(reference_keys.decide({}))
    assert {key for keys in decided.values() for key in keys} == set(reference_keys.SHIPPED)
    assert not {path for path in decided if RECORDS[path].key}


@pytest.mark.parametrize("path", RENAMED)
def test_every_renamed_key_reaches_its_field(path):
    old = value_at(Config(), path)
    step = 1 if KEYED[path].most is None or old < KEYED[path].most else -1
    more = -old / 2 if path.endswith("_rate_min") else 0.125  # not above the largest rate
    new = {bool: lambda: not old, int: lambda: old + step, float: lambda: old + more}.get(
        type(old), lambda: ["mirror"]
    )()
    config = Config.from_reference(nested(KEYED[path].key, new))
    assert value_at(config, path) == new
    changed = {name for name, _, _ in config.difference(Config())}
    # Larger rings and deferred relations need room in the compiled program.
    assert changed - {path} <= {
        "static.switches.ring_max_radius",
        "static.switches.pending_relations",
    }


@pytest.mark.parametrize("path", CHOICES)
def test_every_choice_is_accepted(path):
    key, values = KEYED[path].key, KEYED[path].theirs or {}
    for theirs, ours in values.items():
        assert value_at(Config.from_reference(nested(key, theirs)), path) == ours
    with pytest.raises(ConfigError, match="supported here"):
        Config.from_reference(nested(key, "nonsense"))


def test_what_has_a_largest_value():
    assert len(LIMITED) == 8


@pytest.mark.parametrize("path", LIMITED)
def test_values_above_a_limit_are_refused_with_the_reason(path):
    key, most, why = KEYED[path].key, KEYED[path].most or 0, KEYED[path].why
    assert value_at(Config.from_reference(nested(key, most)), path) == most
    for refused in (Config.from_reference, Config().updated):
        name = key if refused == Config.from_reference else path
        with pytest.raises(ConfigError, match=f"{name} .* up to {most}, {why}"):
            refused(nested(name, most + 1))


@pytest.mark.parametrize("key", LISTS)
def test_lists_open_a_gate_for_every_name(key):
    gates = LISTS[key]
    for chosen in itertools.product([False, True], repeat=len(gates)):
        listed = [name for name, open_ in zip(gates, chosen, strict=True) if open_]
        config = Config.from_reference(nested(key, [name.lower() for name in reversed(listed)]))
        everyone = not listed and key in EMPTY_IS_ALL
        for name, path in gates.items():
            assert value_at(config, path) == (name in listed or everyone), listed
        names = {name for name, _, _ in config.difference(Config())}
        assert names <= set(gates.values())


@pytest.mark.parametrize("key", LISTS)
def test_names_that_cannot_be_listed_are_refused(key):
    with pytest.raises(ConfigError, match="supported here: S"):
        Config.from_reference(nested(key, ["nonsense"]))
    with pytest.raises(ConfigError, match="must be null or a list"):
        Config.from_reference(nested(key, "WEAK"))


def test_published_lists():
    """As the original ships them; nothing at all is the empty list."""
    for key in LISTS:
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
    assert config.static.switches.appearance_slots == (3, 20)
    assert config.static.switches.part_slots == (7, 7)
    assert config.static.switches.outer_ring_slots == (30, 5)


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
        {"thresholds.perception.parts_enabled": True, "static.switches.part_source": "attention"},
    ),
    ({"part_descriptors.attention.enabled": True}, {"static.switches.part_source": "both"}),
    ({"part_descriptors.attention.head_ids": [0, 3]}, {"static.switches.attention_heads": [0, 3]}),
    ({"part_descriptors.kmeans.merge.enabled": False}, {"static.switches.part_resembling": "keep"}),
    (
        {"part_descriptors.kmeans.merge.mode": "weighted_mean"},
        {"static.switches.part_resembling": "join"},
    ),
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
        {"static.switches.ring_prototypes": True},
    ),
    (
        {
            "association.similarity.background_partials.enabled": True,
            "bg_local.prototypes.enabled": False,
        },
        {"static.switches.ring_prototypes": False},
    ),
    (
        {"association.scores.neighbor_sets.context.k": 3},
        {"static.switches.context_hypotheses": 3, "static.switches.expected_neighbours": 6},
    ),
    (  # as the original reads them: at least one
        {"association.scores.neighbor_sets.context.k": 0},
        {"static.switches.context_hypotheses": 1, "static.switches.expected_neighbours": 2},
    ),
    (
        {
            "association.matching.neighbor_sets_context_veto.local.expected_topk_scale": 1.1,
            "association.scores.neighbor_sets.context.k": 4,
        },
        {"static.switches.context_hypotheses": 4, "static.switches.expected_neighbours": 5},
    ),
    (  # less than one is one
        {"association.matching.neighbor_sets_context_veto.local.expected_topk_scale": 0.5},
        {"static.switches.context_hypotheses": 6, "static.switches.expected_neighbours": 6},
    ),
    ({"memory.background.enabled": False}, {"thresholds.background.enabled": False}),
    ({"update.background_memory.enabled": False}, {"thresholds.background.enabled": False}),
]


@pytest.mark.parametrize(("given", "expected"), SWITCHED)
def test_what_several_keys_decide_together(given, expected):
    config = Config.from_reference(dotted_keys.nest(given))
    assert {path: value_at(config, path) for path in expected} == expected


def test_every_such_key_is_tried():
    assert {key for given, _ in SWITCHED for key in given} == set(reference_keys.SHIPPED)


@pytest.mark.parametrize("key", reference_keys.SHIPPED)
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
    assert config.static.switches.ring_max_radius == 14


def test_misspelt_keys_are_named():
    with pytest.raises(ConfigError, match=r"association\.matching\.match_thr"):
        Config.from_reference({"association": {"matching": {"match_tr": 0.7}}})


def test_wrong_kinds_are_refused():
    with pytest.raises(ConfigError, match="match"):
        Config.from_reference({"association": {"matching": {"match_thr": "high"}}})
