import itertools

import pytest

from remind_jax.config import Config, reference_keys
from remind_jax.config.dotted_keys import flatten, nest
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


def other_value(path, old):
    """An allowed value that is not the published one."""
    if isinstance(old, bool):
        return not old
    if isinstance(old, int):
        most = KEYED[path].most
        return old + (1 if most is None or old < most else -1)
    if isinstance(old, float):  # not above the largest rate
        return old + (-old / 2 if path.endswith("_rate_min") else 0.125)
    return ["mirror"]


def test_every_renamed_key_reaches_its_field():
    """Each key is given in another choice of the trials, and its field follows it in all."""
    published = dict(flatten(Config().to_dict()))
    for bit in range(len(RENAMED).bit_length()):
        given = {path for number, path in enumerate(RENAMED, 1) if number >> bit & 1}
        new = {path: other_value(path, published[path]) for path in given}
        config = Config.from_reference(
            nest({KEYED[path].key: value for path, value in new.items()})
        )
        told = dict(flatten(config.to_dict()))
        changed = {path for path in told if told[path] != published[path]}
        # Larger rings and deferred relations need room in the compiled program.
        more = {"static.switches.ring_max_radius", "static.switches.pending_relations"}
        assert changed - more == given - more
        assert {path: told[path] for path in given} == new


def test_every_choice_is_accepted():
    for path, record in CHOICES.items():
        for theirs, ours in (record.theirs or {}).items():
            assert value_at(Config.from_reference(nest({record.key: theirs})), path) == ours, path
        refuse(record.key, "nonsense")


def refuse(key, value):
    """A value of this key that is not supported is named."""
    with pytest.raises(ConfigError, match=key):
        Config.from_reference(nest({key: value}))


def test_values_above_a_limit_are_refused_with_the_reason():
    for path in LIMITED:
        key, most, why = KEYED[path].key, KEYED[path].most or 0, KEYED[path].why
        assert value_at(Config.from_reference(nest({key: most})), path) == most
        for refused, name in ((Config.from_reference, key), (Config().updated, path)):
            with pytest.raises(ConfigError, match=f"{name} .* up to {most}, {why}"):
                refused(nest({name: most + 1}))


def test_lists_open_a_gate_for_every_name():
    for key, gates in LISTS.items():
        for chosen in itertools.product([False, True], repeat=len(gates)):
            listed = [name for name, open_ in zip(gates, chosen, strict=True) if open_]
            config = Config.from_reference(nest({key: [name.lower() for name in listed[::-1]]}))
            everyone = not listed and key in EMPTY_IS_ALL
            for name, path in gates.items():
                assert value_at(config, path) == (name in listed or everyone), (key, listed)
            names = {name for name, _, _ in config.difference(Config())}
            assert names <= set(gates.values())
        refuse(key, ["nonsense"])
        refuse(key, "WEAK")


def test_published_lists():
    """As the original ships them; nothing at all is the empty list."""
    for key in LISTS:
        shipped = ["WEAK", "AMBIGUOUS"] if key.endswith("allow_status") else ["SETS_RESCUE"]
        assert Config.from_reference(nest({key: shipped})) == Config()
        empty = Config.from_reference(nest({key: []}))
        assert Config.from_reference(nest({key: None})) == empty != Config()


def test_capacities_of_work_and_stable_banks():
    config = Config.from_reference(
        {"memory": {"appearance": {"max_prototypes_per_channel": 3},
                    "parts": {"max_prototypes_per_channel": 7},
                    "background": {"max_outer_global_stable": 5}}}
    )  # fmt: skip
    assert config.static.switches.appearance_slots == (3, 20)
    assert config.static.switches.part_slots == (7, 7)
    assert config.static.switches.outer_ring_slots == (30, 5)


PERCEPTION, SWITCH = "thresholds.perception.", "static.switches."
GLOBAL, TRIMMED = f"{PERCEPTION}global_enabled", f"{PERCEPTION}trimmed_enabled"
PARTS, KMEANS_KEPT = f"{PERCEPTION}parts_enabled", f"{PERCEPTION}kmeans_parts_kept"
NO_CHANNEL = {
    "memory.appearance.channels.global.enabled": False,
    "memory.appearance.channels.global_trimmed.enabled": False,
}
NO_KMEANS = {"part_descriptors.kmeans.enabled": False}
ATTENTION = {"part_descriptors.attention.enabled": True}
PARTIALS = {"association.similarity.background_partials.enabled": True}
HYPOTHESES = "association.scores.neighbor_sets.context.k"
SCALE = "association.matching.neighbor_sets_context_veto.local.expected_topk_scale"


