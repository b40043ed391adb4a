"""Flags are read and told in the words of the shell."""

from __future__ import annotations

import pytest

from remind_jax.cli import process
from remind_jax.cli.flags import DetectionFlags, SamplingFlags
from remind_jax.cli.main import VERBS, main
from remind_jax.detectors.options import DetectorOptions
from remind_jax.sources.sampling import Sampling

ACTIONS = ("list", "show", "diff", "validate", "import-reference")
PAGES = [(verb,) for verb in VERBS] + [("config", action) for action in ACTIONS]


@pytest.fixture
def help_of(monkeypatch, capfd):
    """The help of a verb on a terminal of 80 columns."""
    monkeypatch.setenv("COLUMNS", "80")

    def show(*words: str) -> str:
        capfd.readouterr()
        assert main([*words, "--help"]) == process.FINE
        return capfd.readouterr().out

    return show


@pytest.mark.parametrize("words", PAGES, ids="-".join)
def test_help_speaks_no_python_and_fits_80_columns(help_of, words):
    shown = help_of(*words)
    assert max(map(len, shown.splitlines())) <= 80
    for inner in ("None", "False", "STR", "INT", "FLOAT", "ENGINES", "{[", "tyro", "(default: )"):
        assert inner not in shown


@pytest.mark.parametrize(
    ("flags", "options"), [(SamplingFlags, Sampling), (DetectionFlags, DetectorOptions)]
)
def test_flags_have_the_defaults_of_the_library(flags, options):
    assert vars(flags()) == vars(options())
