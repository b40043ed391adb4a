"""Settings of a sweep are read whole, or refused before anything is computed."""

import json

import numpy as np
import pytest

from remind_jax.config import load_config
from remind_jax.errors import ConfigError, RemindError
from remind_jax.sweeps import SceneBench, draw, parse_values, read_settings, sweep
from remind_jax.sweeps.settings import MAX_SETTINGS, as_settings, complete, complete_space, stack


@pytest.mark.parametrize(
    ("text", "values"),
    [
        ("0.5,0.6", [0.5, 0.6]),
        ("true,false", [True, False]),
        ("1:3:1", [1, 2, 3]),
        ("0:1:0.25", [0.0, 0.25, 0.5, 0.75, 1.0]),
        ("-1e3", [-1000.0]),
        ("2:2:1", [2]),
    ],
)
def test_values_are_read_as_written(text, values):
    assert parse_values(text) == values


@pytest.mark.parametrize(
    "text",
    [
        "", "a", "0.5,", ",", "nan", "inf", "-inf", "1e400", "0,nan", "9" * 5000, "0.5;0.6",
        "0:1:1e-9", "0:1:0", "0:1:-1", "1:0:0.1", "0:inf:1", "0:1:nan", "nan:1:0.1", "0:1e300:1",
        "0:1", "0:1:1:1", "true:1:1", "::", "0.5,0.5", "0x10", "\x00", "1_000", "٣", "1__0",
    ],
)  # fmt: skip
def test_values_that_are_none_are_refused(text):
    with pytest.raises(ConfigError) as refused:
        parse_values(text)
    assert "\n" not in str(refused.value)
    assert len(str(refused.value)) < 300


def test_a_csv_file_and_a_json_file_hold_the_same_settings(tmp_path):
    (tmp_path / "a.csv").write_text("matching.match,influence.enabled\n0.7,true\n\n0.8,false\n\n")
    rows = [{"matching": {"match": 0.7}, "influence.enabled": True}]
    (tmp_path / "a.json").write_text(json.dumps(rows))
    first, second = read_settings(tmp_path / "a.csv")
    assert first == read_settings(tmp_path / "a.json")[0]
    assert second == {"matching.match": 0.8, "influence.enabled": False}


FILES = {
    "empty.csv": "",
    "quote.csv": 'matching.match\n"0.7\n',
    "columns.csv": ",".join(["matching.match"] * 50_000) + "\n",
    "heads.csv": "matching.match\n",
    "nan.csv": "matching.match\nnan\n",
    "text.csv": "matching.match\nhigh\n",
    "blank.csv": "matching.match,matching.lock_score\n0.7,\n",
    "short.csv": "matching.match,matching.lock_score\n0.7\n",
    "long.csv": "matching.match\n0.7,0.8\n",
    "twice.csv": "matching.match,matching.match\n0.7,0.8\n",
    "same.csv": "matching.match\n0.7\n0.8\n0.70\n",
    "huge.csv": "matching.match\n" + "9" * 200_000 + "\n",
    "many.csv": "matching.match\n" + "0.5\n" * (MAX_SETTINGS + 1),
    "wide.csv": "x" * 200_000 + "\n1\n",
    "nul.csv": b"matching.match\n\x00\n",
    "none.json": "[]",
    "mapping.json": '{"matching.match": 0.7}',
    "text.json": '[{"matching.match": "0.7"}]',
    "same.json": '[{"matching.match": 0.7}, {"matching.match": 0.7}]',
    "nested.json": '[{"a":' * 5000 + "1" + "}]" * 5000,
}


@pytest.mark.parametrize("name", FILES)
def test_a_file_that_holds_something_else_is_refused_by_name(name, tmp_path):
    path, content = tmp_path / name, FILES[name]
    path.write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(RemindError) as refused:
        complete(read_settings(path), load_config("remind"))
    said = str(refused.value)
    assert name in said
    assert "\n" not in said
    assert len(said) < 600


