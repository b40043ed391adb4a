"""Real clips with the saved detections of a real detector: who is who, by our trackers and others.

    python benchmarks/realvideo.py CLIPS                     ours, and every peer that can be had
    python benchmarks/realvideo.py CLIPS OTHERS --peers none two sets, each with a pooled row; ours
    python benchmarks/realvideo.py CLIPS --contenders default --set mobility.gain=0
    python benchmarks/realvideo.py CLIPS --json FILE         and every number; --clips a,b: some

CLIPS holds a folder per clip: `JPEGImages/CLIP/`, the detections in `*.jsonl.gz`, and
`metadata.json` with `id_to_class` and `labels_of_detections` (the true object of every detection by
frame; 0: not known). Detections that the truth knows are compared, not masks; an undecided one has
no identity. A contender is a configuration, a tracker, or `bank-closeups` (see `field_ours.py`).

Returns: objects that are back after more than 10 frames; recovered: they have their right identity
in some frame of the visit, kept: in more than half of them, at once: in the first. Merged: pairs of
one class that share an identity for 5 rows each at least; identities that the tracker declared to
be one are one. Sure and right: of answers with a confidence of 0.97 or more. ECE: mean distance of
confidence and share right, in ten bins. Intervals are of 95 %, over clips.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path

import numpy as np
from jaxtyping import Int

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import jax

import remind_jax as rj
from benchmarks.clips import Answers, Clip, Judged, extra_scores, find_clips, judge
from benchmarks.field_ours import Describer, make_ours, write_sequence
from benchmarks.field_peers.environments import (
    PEERS,
    AbsentError,
    add_peer_options,
    ask,
    chosen_peers,
    prepare,
)
from remind_jax.cli.flags import parse_assignments
from remind_jax.config import Config, load_config
from remind_jax.metrics import (
    Column,
    ComparisonTable,
    Row,
    bootstrap_intervals,
    pool_evaluations,
    stack_counts,
)
from remind_jax.metrics.combine import pool_counts
from remind_jax.metrics.evaluation import scene_intervals, without_nan

CONTENDERS = ("default", "remind", "bank", "bank-closeups", "running-mean")
ANNOUNCE_AFTER = 5  # as for any detector
PERSON = "person"
_FPS = 30.0


def answer_ours(config: Config, clip: Clip, scratch: Path, delay: int | None = None) -> Answers:
    """Runs one of our trackers."""
    start = time.perf_counter()
    result = rj.run(
        clip.open(scratch),
        config=config,
        delay=delay,
        announce_after=ANNOUNCE_AFTER,
        progress=False,
    )
    seconds = time.perf_counter() - start
    jax.clear_caches()  # compiled programs hold hundreds of MiB each
    ids, confidence = [], []
    for frame, row, _ in clip.rows.T.tolist():
        tracks = result.tracks[frame]
        sure = tracks.shown_confidence(row)
        ids.append(int(tracks.object_id[row]))
        confidence.append(np.nan if sure is None else sure)
    told = [re.findall(r"\d+", one.message) for one in result.events if one.kind == "merged"]
    became = {int(gone): int(kept) for gone, kept in told}
    return Answers(np.array(ids), np.array(confidence), became, seconds)


def answer_peers(
    clips: Sequence[Clip], names: Sequence[str], scratch: Path, environments: Path
) -> tuple[dict[str, dict[str, Answers]], dict[str, str]]:
    """Answers of the trackers of others by their title and clip, and why some are absent."""
    sequences = scratch / "sequences"
    sequences.mkdir()
    describer = Describer()
    for clip in clips if names else ():
        frames = list(clip.open(scratch))
        pictures = scratch / f"{clip.name}.npy"
        np.save(pictures, np.stack([np.asarray(frame.image) for frame in frames]))
        shown = [(index, describer.describe(frame)) for index, frame in enumerate(frames)]
        file = sequences / f"{clip.name}.npz"
        write_sequence(file, shown, np.arange(len(frames)), pictures, _FPS)
    found: dict[str, dict[str, Answers]] = {}
    absent = {}
    for name in names:
        out = scratch / "peers" / name
        try:
            report = ask(PEERS[name], prepare(PEERS[name], environments), sequences, out)
        except AbsentError as error:
            absent[name] = str(error)
            continue
        for key, told in report["settings"].items():
            tracker, setting = key.split(".")
            if told["error"]:
                absent[key] = told["error"]
                continue
            found[f"{tracker} ({name}), {setting.replace('-', ' ')}"] = {
                clip.name: _of_rows(clip, np.load(out / key / f"{clip.name}.npy")) for clip in clips
            }
    return found, absent


def _of_rows(clip: Clip, ids: Int[np.ndarray, "M"]) -> Answers:
    """The answers about all detections as those about the rows that the truth knows."""
    first = np.cumsum([0, *map(len, clip.labels)])
    own = ids[first[clip.rows[0]] + clip.rows[1]]
    return Answers(own, np.full(len(own), np.nan))


COLUMNS = (
    "IDF1",
    "AssA",
    Column("IDs", "count", label="Identities"),
    "GT_IDs",
    Column("returns", "count", label="Returns"),
    Column("recovered", "count", "higher", label="recovered"),
    Column("kept", "count", "higher", label="kept"),
    Column("at_once", "count", "higher", label="at once"),
    Column("merged", "count", "lower", label="Merged"),
    Column("pairs", "count", label="of pairs"),
    Column("undecided", "percent", "lower", label="Undecided"),
    Column("sure_right", "percent", "higher", label="Sure and right"),
    Column("ece", "percent", "lower", label="ECE"),
)


def row_of(title: str, judged: Sequence[Judged]) -> Row:
    """One clip, or several pooled, with intervals over them."""
    evaluation = pool_evaluations([one.evaluation for one in judged])
    counts = pool_counts(one.counts for one in judged)
    scores = {**evaluation.scores(), **extra_scores(counts)}
    scores = {name: float(value) for name, value in scores.items()}
    scores["undecided"] = 1 - scores["Dets"] / scores["GT_Dets"]
    scores["seconds"] = sum(one.seconds for one in judged)
    if len(judged) < 2:
        return Row(title, scores)
    extra = bootstrap_intervals(stack_counts(one.counts for one in judged), extra_scores)
    intervals = scene_intervals([one.evaluation for one in judged]) | extra
    shown = ("IDF1", "AssA", "sure_right", "ece")
    return Row(title, scores, {name: intervals[name] for name in shown})


def make_tables(
    sets: dict[str, list[Clip]], judged: dict[str, dict[str, Judged]]
) -> list[ComparisonTable]:
    """One table per set of clips, pooled, then one per clip."""
    clips = [clip for some in sets.values() for clip in some]
    groups = {f"{name}, pooled": some for name, some in sets.items() if len(some) > 1}
    if len(sets) > 1:
        groups["all, pooled"] = clips
    groups |= {clip.name: [clip] for clip in clips}
    return [
        ComparisonTable(
            [row_of(who, [own[clip.name] for clip in some]) for who, own in judged.items()],
            COLUMNS,
            title=name,
        )
        for name, some in groups.items()
    ]


def judge_contenders(
    clips: Sequence[Clip], names: Sequence[str], changes: Sequence[str], scratch: Path
) -> dict[str, dict[str, Judged]]:
    """Our trackers by title and clip."""
    judged: dict[str, dict[str, Judged]] = {}
    for contender in make_ours(names):
        config = contender.config.updated(parse_assignments(changes))
        judged[contender.title] = {}
        for clip in clips:
            one = judge(clip, answer_ours(config, clip, scratch))
            judged[contender.title][clip.name] = one
            say(f"{contender.title}, {clip.name}: {one.evaluation.scores()['IDF1']:.3f}")
    return judged


def judge_turns(
    clips: Sequence[Clip], scratch: Path
) -> tuple[dict[str, dict[str, Judged]], dict[str, dict[str, Judged]]]:
    """What the default gains by options, by title and clip; the second of clips with people."""
    config = load_config("default")

    def run(change: Callable[[Clip], Clip], clip: Clip, delay: int | None = None) -> Judged:
        changed = change(clip)
        say(f"{clip.name}, a turn")
        return judge(changed, answer_ours(config, changed, scratch, delay))

    people = [clip for clip in clips if list(clip.class_of.values()).count(PERSON) > 1]
    turns = {
        "`--delay 0`, as live": {clip.name: run(lambda c: c, clip, 0) for clip in clips},
        "one class for all": {clip.name: run(Clip.one_class, clip) for clip in clips},
    }
    alone = {
        "among all classes": {c.name: run(lambda c: c.judged_by(PERSON), c) for c in people},
        f"`--classes {PERSON}`": {c.name: run(lambda c: c.only(PERSON), c) for c in people},
    }
    return turns, alone


def judge_peers(
    clips: Sequence[Clip], names: Sequence[str], scratch: Path, environments: Path
) -> tuple[dict[str, dict[str, Judged]], dict[str, str]]:
    """Trackers of others by title and clip, and why some are absent."""
    found, absent = answer_peers(clips, names, scratch, environments)
    judged = {
        title: {clip.name: judge(clip, own[clip.name]) for clip in clips}
        for title, own in found.items()
    }
    return judged, absent


def say(sentence: str) -> None:
    print(sentence, file=sys.stderr, flush=True)


def main() -> None:
    """Parses the command line, measures and prints."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", metavar="CLIPS")
    parser.add_argument("--clips", type=lambda text: text.split(","), default=[])
    parser.add_argument("--contenders", nargs="*", default=CONTENDERS)
    parser.add_argument("--set", nargs="*", default=[], metavar="KEY=VALUE", help="of ours")
    parser.add_argument("--json", type=Path)
    add_peer_options(parser)
    given = parser.parse_args()
    sets = {folder.name: find_clips(folder, given.clips) for folder in given.folders}
    clips = [clip for some in sets.values() for clip in some]
    with tempfile.TemporaryDirectory() as folder:
        judged = judge_contenders(clips, given.contenders, given.set, Path(folder))
        peers, absent = judge_peers(
            clips, chosen_peers(given.peers), Path(folder), given.environments
        )
    tables = make_tables(sets, judged | peers)
    for table in tables:
        print(table.to_markdown())
    for name, why in absent.items():
        print(f"* {name} is absent: {why}")
    if given.json is not None:
        rows = {t.title: {r.name: without_nan(r.scores) for r in t.rows} for t in tables}
        given.json.write_text(json.dumps({"tables": rows, "absent": absent}, indent=1))


if __name__ == "__main__":
    main()
