"""Every number among the settings has a range, and what lies beyond it is refused."""

import dataclasses
import math
from typing import Literal

import numpy as np
import pytest

from remind_jax.config import Config, load_config
from remind_jax.errors import ConfigError
from remind_jax.method import get_method, list_methods
from remind_jax.settings.ranges import (
    MAX_COUNTS,
    RANGES,
    check_fields,
    check_order,
    check_range,
    range_of,
)
from remind_jax.settings.record import Setting, setting, walk_settings


def numbers(tree) -> list:
    found = walk_settings(tree)
    return [(key, value, record) for key, value, record in found if type(value) in (int, float)]


@pytest.mark.parametrize("name", list_methods())
def test_every_threshold_has_a_range_that_its_value_lies_in(name):
    for key, value, record in numbers(get_method(name).settings()):
        least, most = range_of(record)
        assert math.isfinite(least), key
        assert math.isfinite(most), key
        check_range(key, value, record)


def test_every_count_has_a_limit():
    for section in (Config().static, Config().input):
        for key, value, record in walk_settings(section):
            if any(type(one) is int for one in (value if type(value) is tuple else (value,))):
                assert record.most is not None or record.unit in MAX_COUNTS, key


def test_the_table_names_no_unit_that_nobody_has():
    records = [
        record for name in list_methods() for *_, record in numbers(get_method(name).settings())
    ]
    assert set(RANGES) == {record.unit for record in records}


@pytest.mark.parametrize("name", list_methods())
def test_every_number_beyond_its_range_is_refused(name):
    """A value beyond each end of every range, and those that nothing can be computed with."""
    for key, value, record in numbers(get_method(name).settings()):
        least, most = range_of(record)
        bad = [math.nan, math.inf, -math.inf, 10**12, -(10**12), most + 1, least - 1]
        for one in [*bad, *([10**40] if type(value) is int else [])]:
            with pytest.raises(ConfigError, match=key) as refused:
                check_range(key, one, record)
            assert len(str(refused.value)) < 400


@pytest.mark.parametrize("tracker", ["published", "default"])
def test_a_configuration_refuses_them_and_what_is_no_number(tracker):
    base, tried = load_config(tracker), set()
    for key, value, record in numbers(base.thresholds):
        if type(value) in tried:
            continue
        tried.add(type(value))
        bad = [math.nan, range_of(record)[1] + 1, 10**400, True, "1", None, [1], {"a": 1}]
        for one in [*bad, *([0.5] if type(value) is int else [])]:
            with pytest.raises(ConfigError, match=r"thresholds\."):
                base.updated({f"thresholds.{key}": one}, "a test")
    assert tried == {int, float}


@pytest.mark.parametrize("section", ["static", "input"])
def test_every_count_beyond_its_limit_is_refused(section):
    base = load_config("published")
    for key, now, record in numbers(getattr(base, section)):
        most = record.most or MAX_COUNTS[record.unit]
        parts = [] if isinstance(now, float) else [0.5]
        for value in (most + 1, 10**12, -1, *parts, math.nan, True, "1", None, [1]):
            with pytest.raises(ConfigError, match=key):
                base.updated({f"{section}.{key}": value}, "a test")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        (
            {"similarity.object_min_patches": 50},
            "object_min_patches is 50.0 and .*object_full_patches 32.0",
        ),
        ({"parts.update_rate_max": 0.01}, "the first may not be above the second"),
        ({"static.ring_clusters": [9, 3]}, "the fewest, may not be above"),
        ({"static.ring_clusters": [9, 10**9]}, "ring_clusters is 1000000000; supported: up to 64"),
    ],
)
def test_numbers_that_belong_together_agree(changes, words):
    with pytest.raises(ConfigError, match=words):
        load_config({"base": "published", **changes})


def test_thresholds_put_together_in_python_are_checked():
    matching = dataclasses.replace(Config().thresholds.matching, match=math.nan)
    thresholds = dataclasses.replace(Config().thresholds, matching=matching)
    with pytest.raises(ConfigError, match=r"thresholds\.matching\.match is nan"):
        load_config(Config(thresholds=thresholds))


def test_arrays_pass_as_they_are_sweeps_and_the_reason_of_a_limit_is_said():
    check_range("x", np.array([1.0, 9e9]), Setting("", "score"))
    with pytest.raises(ConfigError, match="x is 4; supported: up to 3, there is no room for more"):
        check_range("x", 4, Setting("so many", most=3, why="there is no room for more"))


def test_an_order_holds_with_equal_numbers():
    @dataclasses.dataclass
    class Pair:
        low: float = setting(1.0, "from here")
        high: float = setting(1.0, "to here", not_below="low")

    check_order(Pair(), "pair.")
    with pytest.raises(ConfigError, match=r"pair\.low is 2.0 and pair\.high 1.0"):
        check_order(Pair(low=2.0), "pair.")


@dataclasses.dataclass(frozen=True)
class Sample:
    count: int = setting(1, "at least one")
    offset: int = setting(0, "none is fine", least=0)
    pair: tuple[int, int] = setting((1, 2), "two of them")
    way: Literal["left", "right"] = setting("left", "which one")
    share: float = setting(0.5, "looked at by nobody")
    names: tuple[str, ...] = setting((), "any number of them")
    numbers: tuple[int, ...] = setting((), "any number of them")
    rounds: int = setting(1, "few are enough", "rounds")


def test_what_fits_passes():
    check_fields(Sample(), "sample")
    check_fields(Sample(7, 3, (3, 4), "right", 9.0), "sample")


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"count": 0}, "sample.count is 0; it must be a positive whole number"),
        ({"count": True}, "sample.count is True; it must be a positive whole number"),
        ({"count": 1.0}, "sample.count is 1.0; it must be a positive whole number"),
        ({"offset": -1}, "sample.offset is -1; it must be a whole number"),
        ({"pair": (1, 0)}, r"sample.pair is \(1, 0\); it must be two positive whole numbers"),
        ({"pair": (1,)}, "sample.pair is .*; it must be two positive whole numbers"),
        ({"names": ("a", 1)}, "sample.names holds 1; it must be a list of names"),
        ({"names": ("a" * 201,)}, "sample.names holds 'aa.*[.]{3}a*'; it must be a list of names"),
        ({"names": "abc"}, "sample.names must be a list"),
        ({"numbers": (-1,)}, "sample.numbers holds -1; it must be a list of numbers from 0 on"),
        ({"rounds": 10**6}, "sample.rounds is 1000000; supported: up to 16"),
        ({"way": "up"}, "sample.way is 'up'; allowed: left, right"),
    ],
)
def test_what_does_not_fit_is_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        check_fields(Sample(**changes), "sample")
