"""The `remind` command: parses the verb, runs it, turns errors into sentences and exit codes."""

from __future__ import annotations

import contextlib
import inspect
import io
import os
import re
import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any, Protocol, Union

import tyro
from tyro.conf import subcommand

import remind_jax
from remind_jax.cli import process, streams
from remind_jax.cli.backbones import Backbones
from remind_jax.cli.benchmark import Benchmark
from remind_jax.cli.calibrate import Calibrate
from remind_jax.cli.config import ConfigVerb
from remind_jax.cli.convert import Convert
from remind_jax.cli.demo import Demo
from remind_jax.cli.eval import Eval
from remind_jax.cli.explain import Explain
from remind_jax.cli.export import Export
from remind_jax.cli.flags import KINDS, UsageError, spell_flag
from remind_jax.cli.label import Label
from remind_jax.cli.memory import Memory
from remind_jax.cli.run import Run
from remind_jax.cli.sweep import Sweep
from remind_jax.cli.view import View
from remind_jax.cli.warmup import Warmup
from remind_jax.errors import OptionError, RemindError, first_line, is_text, nearest_names
from remind_jax.printing.terminal import printable

# The compiler's alarms ("Very slow compile? If you want to file a bug, ...") are meant for its own
# developers and are written past Python; what really fails is raised as well. The compiler reads
# this once, when a verb first imports JAX.
os.environ.setdefault("TF_CPP_MIN_LOG_LEVEL", "3")

DESCRIPTION = """Which mug is which? Gives every object in a video an identity that lasts.

First steps:
  remind demo                               a minute, needs nothing
  remind run VIDEO --detector MODEL.onnx    your own video
  remind run FOLDER --masks MASKS           your own images and instance masks
  remind run --help                         everything that can be chosen

Exit codes: 0 fine; 1 wrong input, configuration or output, in one sentence;
2 wrong usage; 70 a defect of remind, told with a file to report;
130 stopped by Ctrl-C, 143 by SIGTERM, 129 by SIGHUP: what was done is kept."""


class Verb(Protocol):
    """A verb with its flags, as parsed."""

    def execute(self) -> int | None:
        """Does what was asked; returns the exit code, if it is another than that of success.

        Raises:
          RemindError: If anything that was named is not accepted, or nothing can be written.
        """
        ...


VERBS: dict[str, type[Verb]] = {
    "run": Run,
    "demo": Demo,
    "view": View,
    "memory": Memory,
    "explain": Explain,
    "export": Export,
    "label": Label,
    "eval": Eval,
    "benchmark": Benchmark,
    "sweep": Sweep,
    "backbones": Backbones,
    "calibrate": Calibrate,
    "convert": Convert,
    "warmup": Warmup,
    "config": ConfigVerb,
}


def main(argv: Sequence[str] | None = None) -> int:
    """Runs one command; returns the exit code."""
    words = list(sys.argv[1:] if argv is None else argv) or ["--help"]
    if words[0] == "help":
        words = [*words[1:], "--help"]
    code = process.FINE
    with streams.own_streams() as chatter:
        try:
            code = _execute(words, chatter)
            sys.stdout.flush()
            return code
        except streams.OutputStops as error:
            if code != process.FINE:  # a signal, such as that the terminal was closed
                return code
            if error.is_reader_gone:
                return process.BROKEN_PIPE
            process.complain(f"cannot write to standard output: {error}; send it elsewhere")
            return process.ERROR


def _execute(words: Sequence[str], chatter: Callable[[], str]) -> int:
    """Parses and runs a verb; returns the exit code."""
    if words[0] in ("--version", "-V"):
        print(f"remind-jax {remind_jax.__version__}")
        return process.FINE
    if wrong := next((word for word in words if not is_text(word)), None):
        process.complain(f"{wrong[:80]!r} is no text in UTF-8; rename the file, or correct it")
        return process.USAGE
    if not words[0].startswith("-") and words[0] not in VERBS:
        hint = nearest_names(words[0], VERBS)
        process.complain(f"there is no verb {words[0]!r}; {hint}")
        return process.USAGE
    signals: list[int] = []
    try:
        verb = _parse(words)
        process.prepare_process()
        with process.ending_well() as signals:
            code = verb.execute() or process.FINE
        was_ended = signals and code == process.INTERRUPTED
        return process.stopped_by(signals[0]) if was_ended else code
    except SystemExit as stop:  # help was shown, or wrong usage explained
        return stop.code if isinstance(stop.code, int) else process.USAGE
    except UsageError as error:
        process.complain(str(error))
        return process.USAGE
    except OptionError as error:
        process.complain(error.spelled(spell_flag))
        return process.USAGE
    except RemindError as error:
        process.complain(str(error))
        for note in getattr(error, "__notes__", ()):
            print(printable(note), file=sys.stderr)
        return process.ERROR
    except KeyboardInterrupt:
        process.complain("stopped")
        return process.stopped_by(signals[0] if signals else None)
    except streams.OutputStops:
        raise
    except MemoryError as error:
        _complain_of_memory(str(error))
        return process.ERROR
    except Exception as error:
        if isinstance(error, PermissionError) and error.filename is not None:
            process.complain(
                f"'{error.filename}' may not be read or written by this user; allow it, or choose "
                "another place"
            )
            return process.ERROR
        if "RESOURCE_EXHAUSTED" in str(error):  # as the compiler says it
            _complain_of_memory(first_line(error))
            return process.ERROR
        if fault := process.find_jax_fault():
            process.complain(fault)
            return process.ERROR
        process.report_failure(error, chatter())
        return process.FAILED


def _complain_of_memory(said: str) -> None:
    process.complain(
        f"there is not enough memory ({said or 'no more could be had'}); what was written so far "
        "is kept, give smaller frames, fewer detections or fewer settings at once"
    )


def _parse(words: Sequence[str]) -> Verb:
    """The verb with its flags; shows help and exits, or refuses wrong usage."""
    parse: Any = tyro.cli  # its stubs know no unions made at run time
    asked: Any = VERBS.get(words[0])
    if asked is not None:  # alone, so that no other verb is suggested
        about = {"prog": f"remind {words[0]}", "description": inspect.getdoc(asked)}
        words = words[1:]
    else:
        about = {"prog": "remind", "description": DESCRIPTION}
        choices = tuple(
            Annotated[verb, subcommand(name, description=str(verb.__doc__).partition("\n")[0])]
            for name, verb in VERBS.items()
        )
        asked = Union[choices]  # noqa: UP007
    with _in_one_sentence():
        return parse(
            asked,
            args=words,
            config=(
                tyro.conf.FlagCreatePairsOff,
                tyro.conf.OmitArgPrefixes,
                tyro.conf.OmitSubcommandPrefixes,
                tyro.conf.DisallowNone,
            ),
            registry=KINDS,
            **about,
        )


@contextlib.contextmanager
def _in_one_sentence() -> Iterator[None]:
    """Turns what the parser puts into a box into one sentence."""
    box = io.StringIO()
    try:
        with contextlib.redirect_stderr(box):
            yield
    except SystemExit as stop:
        if not stop.code:
            raise
        # Below its title are parts with a line between them; the last one names the help.
        text = re.sub("[\u2500-\u257f]|-{8,}", "", box.getvalue().partition("\n")[2])
        parts = [" ".join(part.split()) for part in re.split(r"\n\s*\n", text)]
        raise UsageError("; ".join(filter(None, parts))) from stop


if __name__ == "__main__":
    sys.exit(main())
