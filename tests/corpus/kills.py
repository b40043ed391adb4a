"""Kills commands at random moments and has them go on, until they end as if nothing had happened.

python -m tests.corpus.kills --kills 100 [--seed 7] [--kinds run,sweep]

What a kill hits follows from chance and from how fast the machine is; the seed only draws the plan.
"""

import argparse
import collections
import dataclasses
import json
import os
import random
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from safetensors.numpy import load_file

from remind_jax.cli.main import main as remind
from remind_jax.session import checkpoint
from remind_jax.synthetic import SceneOptions, make_scene, write_davis

LIMIT_S = 600.0  # of one process
CHILD = "--as-the-command"
RUN_TABLES = ("tracks.csv", "mot.txt", "mots.txt", "coco_video.json")
TOUR = SceneOptions(
    width=256, height=192, frames=48, num_rooms=2, objects_per_room=8, absence_frames=12
)


@dataclasses.dataclass(frozen=True)
class Kind:
    """A command that can be killed."""

    words: tuple[str, ...]  # before the folder
    progress: str  # below the folder: the file whose lines are counted
    compare: Callable[[Path, Path], list[str]]  # what differs
    again: tuple[str, ...] = ()  # words that go on


def _differing(names: Iterator[str] | tuple[str, ...], one: Path, other: Path) -> list[str]:
    return [name for name in names if (one / name).read_bytes() != (other / name).read_bytes()]


def compare_runs(one: Path, other: Path) -> list[str]:
    """What differs between two run folders, beside times."""
    differing = _differing(RUN_TABLES, one, other)
    lines = [(folder / "detections.jsonl").read_bytes().splitlines() for folder in (one, other)]
    if lines[0][1:] != lines[1][1:]:
        differing.append("detections.jsonl")
    if _run_json(one) != _run_json(other):
        differing.append("run.json")
    memories = [load_file(folder / "memory.safetensors") for folder in (one, other)]
    if {n: a.tobytes() for n, a in memories[0].items()} != {
        n: a.tobytes() for n, a in memories[1].items()
    }:
        differing.append("memory.safetensors")
    names = [sorted(path.name for path in folder.iterdir()) for folder in (one, other)]
    if names[0] != names[1]:
        differing.append(f"names of files: {set(names[0]) ^ set(names[1])}")
    return differing


def _run_json(folder: Path) -> dict:
    content = json.loads((folder / "run.json").read_text())
    for name in ("first_frame_ms", "compile_s"):
        content.pop(name)
        content["summary"].pop(name)
    content["summary"].pop("ms_per_frame")
    content["info"].pop("started_at")
    content["timings_ms"] = {stage: len(times) for stage, times in content["timings_ms"].items()}
    return content


def compare_sweeps(one: Path, other: Path) -> list[str]:
    """What differs between two folders of a sweep."""
    differing = _differing(("rows.csv", "summary.md"), one, other)
    rows = [sorted((folder / "rows.jsonl").read_text().split()) for folder in (one, other)]
    names = [sorted(path.name for path in folder.iterdir()) for folder in (one, other)]
    return differing + ["rows.jsonl"] * (rows[0] != rows[1]) + ["names"] * (names[0] != names[1])


def _run_kind(*words: str) -> Kind:
    return Kind(("run", "SCENE", *words), "detections.jsonl", compare_runs, ("--resume",))


KINDS: dict[str, Kind] = {
    "run": _run_kind(),
    "run announced late": _run_kind("--announce-after", "3"),
    "run answers delayed": _run_kind("--delay", "6"),
    "run traced": _run_kind("--trace", "--no-overlay"),
    "run of the bank": _run_kind("--tracker", "bank"),
    "sweep": Kind(
        (
            *("sweep", "SCENE", "--set", "decision.new=0.5:2.5:0.25"),
            *("--batch", "1", "--max-frames", "8"),
        ),
        "rows.jsonl",
        compare_sweeps,
    ),
}


@dataclasses.dataclass
class Case:
    """How one folder came to its end."""

    kind: str
    kills: list[str] = dataclasses.field(default_factory=list)  # where each hit
    failures: list[str] = dataclasses.field(default_factory=list)


