"""Text that a spreadsheet would calculate is guarded, and comes back as it was."""

import csv
import dataclasses
import io

import pytest
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.files.csv_cells import guard_cell, unguard_cell
from remind_jax.metrics.comparison import ComparisonTable, Row
from remind_jax.outputs import tables
from remind_jax.sweeps.records import Row as SweptRow
from remind_jax.sweeps.result import SweepResult
from tests.outputs.fake_run import make_run

FORMULAS = ["=1+1", "+1+1", "-1-1", "-A1", "@SUM(A1)", "\t=1", "\r=1", "\n=1", "'=1"]


def read_back(text: str) -> list[list[str]]:
    return list(csv.reader(io.StringIO(text, newline="")))


@given(st.text())
def test_taking_the_guard_off_gives_the_text(text):
    assert unguard_cell(guard_cell(text)) == text
    cell = guard_cell(text)
    assert not cell.startswith(("=", "+", "-", "@", "\t", "\r", "\n")) or float(cell) is not None


@pytest.mark.parametrize("value", [-1, -0.5, 0, True, None, 1e-9, "-0.5", "+1", "-1e-09", "-.5"])
def test_what_is_no_text_stays(value):
    assert guard_cell(value) is value


@pytest.mark.parametrize("formula", FORMULAS)
def test_labels_of_a_run_are_guarded(formula, tmp_path):
    _, result = make_run(num_frames=1)
    (frame,) = result.tracks
    frame = dataclasses.replace(frame, labels=(formula,) * len(frame), name=formula)
    with tables.csv_writer(tmp_path / "tracks.csv") as writer:
        writer.add(frame)
    with (tmp_path / "tracks.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert rows
    for row in rows:
        for name in ("label", "name"):
            assert row[name] == "'" + formula
            assert unguard_cell(row[name]) == formula
        assert float(row["left"]) >= 0


@pytest.mark.parametrize("formula", FORMULAS)
def test_names_in_tables_of_scores_and_sweeps_are_guarded(formula):
    table = ComparisonTable((Row(formula, {"IDF1": -0.5}, note=formula),), ("IDF1",))
    _, row = read_back(table.to_csv())
    assert (row[0], row[1], row[-1]) == ("'" + formula, "-0.5", "'" + formula)
    swept = SweptRow("", formula, {"decision.new": -1.0}, {"IDF1": 0.5})
    result = SweepResult(({"decision.new": -1.0},), (formula,), ((swept,),), 1, 0)
    _, cells = read_back(result.to_csv())
    assert cells == ["0", "'" + formula, "-1.0", "0.5"]
