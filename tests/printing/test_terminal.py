import pytest

from remind_jax.errors import SourceError
from remind_jax.metrics import ComparisonTable, Row
from remind_jax.printing.terminal import print_lines, print_markdown, print_table

WIDE = [
    ["name", *(f"column {i}" for i in range(20))],
    *([f"row {i}", *(f"cell {i}/{k}" for k in range(20))] for i in range(3)),
]


@pytest.fixture(params=[80, 60])
def width(request, monkeypatch):
    monkeypatch.setenv("COLUMNS", str(request.param))
    return request.param


def fits(text: str, width: int) -> bool:
    return max(map(len, text.splitlines())) <= width


def test_a_wide_table_is_shared_out_with_its_first_column(width, capsys):
    print_table(WIDE, "title")
    text = capsys.readouterr().out
    assert fits(text, width)
    assert all(cell in text for row in WIDE for cell in row)
    assert text.count("row 2") == text.count("column 0") * text.count("name") > 1
    assert text.count("title") == 1


def test_in_a_file_tables_are_as_wide_as_they_are_and_markdown_stays(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    print_table(WIDE)
    assert capsys.readouterr().out.count("row 2") == 1
    text = "## Best\n\n| name |\n| --- |\n| x |"
    print_markdown(text)
    assert capsys.readouterr().out == text + "\n"


def test_a_cell_that_is_too_long_is_folded_whole(width, capsys):
    print_table([["a", "b"], ["x", "0123456789" * 20]])
    text = capsys.readouterr().out
    assert fits(text, width)
    assert sum(text.count(digit) for digit in "0123456789") == 200


def test_cells_are_no_markup(width, capsys):
    print_table([["a"], ["[bold]x[/bold]"]])
    assert "[bold]x[/bold]" in capsys.readouterr().out


def test_sentences_wrap_and_paths_stay_whole(width, capsys):
    path = "/home/somebody/runs/" + "long_name_of_a_folder/" * 4
    print_lines("word " * 40, f"output in {path}")
    lines = capsys.readouterr().out.splitlines()
    assert all(len(line) <= width or line.strip() == path for line in lines)
    assert any(line.strip() == path for line in lines)


def test_tables_of_markdown_are_drawn(width, capsys):
    print_markdown("## Best\n\n| name | a\\|b |\n| --- | --- |\n| x | 0.5 |\n\nMean: 1")
    text = capsys.readouterr().out
    assert text.splitlines()[0] == "Best"
    assert "---" not in text
    assert "a|b" in text
    assert "0.5" in text
    assert text.rstrip().endswith("Mean: 1")


def test_a_comparison_of_many_methods_and_scores_fits(width, capsys):
    names = ["HOTA", "DetA", "AssA", "IDF1", "IDP", "IDR", "MOTA", "Recovery", "IDSW", "IDs"]
    rows = [Row(f"a method {i}", dict.fromkeys(names, 0.5), note="ran " * 20) for i in range(12)]
    ComparisonTable(rows, names, title="all").print()
    text = capsys.readouterr().out
    assert fits(text, width)
    assert all(name in text for name in [*names[:7], "IDSW", "note", "a method 11"])


def test_names_of_others_command_no_terminal(monkeypatch, capsys):
    monkeypatch.delenv("COLUMNS", raising=False)
    print_lines("a \x1b[31mred \u202e name")
    print_markdown("# \x1b[2J")
    print_table([["name"], ["\x07"]])
    shown = capsys.readouterr().out
    assert not set(shown) & set("\x1b\u202e\x07")
    assert "a \\x1b[31mred \\u202e name" in shown
    assert str(SourceError("a\nb\x1b")) == "a\\nb\\x1b"
