from pathlib import Path

from remind_jax.cli.summary import print_summary
from tests.outputs.fake_run import make_run


def test_times_are_told_with_what_went_into_compiling(capsys, monkeypatch):
    monkeypatch.delenv("COLUMNS", raising=False)
    _, result = make_run()
    print_summary(result, Path("runs/tour"))
    assert "first identities after 0.8 s, 6.2 s spent on compiling" in capsys.readouterr().out


def test_the_summary_fits_a_terminal(capsys, monkeypatch):
    monkeypatch.setenv("COLUMNS", "80")
    _, result = make_run()
    print_summary(result, Path("runs/tour"), ["a note that goes on " * 8])
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines)) <= 80
    assert lines[-1].endswith("report.html")