def lengths(hypotheses, neighbors):
    return {f"{SWITCH}context_hypotheses": hypotheses, f"{SWITCH}expected_neighbours": neighbors}


# Keys of one setting, what it is with all of them as shipped, and with other values.
SWITCHED = [
    ({"dino.patch_threshold": 0.3}, {f"{PERCEPTION}patch_coverage": 0.0}),
    (
        {"dino.patch_threshold": 0.3, "dino.patch_selection": "threshold"},
        {f"{PERCEPTION}patch_coverage": 0.3},
    ),
    ({"davis.mask_erosion_px": 2}, {"input.erosion_px": 2}),
    ({"davis.mask_erosion_px": 2, "davis.mask_erosion_iters": 3}, {"input.erosion_px": 6}),
    ({"object_features.global.enabled": False}, {GLOBAL: False}),
    (
        {"memory.appearance.channels.global_trimmed.enabled": False},
        {TRIMMED: False, GLOBAL: True},
    ),
    (NO_CHANNEL, {TRIMMED: True, GLOBAL: True}),  # a memory without any channel gets all
    (
        {"memory.appearance.channels.patch.enabled": True, **NO_CHANNEL},
        {TRIMMED: False, GLOBAL: False},
    ),
    ({"memory.appearance.enabled": False}, {TRIMMED: False, GLOBAL: False}),
    ({"part_descriptors.enabled": False}, {PARTS: False}),
    (NO_KMEANS, {PARTS: False}),
    ({**NO_KMEANS, **ATTENTION}, {PARTS: True, f"{SWITCH}part_source": "attention"}),
    (ATTENTION, {f"{SWITCH}part_source": "both"}),
    ({"part_descriptors.attention.head_ids": [0, 3]}, {f"{SWITCH}attention_heads": [0, 3]}),
    ({"part_descriptors.kmeans.merge.enabled": False}, {f"{SWITCH}part_resembling": "keep"}),
    ({"part_descriptors.kmeans.merge.mode": "weighted_mean"}, {f"{SWITCH}part_resembling": "join"}),
    (
        {"memory.parts.channels.attention.enabled": False},
        {f"{PERCEPTION}attention_parts_kept": False, KMEANS_KEPT: True},
    ),
    ({"memory.parts.channels.kmeans.enabled": False}, {KMEANS_KEPT: False}),
    ({"object_features.global_trimmed.enabled": False}, {TRIMMED: False}),
    ({"memory.parts.enabled": False}, {KMEANS_KEPT: False}),
    ({"bg_local.sanitize.enabled": False}, {"input.sanitize": "none"}),
    ({"bg_local.sanitize.mode": "morphology"}, {"input.sanitize": "morphology"}),
    (PARTIALS, {f"{SWITCH}ring_prototypes": True}),
    ({**PARTIALS, "bg_local.prototypes.enabled": False}, {f"{SWITCH}ring_prototypes": False}),
    ({HYPOTHESES: 3}, lengths(3, 6)),
    ({HYPOTHESES: 0}, lengths(1, 2)),  # as the original reads them: at least one
    ({SCALE: 1.1, HYPOTHESES: 4}, lengths(4, 5)),
    ({SCALE: 0.5}, lengths(6, 6)),  # less than one is one
    ({"memory.background.enabled": False}, {"thresholds.background.enabled": False}),
    ({"update.background_memory.enabled": False}, {"thresholds.background.enabled": False}),
]


def test_what_several_keys_decide_together():
    for given, expected in SWITCHED:
        config = Config.from_reference(nest(given))
        assert {path: value_at(config, path) for path in expected} == expected, given
    assert {key for given, _ in SWITCHED for key in given} == set(reference_keys.SHIPPED)
    for key in reference_keys.SHIPPED:
        refuse(key, "nonsense")


def test_supported_values_pass_and_others_do_not():
    Config.from_reference(nest(FIXED))
    for key, value in FIXED.items():
        refuse(key, (not value) if isinstance(value, bool) else "something else")


def test_whole_numbers_pass_as_numbers_and_rings_are_never_cut_short():
    config = Config.from_reference({"association": {"matching": {"match_thr": 1}}})
    assert config.thresholds.matching.match == 1.0
    assert isinstance(config.thresholds.matching.match, float)
    config = Config.from_reference({"bg_local": {"outer_radius_patches": 14}})
    assert config.static.switches.ring_max_radius == 14


def test_misspelt_keys_are_named():
    with pytest.raises(ConfigError, match=r"association\.matching\.match_thr"):
        Config.from_reference({"association": {"matching": {"match_tr": 0.7}}})
    with pytest.raises(ConfigError, match=r"thresholds\.matching\.match .* number"):
        Config.from_reference({"association": {"matching": {"match_thr": "high"}}})
