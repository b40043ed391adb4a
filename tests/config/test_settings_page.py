"""The page of settings is complete and says what the records say."""

import importlib
from pathlib import Path

import pytest

from remind_jax.config import Config, reference_keys
from remind_jax.config.dotted_keys import flatten
from remind_jax.config.reference_keys import decided_settings
from remind_jax.method import PAPER_METHOD, list_methods

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def page():
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(DOCS)
        return importlib.import_module("settings_page")


def rows(page, method=PAPER_METHOD):
    return {
        f"{section.path}.{name}": (default, unit, record)
        for section in page.list_sections(method)
        for name, default, unit, record in section.rows
    }


def test_every_field_is_a_setting(page):
    fields = {key for key, _ in flatten(Config().to_dict())}
    assert set(rows(page)) == fields - {"tracker", "backbone_profile", "profile"}


@pytest.mark.parametrize("method", list_methods())
def test_every_setting_has_default_unit_and_meaning(page, method):
    found = rows(page, method)
    assert found
    for path, (default, unit, record) in found.items():
        assert default, path
        assert unit not in ("", "number"), path
        assert record.meaning, path


def test_every_number_of_the_paper_has_an_effect_and_nothing_else_has(page):
    values = dict(flatten(Config().to_dict()))
    for path, (_, _, record) in rows(page).items():
        assert bool(record.more) == bool(record.unit) == counts(values[path]), path


def counts(value):
    if isinstance(value, list):
        return any(isinstance(item, int) for item in value)
    return isinstance(value, (int, float)) and not isinstance(value, bool)


def test_every_translated_key_of_the_original_stands_beside_its_setting(page):
    text = page.render_page().replace("<wbr>", "")
    for key in (*decided_settings(Config()), *reference_keys.SHIPPED):
        assert f"<small>{key}</small>" in text


def test_symbols_of_the_paper_are_listed(page):
    row = "| *τ*<sub>match</sub> | `thresholds.matching.match` | `0.75` |"
    assert row in page.render_page()


def test_the_page_is_up_to_date(page):
    written = (DOCS / "thresholds.md").read_text(encoding="utf-8")
    assert written == page.render_page(), "run `make docs`"
    rules = (DOCS / "method_plus.md").read_text(encoding="utf-8")
    assert rules == page.with_settings(rules), "run `make docs`"


def test_the_page_is_written_where_it_is_asked_for(page, tmp_path, capsys):
    rules = tmp_path / "rules.md"
    rules.write_text("# Rules\n", encoding="utf-8")
    assert page.main([str(tmp_path / "page.md"), str(rules)]) == 0
    assert rules.read_text(encoding="utf-8").startswith(f"# Rules\n{page.MARK}\n## Thresholds")
    assert page.main([]) == 0
    assert (tmp_path / "page.md").read_text(encoding="utf-8") == capsys.readouterr().out
