"""Numbers in YAML are what they look like, or refused."""

import pytest
import yaml

from remind_jax.errors import ConfigError
from remind_jax.files import yaml_text
from remind_jax.files.yaml_text import parse_yaml


def test_numbers_as_people_write_them():
    values = {"5": 5, "-3": -3, "+2": 2, "0": 0, "1.5": 1.5, ".5": 0.5, "2.": 2.0, "1.5e-3": 0.0015}
    values |= {".inf": float("inf"), "-.inf": -float("inf")}
    for text, value in values.items():
        assert parse_yaml(f"a: {text}", "here", ConfigError) == {"a": value}


def test_what_python_cannot_hold_is_refused():
    for text in ('"\\UFFFFFFFF"', "1" * 5000):
        with pytest.raises(ConfigError, match="'here' is not valid YAML: "):
            parse_yaml(f"a: {text}", "'here'", ConfigError)


def test_many_keys_are_not_each_compared_with_all():
    compared = []

    class Key(str):
        __slots__ = ()

        def __eq__(self, other):
            compared.append(1)
            return str.__eq__(self, other)

        __hash__ = str.__hash__

    nodes = [yaml.ScalarNode("tag:yaml.org,2002:str", Key(number)) for number in range(300)]
    pairs = [(node, node) for node in nodes]
    node = yaml.MappingNode("tag:yaml.org,2002:map", pairs)
    assert len(yaml_text._Loader("").construct_mapping(node)) == 300
    assert len(compared) < 3000
    with pytest.raises(ConfigError, match="the key 'k7' stands twice"):
        parse_yaml("k7: 1\nk8: 1\nk7: 2\n", "here", ConfigError)


def test_numbers_that_are_taken_for_others_are_refused():
    for text in ("010", "0x10", "0b11", "1_000", "1:30", "1:30.5", "-012", "1_0.5"):
        said = rf"line 1, column 4 .*{text}.* not written in decimal"
        with pytest.raises(ConfigError, match=said):
            parse_yaml(f"a: {text}", "here", ConfigError)
