"""Figures stand on pages as they were measured, and nowhere else."""

import json
import re

import pytest

from benchmarks import headline
from benchmarks.pages import fill, marks, without_tables

TABLES = headline.tables_of(json.loads(headline.DATA.read_text()))
# Percent with decimals, as figures are written; versions and settings are not.
FIGURE = re.compile(r"\b\d{1,3}\.\d+ ?%|\b\d{2,3}\.\d{1,2}\b")


@pytest.mark.parametrize("page", headline.PAGES, ids=lambda page: page.name)
def test_pages_show_what_was_measured(page):
    text = page.read_text(encoding="utf-8")
    assert fill(text, TABLES) == text, "stale figures; python benchmarks/headline.py --write-only"
    assert set(marks(text)) <= set(TABLES)


def test_every_table_stands_somewhere():
    assert {mark for page in headline.PAGES for mark in marks(page.read_text())} == set(TABLES)


@pytest.mark.parametrize("page", headline.PAGES, ids=lambda page: page.name)
def test_no_figure_is_written_by_hand(page):
    assert not FIGURE.findall(without_tables(page.read_text(encoding="utf-8")))


def test_a_stale_figure_is_found():
    stale = "It has:\n<!-- figures:tours -->\n\n| 1 |\n\n<!-- end -->\nand 90.2 % in all."
    assert fill(stale, TABLES) != stale
    assert fill(fill(stale, TABLES), TABLES) == fill(stale, TABLES)
    assert fill(stale, {}) == stale
    assert FIGURE.findall(without_tables(stale)) == ["90.2 %"]


def test_of_the_trackers_of_others_the_best_setting_is_shown():
    scores = {"IDF1": 0.5, "AssA": 0.5, "recovered": 1, "kept": 1, "at_once": 1, "merged": 0}
    scores |= {"returns": 3, "pairs": 2}
    titles = ("ours, closeups", "X (p), published", "X (q), open", "Y (p), open")
    pooled = {title: {**scores, "IDF1": 0.1 * n} for n, title in enumerate(titles)}
    data = {"tours": {}, "clips": pooled, "turns": {}, "people": {}}
    table = headline.tables_of(data)["figures:clips"]
    shown = [line.split("|")[1].strip() for line in table.splitlines()[2:] if "|" in line]
    assert shown == ["ours, closeups", "X (q), open", "Y (p), open"]
    assert "recovered of 3" in table
