"""The page of settings is complete and says what the code says."""

import dataclasses
from pathlib import Path

import pytest

from remind_jax.config import Config, reference_page, reference_switches
from remind_jax.config.dotted_keys import flatten
from remind_jax.config.effects import NUMBERS
from remind_jax.config.reference_keys import CHOICES, RENAMED, SLOTS, SUBSETS
from remind_jax.config.reference_page import (
    SWITCHES,
    list_sections,
    original_keys,
    read_comments,
    render_page,
)
from remind_jax.method import PAPER_METHOD, list_methods

PAGE = Path(__file__).parents[2] / "docs" / "thresholds.md"


@dataclasses.dataclass(frozen=True)
class Sample:
    """Fields with all kinds of comments."""

    behind: int = 1  # what it is [tau_x]
    # Above it,
    # on two lines.
    above: tuple[str, ...] = ("a", "# no comment")
    wrapped: tuple[int, int] = (
        1,
        2,
    )  # at the end
    silent: int = 2


def settings(method=PAPER_METHOD):
    return {
        f"{section.path}.{row.name}": row
        for section in list_sections(method)
        for row in section.settings
    }


def test_comments_are_found_behind_and_above_their_fields():
    assert read_comments(Sample) == {
        "behind": "what it is [tau_x]",
        "above": "above it, on two lines",
        "wrapped": "at the end",
    }


def test_every_field_is_a_setting():
    fields = {key for key, _ in flatten(Config().to_dict())}
    assert set(settings()) == fields - {"tracker", "backbone_profile"}


@pytest.mark.parametrize("method", list_methods())
def test_every_setting_has_meaning_and_default(method):
    rows = settings(method)
    assert rows
    # The numbers of other trackers may be said by their section alone.
    lacking = [path for path, row in rows.items() if not row.meaning]
    assert not lacking or method != PAPER_METHOD, lacking
    assert all(row.default for row in rows.values())


def test_every_number_has_unit_and_effect_and_nothing_else_has():
    values = dict(flatten(Config().to_dict()))
    numbers = {path.removeprefix("thresholds.") for path, value in values.items() if counts(value)}
    listed = {f"{section}.{name}" for section, names in NUMBERS.items() for name in names}
    assert listed == numbers
    assert all(unit and effect for names in NUMBERS.values() for unit, effect in names.values())


def counts(value):
    if isinstance(value, list):
        return any(isinstance(item, int) for item in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def test_every_translated_key_of_the_original_stands_beside_its_setting():
    shown = {key for row in settings().values() for key in row.keys}
    assert shown == {*RENAMED, *CHOICES, *SLOTS, *SUBSETS, *reference_switches.SHIPPED}
    assert set(original_keys()) <= set(settings())


def test_switches_name_what_the_translation_decides():
    assert set(SWITCHES) == set(reference_switches.decide({}))


def test_symbols_stand_alone():
    match = settings()["thresholds.matching.match"]
    assert (match.meaning, match.symbol) == ("least final score of a match", "tau_match")
    bounds = settings()["thresholds.known_sets.min_reliability"]
    assert bounds.symbol is None
    assert bounds.meaning.endswith("[0, 1]")
    assert "*τ*<sub>match</sub> | `thresholds.matching.match` | `0.75`" in render_page()


def test_the_page_is_up_to_date():
    assert PAGE.read_text(encoding="utf-8") == render_page(), "run `make docs`"


def test_the_page_is_written_where_it_is_asked_for(tmp_path, capsys):
    assert reference_page.main([str(tmp_path / "page.md")]) == 0
    assert reference_page.main([]) == 0
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == capsys.readouterr().out
