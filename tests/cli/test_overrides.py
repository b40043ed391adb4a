"""`--set KEY=VALUE`."""

from __future__ import annotations

import pytest

from remind_jax.cli.flags import load_config_with, parse_assignments
from remind_jax.errors import ConfigError


def test_assignments_become_values_in_their_kind():
    values = parse_assignments(["a.b=1", "a.c.d=0.5", "e=[x, y]", "a.f=off", "g=a=b"])
    assert values == {"a.b": 1, "a.c.d": 0.5, "e": ["x", "y"], "a.f": False, "g": "a=b"}


@pytest.mark.parametrize("text", ["video.mp4", "=1", "a..b=1", "a=[1"])
def test_what_is_no_assignment(text):
    with pytest.raises(ConfigError, match=r"--set"):
        parse_assignments([text])


@pytest.mark.parametrize("pair", [("input=1", "input.close_px=2"), ("input.close_px=2", "input=1")])
def test_a_key_is_a_value_or_a_section(pair):
    with pytest.raises(ConfigError, match="input in --set is 1; it must hold keys and values"):
        load_config_with("default", (pair,))


def test_configuration_with_changes():
    changes = (("static.num_objects=7", "input.close_px=5"), ("static.num_objects=9",))
    config = load_config_with("default", changes)
    assert (config.static.num_objects, config.input.close_px) == (9, 5)
