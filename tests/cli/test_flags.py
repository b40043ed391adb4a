"""Flags are read and told in the words of the shell."""

from __future__ import annotations

import re

import pytest

from remind_jax.backbone.registry import list_backbones
from remind_jax.cli import process
from remind_jax.cli.flags import DetectionFlags, SamplingFlags
from remind_jax.cli.main import VERBS, main
from remind_jax.detectors.options import DetectorOptions
from remind_jax.method import list_methods
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


@pytest.mark.parametrize("verb", ["run", "benchmark", "sweep"])
def test_help_lists_every_backbone(help_of, verb):
    told = help_of(verb).partition("--backbone")[2].partition("(default")[0]
    named = set(re.findall(r"[\w-]+", told))
    assert set(list_backbones()) <= named


def test_help_lists_every_tracker(help_of):
    told = help_of("run").partition("--tracker")[2].partition("if left")[0]
    assert set(list_methods()) <= set(re.findall(r"[\w-]+", told))


OUT_OF_RANGE = {
    "--start 10 --end 5": "--end is 5; it is the frame to stop before and must lie after --start",
    "--fps 0": "--fps is 0; give a number from 1e-06 to 1000000",
    "--fps 5 --stride 2": "both --fps (5) and --stride (2) are given; give one",
    "--stride 0": "--stride is 0; give a whole number from 1 to",
    "--start -1": "--start is -1; give a whole number from 0",
    "--max-frames 0": "--max-frames is 0; give a whole number from 1",
    "--confidence 3": "--confidence is 3; give a number from 0 to 1",
    "--input-size-px 7": "--input-size-px is 7; give a whole number from 32",
}
WRONG_KIND = {
    "--stride many": "'many' is no whole number",
    "--stride 1_0": "'1_0' is no whole number",
    "--stride ٣": "is no whole number",
    "--fps fast": "'fast' is no number",
    "--fps 1_0.5": "'1_0.5' is no number",
    "--confidnce 0.3": "--confidence",
}


def test_a_value_that_makes_no_sense_is_told_by_its_flag(capfd):
    for words, told in (OUT_OF_RANGE | WRONG_KIND).items():
        assert main(["run", "rooms.mp4", *words.split()]) == process.USAGE
        said = capfd.readouterr().err
        assert said.startswith("remind: "), said
        assert said.count("\n") == 1, said
        assert told in said, said
        assert words in OUT_OF_RANGE or "remind run --help" in said


def test_options_checked_later_are_told_by_their_flag_too(command, scene):
    outcome = command("run", scene[0], "--masks", scene[1], "--image-fps", "0")
    assert outcome.code == process.USAGE
    assert outcome.stderr == "remind: --image-fps is 0; give a number from 1e-06 to 1000000\n"


def test_none_is_a_name_like_any_other(capfd):
    assert main(["explain", "None", "--frame", "0"]) == process.ERROR
    assert "None" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("flags", "options"), [(SamplingFlags, Sampling), (DetectionFlags, DetectorOptions)]
)
def test_flags_have_the_defaults_of_the_library(flags, options):
    assert vars(flags()) == vars(options())
