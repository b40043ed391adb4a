import csv
import io
import math
from pathlib import Path

import pytest

from remind_jax.errors import OutputError
from remind_jax.metrics.comparison import Column, ComparisonTable, Row

TABLE = ComparisonTable(
    rows=[
        Row("ours & co", {"IDF1": 0.9, "IDSW": 5, "Recovery": math.nan}, {"IDF1": (0.85, 0.93)}),
        Row("[peer]", {"IDF1": 0.5, "IDSW": 2, "own": 1.5}, note="1 of 3 scenes | failed"),
    ],
    columns=["IDF1", "IDSW", "Recovery", Column("own", "ms", "lower", "t & $x$")],
    legend=["Scores in percent"],
    title="Rooms <1>",
)


def test_columns_that_do_not_fit_follow_below():
    lines = TABLE.to_text(width=60).splitlines()
    assert max(map(len, lines)) <= 60
    assert sum("ours & co" in line for line in lines) == 2
    assert all(any(score in line for line in lines) for score in ("90.00", "50.00", "1.5"))


def test_markdown_marks_the_best_and_keeps_its_columns():
    lines = TABLE.to_markdown().splitlines()
    assert "| ours & co | **90.00** (85.0 to 93.0) | 5 | - | - |  |" in lines
    assert "| [peer] | 50.00 | **2** | - | 1.5 | 1 of 3 scenes \\| failed |" in lines


def test_csv_keeps_full_precision():
    rows = list(csv.DictReader(io.StringIO(TABLE.to_csv())))
    assert float(rows[0]["IDF1_high"]) == 0.93
    assert float(rows[1]["IDF1"]) == 0.5
    assert (rows[1]["IDF1_low"], rows[0]["Recovery"]) == ("", "")
    assert "IDSW_low" not in rows[0]


def test_nothing_is_best_without_a_rival():
    assert "**" not in ComparisonTable([Row("a", {"IDF1": 1.0})], ["IDF1"]).to_markdown()
    tied = ComparisonTable([Row("a", {"IDF1": 1.0}), Row("b", {"IDF1": 1.0})], ["IDF1"])
    assert tied.to_markdown().count("**1") == 2


def test_what_failed_on_some_scenes_is_not_the_best():
    rows = [Row("a", {"IDF1": 0.9}, is_partial=True)]
    rows += [Row(name, {"IDF1": score}) for name, score in (("b", 0.8), ("c", 0.7))]
    lines = ComparisonTable(rows, ["IDF1"]).to_markdown().splitlines()[2:]
    assert lines == ["| a | 90.00 |", "| b | **80.00** |", "| c | 70.00 |"]


def test_bad_paths_are_refused(tmp_path: Path):
    with pytest.raises(OutputError, match=r"ends in '\.xlsx'; a table can be written as \.md"):
        TABLE.save(tmp_path / "table.xlsx")
    with pytest.raises(OutputError, match=r"cannot write '.*absent.*': there is no folder"):
        TABLE.save(tmp_path / "absent" / "table.md")