@pytest.mark.parametrize(
    "settings",
    [
        [],
        [{"matching.match": float("nan")}],
        [{"matching.match": 1e12}],
        [{"matching.match": "0.7"}],
        [{"matching.match": None}],
        [{"static.num_objects": 3}],
        [{"similarity.object_min_patches": 40.0}],
        [{1: 2}],
        ["matching.match"],
        [None],
        [{}] * (MAX_SETTINGS + 2),
    ],
)
def test_settings_are_checked_before_a_scene_is_opened(settings):
    with pytest.raises(RemindError):
        sweep("no/such/scene", settings, config="remind")


@pytest.mark.parametrize(
    "given", [None, 3, "matching.match", {"matching.match": 0.7}, {"a": []}, {"a": "0.5"}]
)
def test_what_is_no_list_of_settings_is_refused(given):
    with pytest.raises(ConfigError):
        as_settings(given)


@pytest.mark.parametrize(
    ("space", "number"),
    [
        ({"a": [0, 1]}, 0),
        ({"a": [0, 1]}, -4),
        ({"a": [0, 1]}, 10**9),
        ({"a": []}, 3),
        ({"a": [1, 0]}, 3),
    ],
)
def test_what_cannot_be_drawn_is_refused(space, number):
    with pytest.raises(ConfigError):
        draw(space, number)


def test_no_setting_is_drawn_twice():
    few = {"a": (0, 3), "b": (True, False)}
    for number, expected in ((5, 5), (8, 8), (20, 8)):
        drawn = {tuple(setting.items()) for setting in draw(few, number)}
        assert len(drawn) == len(draw(few, number)) == expected


def test_whole_numbers_of_numpy_are_whole():
    drawn = draw({"a": (np.int64(3), np.int64(16))}, 20)
    assert all(type(one["a"]) is int for one in drawn)


def test_both_ends_of_a_range_are_checked_and_of_the_kind_of_their_threshold():
    config = load_config("default")
    given = {"decision.new": (0, 1), "decision.commit_age": (2, 8)}
    space = complete_space(given, config)
    assert str(space) == "{'decision.new': [0.0, 1.0], 'decision.commit_age': [2, 8]}"
    assert any(0 < setting["decision.new"] < 1 for setting in draw(space, 5))
    with pytest.raises(ConfigError, match=r"matching\.match .*supported: up to 2"):
        complete_space({"matching.match": (0.5, 90.0)}, load_config("remind"))


def test_thresholds_with_an_order_between_them_have_ranges_of_their_own():
    config = load_config("remind")
    given = {"appearance.update_rate_min": (0, 0.5), "appearance.update_rate_max": (0, 0.9)}
    space = complete_space(given, config)
    assert list(space.values()) == [[0.0, 0.5], [0.0, 0.9]]
    bench = SceneBench([(np.zeros((64, 64, 3), np.uint8), np.ones((64, 64), int))], config=config)
    drawn = draw(space, 20, 1, bench.find_fault)
    assert len(complete(drawn, config)) == 20, "raises where the order is broken"
    legal = [one for one in draw(space, 20, 1) if not bench.find_fault(one)]
    assert drawn[: len(legal)] == legal
    with pytest.raises(ConfigError, match=r"allowed: .*update_rate_min is 0.* give other ranges"):
        draw({**space, "appearance.update_rate_max": (0.0, 0.0)}, 3, 1, bench.find_fault)
    with pytest.raises(ConfigError, match="a threshold twice"):
        complete_space({"matching.match": (0.5, 0.6), "match": (0.5, 0.6)}, config)


@pytest.mark.parametrize(
    "setting",
    [{"decision.commit_age": 2.7}, {"decision.new": "1"}, {"decision.new": True},
     {"looks.whitening": 1}],
)  # fmt: skip
def test_values_of_another_kind_are_not_stacked(setting):
    with pytest.raises(ConfigError, match=next(iter(setting))):
        stack(load_config("default").thresholds, [{}, setting])


@pytest.mark.parametrize(
    "options",
    [
        {"memory_gib": 0}, {"memory_gib": float("nan")}, {"memory_gib": -1}, {"memory_gib": "2"},
        {"batch": 0}, {"batch": 1.5}, {"batch": 10**12}, {"workers": -1}, {"workers": True},
    ],
)  # fmt: skip
def test_options_out_of_range_are_refused(options):
    (name,) = options
    with pytest.raises(RemindError, match=name):
        SceneBench("no/such/scene", **options)