class Course:
    """A scene, and what every command makes of it when nobody disturbs it."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._scene = folder / "scene"
        write_davis(make_scene(TOUR), self._scene)
        self._undisturbed: dict[str, tuple[Path, float]] = {}

    def try_kind(
        self,
        name: str,
        num_kills: int,
        rng: random.Random,
        number: signal.Signals = signal.SIGKILL,
    ) -> Case:
        """Kills a command so many times, lets it end, and compares what it made.

        Args:
          name: Of the kind.
          num_kills: How often.
          rng: What the moments follow from.
          number: The signal; of another one than SIGKILL, the command has to end well.
        """
        kind, case = KINDS[name], Case(name)
        expected, usual_s = self._expect(name)
        total = _count(expected, kind)
        out = Path(tempfile.mkdtemp(dir=self._folder)) / "out"
        for _ in range(num_kills):
            child = self._start(kind, out)
            _wait(child, out, kind, total, usual_s, rng)
            child.send_signal(number)
            said = child.communicate(timeout=LIMIT_S)[1]
            # A signal may come before the command, when Python itself starts.
            if child.returncode in (-number, 128 + number):
                case.kills.append(_place(out, kind, total))
            elif child.returncode:
                case.failures.append(f"exit code {child.returncode}: {said.strip()[-300:]}")
        child = self._start(kind, out)
        said = child.communicate(timeout=LIMIT_S)[1]
        if child.returncode:
            case.failures.append(f"exit code {child.returncode}: {said.strip()[-300:]}")
        else:
            case.failures += [f"{what} differs" for what in kind.compare(expected, out)]
        if not case.failures:
            shutil.rmtree(out.parent)
        return case

    def _expect(self, name: str) -> tuple[Path, float]:
        if name not in self._undisturbed:
            out = self._folder / "undisturbed" / name
            out.parent.mkdir(exist_ok=True)
            for _ in range(2):  # the first one compiles
                shutil.rmtree(out, ignore_errors=True)
                start = time.monotonic()
                child = self._start(KINDS[name], out)
                said = child.communicate(timeout=LIMIT_S)[1]
                assert child.returncode == 0, said
            self._undisturbed[name] = (out, time.monotonic() - start)
        return self._undisturbed[name]

    def _start(self, kind: Kind, out: Path) -> subprocess.Popen[str]:
        return self.start(*kind.words, "--out", out, "--quiet", *kind.again)

    def start(self, *words: object) -> subprocess.Popen[str]:
        """Starts a command; the word SCENE is the folder of the scene."""
        given = [str(self._scene) if word == "SCENE" else str(word) for word in words]
        programs = {
            "REMIND_PROGRAMS": str(self._folder / "programs"),
            "JAX_COMPILATION_CACHE_DIR": str(self._folder / "compiled"),
            "XDG_CACHE_HOME": str(self._folder / "cache"),
        }
        return subprocess.Popen(
            [sys.executable, "-m", "tests.corpus.kills", CHILD, *given],
            env=os.environ | programs,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        )


def _wait(
    child: subprocess.Popen,
    out: Path,
    kind: Kind,
    total: int,
    usual_s: float,
    rng: random.Random,
) -> None:
    """Waits for a random moment: any, while frames are done, or while the end is written."""
    chosen = rng.random()
    if chosen < 0.25:
        needed, then_s = -1, rng.uniform(0, usual_s)
    elif chosen < 0.75:
        needed, then_s = rng.randint(0, total), rng.uniform(0, 0.1)
    else:
        needed, then_s = total, rng.uniform(0, 0.6)
    deadline = time.monotonic() + LIMIT_S
    while child.poll() is None and time.monotonic() < deadline and _count(out, kind) < needed:
        time.sleep(0.002)
    until = time.monotonic() + then_s
    while child.poll() is None and time.monotonic() < until:
        time.sleep(0.002)


def _count(out: Path, kind: Kind) -> int:
    """Frames or settings that are there."""
    try:
        return (out / kind.progress).read_bytes().count(b"\n")
    except OSError:
        return 0


def _place(out: Path, kind: Kind, total: int) -> str:
    num = _count(out, kind)
    if not num:
        return "before the first"
    return "in the middle" if num < total else "at the end"


def run_kills(course: Course, names: list[str], num_kills: int, seed: int) -> Iterator[Case]:
    """Cases of one to three kills, kind after kind, until there were enough."""
    rng, done, turn = random.Random(seed), 0, 0
    while done < num_kills:
        case = course.try_kind(
            names[turn % len(names)], min(rng.randint(1, 3), num_kills - done), rng
        )
        done, turn = done + len(case.kills), turn + 1
        yield case


def summary(cases: list[Case]) -> str:
    """Kills by kind and place, and what failed."""
    hit = collections.Counter((case.kind, place) for case in cases for place in case.kills)
    lines = [f"{times:6} {kind}, {place}" for (kind, place), times in sorted(hit.items())]
    return "\n".join(lines + [f"{case.kind}: {what}" for case in cases for what in case.failures])


def main() -> int:
    """Exit status 1 if a command did not go on, or made something else."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--kills", type=int, default=100)
    parser.add_argument("--kinds", default=",".join(KINDS))
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    names = [name for name in KINDS if name in options.kinds.split(",")]
    folder, cases = Path(tempfile.mkdtemp(prefix="kills")), []
    for case in run_kills(Course(folder), names, options.kills, options.seed):
        cases.append(case)
        print(case, flush=True)
    if not any(case.failures for case in cases):
        shutil.rmtree(folder)
    print(summary(cases))
    return int(any(case.failures for case in cases))


if __name__ == "__main__":
    if sys.argv[1:2] == [CHILD]:
        # Runs of seconds have checkpoints, too.
        checkpoint.EVERY_S, checkpoint.MAX_OF_A_RUN = 0.1, 1.0
        sys.exit(remind(sys.argv[2:]))
    sys.exit(main())
