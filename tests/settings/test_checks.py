"""Values that a setting cannot have are refused, and what it may be is said."""

import dataclasses
from typing import Literal

import pytest

from remind_jax.errors import ConfigError
from remind_jax.settings.ranges import check_fields
from remind_jax.settings.record import setting


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
