"""A quiet terminal stays quiet; output that goes nowhere is no defect."""

import os
import subprocess
import sys
import textwrap
from pathlib import Path
from typing import Any

import pytest

from remind_jax.cli import process as exit_codes

REMIND = (sys.executable, "-m", "remind_jax.cli.main")
FULL = Path("/dev/full")
QUIET = {name: value for name, value in os.environ.items() if name != "TF_CPP_MIN_LOG_LEVEL"}
# What a library does: writes past Python, warns, and a thread that breaks.
CHATTER = """
    import os, sys, warnings
    import numpy as np
    from remind_jax.cli import main as module

    def chat(verb):
        os.write(2, b"libpng error: bad adaptive filter value\\n")
        warnings.warn("old-fashioned")
        np.float32(1) / np.float32(0)
        print("ours", file=sys.stderr)
        {end}

    module.VERBS["view"].execute = chat
    sys.exit(module.main(["view", "x"]))
"""


def run(words: Any, **options: Any) -> subprocess.CompletedProcess[str]:
    """A process, with its output unless it goes elsewhere."""
    given = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "env": QUIET}
    return subprocess.run(words, text=True, timeout=120, check=False, **given | options)


def run_python(code: str, **variables: str) -> subprocess.CompletedProcess[str]:
    """A process of its own in which nobody asked for the alarms of the compiler."""
    return run([sys.executable, "-c", textwrap.dedent(code)], env={**QUIET, **variables})


def test_libraries_say_nothing():
    finished = run_python(CHATTER.format(end="return 0"))
    assert (finished.returncode, finished.stdout, finished.stderr) == (0, "", "ours\n")


def test_who_asks_hears_them():
    finished = run_python(CHATTER.format(end="return 0"), TF_CPP_MIN_LOG_LEVEL="0")
    assert "libpng error" in finished.stderr
    assert "old-fashioned" in finished.stderr


def test_a_report_keeps_what_they_said(tmp_path):
    finished = run_python(CHATTER.format(end="raise KeyError('x')"), TMPDIR=str(tmp_path))
    assert finished.returncode == exit_codes.FAILED
    assert finished.stderr.count("\n") == 2
    (kept,) = tmp_path.glob("remind-*.traceback.txt")
    assert "libpng error: bad adaptive filter value" in kept.read_text()


SCORES = ("eval", "gt.txt", "gt.txt")


@pytest.fixture
def scored(tmp_path):
    (tmp_path / "gt.txt").write_text("1,1,0,0,5,5,1,1,1\n2,1,0,0,5,5,1,1,1\n")
    return tmp_path


@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
def test_full_standard_output_is_told_in_one_sentence(scored):
    with FULL.open("w") as full:
        finished = run([*REMIND, *SCORES], stdout=full, cwd=scored)
    assert finished.stderr == (
        "remind: cannot write to standard output: No space left on device; send it elsewhere\n"
    )
    assert finished.returncode == exit_codes.ERROR


@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
def test_full_standard_output_hides_no_signal():
    with FULL.open("w") as full:
        code = textwrap.dedent(CHATTER.format(end="print('done'); return 129"))
        assert run([sys.executable, "-c", code], stdout=full).returncode == 129


def test_a_reader_that_goes_away_is_no_error(scored):
    with subprocess.Popen(
        [*REMIND, *SCORES], stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=QUIET, cwd=scored
    ) as process:
        process.stdout.close()
        assert process.stderr.read() == b""
        assert process.wait(timeout=120) == exit_codes.BROKEN_PIPE


@pytest.mark.skipif(not FULL.exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("words", [("view", "none"), ("none",)])
def test_full_standard_error_changes_no_exit_code(words, tmp_path):
    with FULL.open("w") as full:
        finished = run([*REMIND, *words], stderr=full, cwd=tmp_path)
    expected = exit_codes.USAGE if len(words) == 1 else exit_codes.ERROR
    assert (finished.returncode, finished.stdout) == (expected, "")


@pytest.mark.parametrize("redirection", [">&-", ">&- 2>&-"])
def test_closed_streams_are_no_defect(redirection, scored):
    command = f"{' '.join([*REMIND, *SCORES])} {redirection}"
    finished = run(command, shell=True, cwd=scored)
    assert finished.stderr == ""
    assert finished.returncode == exit_codes.FINE


def test_letters_that_the_output_lacks_are_spelled():
    code = "import sys; from remind_jax.cli import main as m; "
    code += "m.VERBS['view'].execute = lambda verb: print('é日本'); sys.exit(m.main(['view', 'x']))"
    finished = run([sys.executable, "-c", code], env=QUIET | {"PYTHONIOENCODING": "ascii"})
    assert (finished.returncode, finished.stdout) == (0, "\\xe9\\u65e5\\u672c\n")
