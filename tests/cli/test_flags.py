"""Flags are read and told in the words of the shell."""

import pytest

from remind_jax.cli import process
from remind_jax.cli.flags import DetectionFlags, SamplingFlags, load_config_with, parse_assignments
from remind_jax.cli.main import VERBS, main
from remind_jax.detectors.options import DetectorOptions
from remind_jax.sources.sampling import Sampling

ACTIONS = ("list", "show", "describe", "diff", "validate", "import-reference")
PAGES = [(verb,) for verb in VERBS] + [("config", action) for action in ACTIONS]


def test_help_speaks_no_python_and_fits_80_columns(monkeypatch, capfd):
    monkeypatch.setenv("COLUMNS", "80")
    for words in PAGES:
        assert main([*words, "--help"]) == process.FINE
        shown = capfd.readouterr().out
        assert max(map(len, shown.splitlines())) <= 80
        for inner in (
            "None",
            "False",
            "STR",
            "INT",
            "FLOAT",
            "ENGINES",
            "{[",
            "tyro",
            "(default: )",
        ):
            assert inner not in shown, words


@pytest.mark.parametrize(
    ("flags", "options"), [(SamplingFlags, Sampling), (DetectionFlags, DetectorOptions)]
)
def test_flags_have_the_defaults_of_the_library(flags, options):
    assert vars(flags()) == vars(options())


def test_assignments_become_values_in_their_kind():
    values = parse_assignments(["a.b=1", "a.c.d=0.5", "e=[x, y]", "a.f=off", "g=a=b"])
    assert values == {"a.b": 1, "a.c.d": 0.5, "e": ["x", "y"], "a.f": False, "g": "a=b"}


def test_configuration_with_changes():
    changes = (("static.num_objects=7", "input.close_px=5"), ("static.num_objects=9",))
    config = load_config_with("default", changes)
    assert (config.static.num_objects, config.input.close_px) == (9, 5)
