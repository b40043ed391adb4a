"""Values that a setting cannot have are refused, and what it may be is said."""

import dataclasses
from typing import Literal

import numpy as np
import pytest

from remind_jax.errors import ConfigError
from remind_jax.settings.checks import check_fields, check_most
from remind_jax.settings.record import Setting, setting


@dataclasses.dataclass(frozen=True)
class Sample:
    count: int = setting(1, "at least one")
    offset: int = setting(0, "none is fine", least=0)
    pair: tuple[int, int] = setting((1, 2), "two of them")
    way: Literal["left", "right"] = setting("left", "which one")
    share: float = setting(0.5, "looked at by nobody")


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
        ({"way": "up"}, "sample.way is 'up'; allowed: left, right"),
    ],
)
def test_what_does_not_fit_is_refused(changes, words):
    with pytest.raises(ConfigError, match=words):
        check_fields(Sample(**changes), "sample")


def test_the_largest_number_is_named_with_its_reason():
    record = Setting("so many", most=3, why="there is no room for more")
    check_most("x", 3, record)
    check_most("x", np.array([1, 9]), record)  # a sweep
    check_most("x", 9, Setting("without end"))
    with pytest.raises(ConfigError, match="x is 4; supported: up to 3, there is no room for more"):
        check_most("x", 4, record)
