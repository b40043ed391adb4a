"""Absence against recovery: who is still known after 1 to 3,000 frames without being seen?

    python benchmarks/field.py --out DIR                     ours, and every peer that can be had
    python benchmarks/field.py --out DIR --peers norfair     ours and some; `--peers none`: ours
    python benchmarks/field.py --out DIR --quick             few points of each plot, one seed
    python benchmarks/field.py --out DIR --page              and writes benchmarks/field.md

All trackers get the same frames, detections and embeddings (`field_worlds.py`, `field_ours.py`).
Peers run in environments of their own (`field_peers/`), which are made with pip when they are first
asked for. What is in DIR is not computed again. Protocol, settings and
results: benchmarks/field.md.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter, defaultdict
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import numpy as np

import remind_jax as rj
from benchmarks.field_ours import OURS, Ours, TrialWriter
from benchmarks.field_page import write_figures, write_tables
from benchmarks.field_peers.environments import (
    PEERS,
    AbsentError,
    add_peer_options,
    ask,
    chosen_peers,
    prepare,
)
from benchmarks.field_scoring import Outcome, judge, pool, truth_of
from benchmarks.field_worlds import FIRST_SEED, Trial, make_trials, questions
from benchmarks.pages import fill_file
from remind_jax.errors import RemindError

PAGE = Path(__file__).with_suffix(".md")
FIGURES = PAGE.parent.parent / "docs" / "figures"
NUM_SEEDS = 2
_LEAST_ANSWERED = 0.7  # of the questions


def answer_ours(trials: list[Trial], out: Path, names: tuple[str, ...]) -> dict[str, str]:
    """Has our trackers answer what they have not answered yet; their titles."""
    ours = Ours(names)
    for trial in trials:
        for name in names:
            file = out / name / f"{trial.name}.npy"
            if not file.is_file():
                file.parent.mkdir(parents=True, exist_ok=True)
                np.save(file, ours.answer(name, trial))
        say(f"{trial.name}: {', '.join(names)}")
    return ours.titles


def answer_peers(
    trials: list[Trial], names: list[str], out: Path, environments: Path, given_only: bool
) -> tuple[dict[str, dict[str, Any]], dict[str, str]]:
    """Has the trackers of others answer; their reports, and why some are absent."""
    reports, absent = {}, {}
    sequences = out / "sequences"
    sequences.mkdir(parents=True, exist_ok=True)
    writer = TrialWriter() if names else None
    for trial in trials:
        if writer is not None and not (sequences / f"{trial.name}.npz").is_file():
            writer.write(trial, sequences / f"{trial.name}.npz")
    for name in names:
        answers = out / "answers" / name
        try:
            if not given_only and not _is_answered(answers, trials):
                say(f"{name}: preparing its environment")
                python = prepare(PEERS[name], environments)
                say(f"{name}: answering")
                ask(PEERS[name], python, sequences, answers)
            if not (answers / "report.json").is_file():
                raise AbsentError("it was not asked")
            reports[name] = json.loads((answers / "report.json").read_text())
        except AbsentError as error:
            absent[name] = str(error)
            say(f"{name} is absent: {error}")
    return reports, absent


def _is_answered(answers: Path, trials: list[Trial]) -> bool:
    """Whether every setting of a peer has answered every trial, or failed."""
    if not (answers / "report.json").is_file():
        return False
    settings = json.loads((answers / "report.json").read_text())["settings"]
    return all(
        told["error"] or (answers / setting / f"{trial.name}.npy").is_file()
        for setting, told in settings.items()
        for trial in trials
    )


def score(trials: list[Trial], contenders: dict[str, Path]) -> list[dict[str, Any]]:
    """Rows: contender, question, scores over seeds; and over the questions that all answered.

    Who answered few questions has no rows.
    """
    outcomes: dict[tuple[str, Any], list[Outcome]] = defaultdict(list)
    for trial in trials:
        truth = truth_of(trial)
        for name, folder in contenders.items():
            file = folder / f"{trial.name}.npy"
            if file.is_file():
                outcomes[name, trial.question].append(judge(trial, truth, np.load(file)))
    num_seeds = Counter(trial.question for trial in trials)
    answered = {key: some for key, some in outcomes.items() if len(some) == num_seeds[key[1]]}
    counts = Counter(name for name, _ in answered)
    contenders = {
        name: folder
        for name, folder in contenders.items()
        if counts[name] >= _LEAST_ANSWERED * len(num_seeds)
    }
    answered = {key: some for key, some in answered.items() if key[0] in contenders}
    rows = []
    for (name, question), some in answered.items():
        asked = {"varied": question.varied, "world": question.world, "value": question.value}
        rows.append({"contender": name, **asked, **pool(some)})
    common = [
        question
        for question in num_seeds
        if all((name, question) in answered for name in contenders)
    ]
    for name in contenders if common else ():
        own = [one for question in common for one in answered[name, question]]
        rows.append({"contender": name, "varied": "all", "world": "all", "value": 0, **pool(own)})
    return rows


def say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def run(given: argparse.Namespace) -> dict[str, Any]:
    """Everything; what `field.json` holds."""
    out, asked = given.out, questions(given.quick)
    seeds = range(FIRST_SEED, FIRST_SEED + (1 if given.quick else given.seeds))
    trials = [trial for seed in seeds for trial in make_trials(asked, seed, out / "scenes")]
    titles = answer_ours(trials, out / "answers", OURS)
    names = chosen_peers(given.peers)
    reports, absent = answer_peers(trials, names, out, given.environments, given.kept)
    contenders = {title: out / "answers" / name for name, title in titles.items()}
    about: dict[str, Any] = {title: {"setting": "ours"} for title in titles.values()}
    for name, report in reports.items():
        for key, told in report["settings"].items():
            tracker, setting = key.split(".")
            title = f"{tracker} ({name}), {setting.replace('-', ' ')}"
            contenders[title] = out / "answers" / name / key
            about[title] = {"setting": setting, "peer": name, **told}
    rows = score(trials, contenders)
    scored = {row["contender"] for row in rows}
    return {
        "version": rj.__version__,
        "seeds": list(seeds),
        "rows": rows,
        "contenders": {name: told for name, told in about.items() if name in scored},
        "unfinished": [name for name in about if name not in scored],
        "versions": {name: report["versions"] for name, report in reports.items()},
        "absent": absent,
    }


def main() -> int:
    """Parses the command line, runs, and writes tables and figures; returns the exit code."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of all that is made")
    parser.add_argument("--seeds", type=int, default=NUM_SEEDS, help="scenes of each kind")
    parser.add_argument("--quick", action="store_true", help="few points, one seed")
    parser.add_argument("--kept", action="store_true", help="ask no peer, score what is in DIR")
    parser.add_argument(
        "--page",
        action="store_true",
        help="write benchmarks/field.md; not --quick: all of it, with its figures",
    )
    add_peer_options(parser)
    given = parser.parse_args()
    try:
        result = run(given)
    except (RemindError, OSError) as error:
        say(f"error: {error}")
        return 1
    (given.out / "field.json").write_text(json.dumps(result, indent=1))
    tables = write_tables(result)
    write_figures(result, given.out)
    text = "\n\n".join(tables.values())
    (given.out / "field.md").write_text(text + "\n")
    if given.page:
        if given.quick:
            tables = {"quick": tables["all"]}
        else:
            write_figures(result, FIGURES)
        fill_file(PAGE, {f"field:{name}": table for name, table in tables.items()})
    print(text)
    return 0


if __name__ == "__main__":
    sys.exit(main())
