"""Parsing, help, exit codes of the command as a whole."""

from remind_jax import __version__
from remind_jax.cli import main as main_module
from remind_jax.cli import process as exit_codes
from remind_jax.cli.main import VERBS, main
from remind_jax.errors import SourceError
from tests.cli.test_streams import REMIND, run, run_python

HEAVY = ("jax", "torch", "matplotlib", "onnxruntime", "pandas", "supervision")


def test_help_of_every_verb_answers_without_jax():
    finished = run_python(
        f"""
        import sys
        from remind_jax.cli.main import VERBS, main
        codes = [main(["--help"]), *(main([verb, "--help"]) for verb in VERBS)]
        print("codes", set(codes), "loaded", [name for name in {HEAVY} if name in sys.modules])
        """
    )
    assert finished.stderr == ""
    assert finished.stdout.splitlines()[-1] == "codes {0} loaded []"


def test_no_words_show_help(command, capfd):
    assert main([]) == exit_codes.FINE
    shown = capfd.readouterr().out
    assert all(verb in shown for verb in VERBS)


def test_version(command):
    assert command("--version").stdout == f"remind-jax {__version__}\n"


def raising(error: BaseException):
    class Verb:
        def execute(self) -> int:
            raise error

    return lambda words: Verb()


def test_errors_become_one_sentence_and_notes(monkeypatch, capfd):
    error = SourceError("'a' is no source")
    error.add_note("what was done is in b")
    for raised, code, told in (
        (error, exit_codes.ERROR, "remind: 'a' is no source\nwhat was done is in b\n"),
        (KeyboardInterrupt(), exit_codes.INTERRUPTED, "remind: stopped\n"),
    ):
        monkeypatch.setattr(main_module, "_parse", raising(raised))
        assert main(["run"]) == code
        assert capfd.readouterr().err == told


def test_real_process_says_one_sentence(tmp_path):
    finished = run([*REMIND, "run", "missing.mp4"], cwd=tmp_path)
    assert finished.returncode == exit_codes.ERROR
    assert finished.stdout == ""
    assert finished.stderr == "remind: 'missing.mp4' does not exist\n"
    assert list(tmp_path.iterdir()) == []


def test_a_defect_of_ours_ends_in_one_sentence_and_a_file(monkeypatch, capfd, tmp_path):
    def break_down(verb):
        raise KeyError("inner\nthing")

    monkeypatch.setattr(main_module.VERBS["view"], "execute", break_down)
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr("tempfile.tempdir", None)
    assert main(["view", "anything"]) == exit_codes.FAILED
    told = capfd.readouterr().err
    assert told.startswith("remind: this should not have happened (KeyError: ")
    assert told.count("\n") == 1
    (kept,) = tmp_path.glob("remind-*.traceback.txt")
    assert str(kept) in told
    assert "break_down" in kept.read_text()


def test_too_little_memory_is_said(monkeypatch, capfd):
    def take_all(verb):
        raise MemoryError

    monkeypatch.setattr(main_module.VERBS["view"], "execute", take_all)
    assert main(["view", "anything"]) == exit_codes.ERROR
    assert "there is not enough memory" in capfd.readouterr().err
