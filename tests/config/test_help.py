"""What is said of a setting comes from its record."""

import pytest

from remind_jax.cli.config import describe_settings
from remind_jax.config import Config, load_config
from remind_jax.errors import ConfigError


def test_keys_that_decide_together_are_named():
    lines = list(describe_settings(Config(), ["background.enabled"]))
    assert lines == [
        "thresholds.background.enabled: true",
        "  remember and compare the background",
        "  in the original: memory.background.enabled, update.background_memory.enabled",
    ]


def test_values_are_those_of_the_configuration():
    changed = Config().updated({"matching": {"match": 0.5}})
    assert next(describe_settings(changed, ["match"])) == "thresholds.matching.match: 0.5 (score)"


def test_a_section_is_all_of_its_settings():
    plus = load_config("plus")
    heads = [line for line in describe_settings(plus, ["looks"]) if not line.startswith(" ")]
    assert [head.partition(":")[0] for head in heads] == [
        key for key in plus.keys if key.startswith("thresholds.looks.")
    ]


@pytest.mark.parametrize("name", ["chosen", "nonsense", "matching.match"])
def test_names_of_no_setting_are_refused(name):
    with pytest.raises(ConfigError, match=name):
        list(describe_settings(load_config("plus"), [name]))
