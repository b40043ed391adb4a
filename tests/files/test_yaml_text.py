"""Numbers in YAML are what they look like, or refused."""

from __future__ import annotations

import pytest

from remind_jax.errors import ConfigError
from remind_jax.files.yaml_text import parse_yaml


@pytest.mark.parametrize(
    ("text", "value"),
    [
        *(("5", 5), ("-3", -3), ("+2", 2), ("0", 0), ("1.5", 1.5), (".5", 0.5), ("2.", 2.0)),
        *(("1.5e-3", 0.0015), (".inf", float("inf")), ("-.inf", -float("inf"))),
    ],
)
def test_numbers_as_people_write_them(text, value):
    assert parse_yaml(f"a: {text}", "here", ConfigError) == {"a": value}


@pytest.mark.parametrize(
    "text", ["010", "0x10", "0b11", "1_000", "1:30", "1:30.5", "-012", "1_0.5"]
)
def test_numbers_that_are_taken_for_others_are_refused(text):
    with pytest.raises(ConfigError, match=rf"line 1, column 4 .*{text}.* not written in decimal"):
        parse_yaml(f"a: {text}", "here", ConfigError)
