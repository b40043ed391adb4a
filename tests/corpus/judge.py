"""What became of a case: it runs in a forked child with limits, and is judged by what it left."""

import collections
import contextlib
import dataclasses
import importlib
import os
import pickle
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
from pathlib import Path

from remind_jax.errors import RemindError
from tests.backbone.networks import converted_file
from tests.corpus.headers import Change
from tests.corpus.mutations import change_file
from tests.corpus.seeds import FORMATS, Format, Refused, Told

LIMIT_S = 60.0
LIMIT_BYTES = 2 << 30  # above what the process has before
CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f\u202a-\u202e]")
GOOD = ("refused", "told", "accepted")
LIBRARIES = (
    *("av", "cv2", "onnxruntime", "rich.progress", "safetensors.numpy", "scipy.optimize"),
    *("remind_jax.session.run", "remind_jax.metrics.evaluation", "remind_jax.formats.coco"),
    *("remind_jax.metrics.run_evaluation", "remind_jax.detectors.detector", "remind_jax.sweeps"),
    *("remind_jax.backbone.opening", "remind_jax.outputs.writer"),
    *("remind_jax.metrics.opening", "remind_jax.sources.opening"),
)
UNCHANGED = Change("nothing", False)


@dataclasses.dataclass(frozen=True)
class Verdict:
    """How a case ended."""

    kind: str  # one of `GOOD`, or "traceback", "hang", "signal", "memory", "wordy", "escape",
    # "accepted though invalid"
    change: Change
    told: str  # the last line that was written, or the place of the traceback


def load_libraries() -> None:
    """Imports what children need, so that each does not do so again; nothing is computed."""
    for name in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(name)
    converted_file("dino_tiny")


def run_case(name: str, seed: int, limit_s: float = LIMIT_S, *, in_child: bool = False) -> Verdict:
    """Makes, changes and enters one file of a format; the same seed is the same case.

    Args:
      name: Of the format.
      seed: What the change follows from.
      limit_s: Seconds until it counts as hanging.
      in_child: Make the file in the child as well, as a process that never computed needs it:
        once it has computed with JAX, its children cannot.
    """
    form = FORMATS[name]
    rng = random.Random(zlib.crc32(name.encode()) + seed)
    folder = Path(tempfile.mkdtemp(prefix="corpus"))
    try:
        made = None if in_child else _make(form, rng, folder)
        return _judge(*_enter(form, rng, folder, limit_s, made))
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _make(form: Format, rng: random.Random, folder: Path) -> tuple[Path, Change]:
    path = form.write(folder)
    return path, change_file(path, form.kind, rng)


def _enter(
    form: Format,
    rng: random.Random,
    folder: Path,
    limit_s: float,
    made: tuple[Path, Change] | None,
) -> tuple[int, str, str, Change]:
    """Status of the child, what it wrote, where it broke, and what was changed."""
    kept = {name: folder / f".{name}" for name in ("written", "broken", "change")}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # of JAX about forks
        child = os.fork()
    if child == 0:
        _be_a_child(form, rng, folder, kept, made)
    deadline = time.monotonic() + limit_s
    while True:
        ended, status = os.waitpid(child, os.WNOHANG)
        if ended:
            break
        if time.monotonic() > deadline:
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            status = -1
            break
        time.sleep(0.002)
    told, broken = (
        kept[name].read_text(errors="replace") if kept[name].exists() else ""
        for name in ("written", "broken")
    )
    change = pickle.loads(kept["change"].read_bytes()) if kept["change"].exists() else UNCHANGED
    return status, told, broken, change


def _be_a_child(
    form: Format,
    rng: random.Random,
    folder: Path,
    kept: dict[str, Path],
    made: tuple[Path, Change] | None,
) -> None:
    os.chdir(folder)
    sink = os.open(kept["written"], os.O_WRONLY | os.O_CREAT)
    for stream in (1, 2):
        os.dup2(sink, stream)
    sys.stdout, sys.stderr = os.fdopen(1, "w"), os.fdopen(2, "w")
    code = 0
    try:
        path, change = made or _make(form, rng, folder)
        kept["change"].write_bytes(pickle.dumps(change))
        os.truncate(kept["written"], 0)
        os.lseek(sink, 0, os.SEEK_SET)
        used = int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (used + LIMIT_BYTES, used + LIMIT_BYTES))
        form.enter(path)
    except MemoryError:
        code = 4
    except BaseException as error:
        is_refused = isinstance(error, Refused | RemindError)
        code = 5 if isinstance(error, Told) else 1 if is_refused else 3
        if code == 3:
            kept["broken"].write_text("".join(traceback.format_exception(error)))
        elif not isinstance(error, Refused | Told):
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
    if code == 5:
        return Verdict("told", change, last)
    if CONTROL.search(told):
        return Verdict("escape", change, repr(last[:120]))
    if code == 1:
        is_sentence = sum(line.startswith("remind: ") for line in lines) == 1
        return Verdict("refused" if is_sentence else "wordy", change, told[-300:])
    return Verdict("accepted though invalid" if change.is_invalid else "accepted", change, last)


def count(verdicts: list[tuple[str, int, Verdict]]) -> str:
    """How many cases of each format ended how, then what bad ones have in common."""
    ends = collections.Counter(f"{name}: {verdict.kind}" for name, _, verdict in verdicts)
    lines = [f"{times:6} {end}" for end, times in sorted(ends.items())]
    causes = collections.defaultdict(list)
    for name, seed, verdict in verdicts:
        if verdict.kind not in GOOD:
            told = re.sub(r"\d+", "#", verdict.told)
            causes[f"{verdict.kind}, {name}", told[:100]].append((seed, verdict))
    for (end, _), cases in sorted(causes.items(), key=lambda item: -len(item[1])):
        seed, first = cases[0]
        lines.append(f"{len(cases)} x {end}, first of seed {seed} ({first.change.name}):")
        lines.append(first.told[:140])
    return "\n".join(lines) + "\n"
