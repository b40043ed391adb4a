"""What became of a case: it runs in a forked child with limits, and is judged by what it left."""

from __future__ import annotations

import collections
import dataclasses
import os
import random
import re
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
import warnings
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from tests.corpus.mutations import Change, change_file
from tests.corpus.seeds import FORMATS, Refused, refusal

LIMIT_S = 60.0
LIMIT_BYTES = 2 << 30  # above what the process has before
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e]")
GOOD = ("refused", "accepted")


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How a case ended."""

    kind: str  # one of `GOOD`, or "traceback", "hang", "signal", "memory", "wordy", "escape",
    # "accepted though invalid"
    change: Change
    told: str  # the last line that was written, or the place of the traceback


def run_case(name: str, seed: int, limit_s: float = LIMIT_S) -> Verdict:
    """Makes, changes and enters one file of a format; the same seed is the same case."""
    form = FORMATS[name]
    rng = random.Random(zlib.crc32(name.encode()) + seed)
    folder = Path(tempfile.mkdtemp(prefix="corpus"))
    try:
        path = form.write(folder)
        change = change_file(path, form.kind, rng)
        return _judge(*_enter(form.enter, path, folder, limit_s), change)
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _enter(
    enter: Callable[[Path], Any], path: Path, folder: Path, limit_s: float
) -> tuple[int, str, str]:
    """Status of the child, what it wrote, and where it broke."""
    written, broken = folder / ".written", folder / ".broken"
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of JAX about forks: no child computes with it
        child = os.fork()
    if child == 0:
        _be_a_child(enter, path, written, broken)
    deadline = time.monotonic() + limit_s
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            return -1, "", ""
        time.sleep(0.002)
    told = written.read_text(errors="replace") if written.exists() else ""
    return status, told, broken.read_text(errors="replace") if broken.exists() else ""


def _be_a_child(enter: Callable[[Path], Any], path: Path, written: Path, broken: Path) -> None:
    os.chdir(path.parent)
    sink = os.open(written, os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(sink, stream)
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
    used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
    resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
    code = 0
    try:
        enter(path)
    except MemoryError:
        code = 4
    except BaseException as error:
        code = 1 if refusal(error) else 3
        if code == 3:
            broken.write_text("".join(traceback.format_exception(error)))
        elif not isinstance(error, Refused):
            print(f"remind: {error}", file=sys.stderr)
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(code)


def _judge(status: int, told: str, broken: str, change: Change) -> Verdict:
    if status == -1:
        return Verdict("hang", change, "")
    if os.WIFSIGNALED(status):
        return Verdict("signal", change, str(os.WTERMSIG(status)))
    code = os.WEXITSTATUS(status)
    lines = [line for line in told.splitlines() if line.strip()]
    last = lines[-1] if lines else ""
    if code == 4:
        return Verdict("memory", change, last)
    if code == 3:
        places = [line.strip() for line in broken.splitlines() if "remind_jax/" in line]
        where = re.sub(r".*remind_jax/", "", places[-1]) if places else "?"
        return Verdict("traceback", change, f"{where}: {broken.splitlines()[-1][:120]}")
    if CONTROL.search(told):
        return Verdict("escape", change, repr(last[:120]))
    if code == 1:
        is_sentence = sum(line.startswith("remind: ") for line in lines) == 1
        return Verdict("refused" if is_sentence else "wordy", change, told[-300:])
    return Verdict("accepted though invalid" if change.is_invalid else "accepted", change, last)


def count(verdicts: list[tuple[str, int, Verdict]]) -> str:
    """A table of formats and ends, and what bad ones have in common, the most frequent first."""
    kinds = sorted({verdict.kind for _, _, verdict in verdicts})
    by_format = collections.Counter((name, verdict.kind) for name, _, verdict in verdicts)
    rows = [["format", *kinds]]
    rows += [[name, *(str(by_format[name, kind] or "") for kind in kinds)] for name in FORMATS]
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + " --- |" * len(rows[0]))
    causes = collections.defaultdict(list)
    for name, seed, verdict in verdicts:
        if verdict.kind not in GOOD:
            told = re.sub(r"\d+", "#", verdict.told)
            causes[verdict.kind, name, told[:100]].append((seed, verdict))
    lines += ["", "| times | end | format | first seed | change | said |", "|" + " --- |" * 6]
    for (kind, name, _), cases in sorted(causes.items(), key=lambda item: -len(item[1])):
        seed, first = cases[0]
        said = first.told.replace("|", "/").replace("\n", " ")[:140]
        lines.append(f"| {len(cases)} | {kind} | {name} | {seed} | {first.change.name} | {said} |")
    return "\n".join(lines) + "\n"
