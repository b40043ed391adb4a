"""A quick share of the fuzzer (`make fuzz`), and that it sees what it looks for."""

import time

import pytest

from remind_jax.errors import SourceError
from tests.corpus import judge
from tests.corpus.seeds import FORMATS, Format

pytestmark = pytest.mark.heavy


@pytest.mark.parametrize("name", FORMATS)
def test_the_unchanged_file_is_accepted(name, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    path = FORMATS[name].write(tmp_path)
    FORMATS[name].enter(path)


@pytest.mark.parametrize("name", FORMATS)
def test_a_changed_file_is_refused_told_or_good(name):
    """A quick share; what becomes of a case follows from its seed alone."""
    for seed in range(2):
        verdict = judge.run_case(name, seed, limit_s=30.0)
        assert verdict.kind in judge.GOOD, (seed, verdict)


def _text(folder):
    path = folder / "words.txt"
    path.write_text("1,2\n")
    return path


def _refuse(path):
    raise SourceError("it is no good; give another")


@pytest.mark.parametrize(
    ("enter", "kind"),
    [
        (_refuse, "refused"),
        (lambda path: {}["x"], "traceback"),
        (lambda path: print("\x1b[31m"), "escape"),
        (lambda path: time.sleep(600), "hang"),
        (lambda path: bytearray(8 << 30), "memory"),
        (lambda path: None, "accepted"),
    ],
)
def test_every_end_is_seen(enter, kind, monkeypatch):
    monkeypatch.setitem(FORMATS, "made up", Format("bytes", _text, enter))
    verdict = judge.run_case("made up", 1, limit_s=2.0)
    assert verdict.kind == kind
