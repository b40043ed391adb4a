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
import collections
import dataclasses
import functools
import gzip
import itertools
import json
import re
import sys
import tempfile
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float, Int

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

import jax

import remind_jax as rj
from benchmarks.field_ours import Describer, make_ours, write_sequence
from benchmarks.field_peers.environments import (
    PEERS,
    AbsentError,
    add_peer_options,
    ask,
    chosen_peers,
    prepare,
)
from benchmarks.field_scoring import first_sayings
from remind_jax.cli.overrides import parse_assignments
from remind_jax.config import Config, load_config
from remind_jax.metrics import (
    Column,
    ComparisonTable,
    Row,
    TrackingSequence,
    bootstrap_intervals,
    evaluate_sequence,
    pool_evaluations,
    stack_counts,
)
from remind_jax.metrics.combine import pool_counts, ratio
from remind_jax.metrics.evaluation import Evaluation, scene_intervals, without_nan
from remind_jax.metrics.recovery import NO_LABEL, collect_answers, find_reference
from remind_jax.sources import open_source

CONTENDERS = ("default", "remind", "bank", "bank-closeups", "running-mean")
ABSENT = 10  # frames; who is away for longer returns
SHARED = 5  # rows of each, from which on two objects are merged
SURE = 0.97
ANNOUNCE_AFTER = 5  # as for any detector
PERSON = "person"
DELAY = 15  # frames
_BINS = 10
_FPS = 30.0


@dataclasses.dataclass(frozen=True)
class Clip:
    """A clip and its truth; `R` rows are the detections that the truth knows, ordered by frame."""

    name: str
    folder: Path
    lines: tuple[dict[str, Any], ...]  # the file of detections
    labels: tuple[tuple[int, ...], ...]  # the true object of every detection of every frame, or 0
    class_of: dict[int, str]

    @functools.cached_property
    def rows(self) -> Int[np.ndarray, "3 R"]:
        """Frame, detection and true object."""
        rows = [(t, d, g) for t, row in enumerate(self.labels) for d, g in enumerate(row) if g]
        return np.array(rows, int).reshape(-1, 3).T

    def open(self, scratch: Path) -> Any:
        """Its frames with their detections, which are written into a folder."""
        masks = scratch / f"{self.name}.jsonl"
        masks.write_text("".join(json.dumps(line) + "\n" for line in self.lines))
        return open_source(self.folder / "JPEGImages" / self.name, masks=masks)

    def one_class(self) -> Clip:
        """The same with one class for everything."""
        return dataclasses.replace(self, lines=self._with(lambda d: [{**d, "label": "thing"}])[0])

    def only(self, label: str) -> Clip:
        """The same with the detections of one class."""
        lines, labels = self._with(lambda d: [d] if d["label"] == label else [])
        return dataclasses.replace(self, lines=lines, labels=labels)

    def judged_by(self, label: str) -> Clip:
        """The same, with a truth of the detections of one class."""
        labels = tuple(
            tuple(
                g if d["label"] == label else 0
                for g, d in zip(row, line["detections"], strict=True)
            )
            for row, line in zip(self.labels, self.lines, strict=True)
        )
        return dataclasses.replace(self, labels=labels)

    def _with(self, change: Callable[[dict[str, Any]], list[dict[str, Any]]]) -> tuple[Any, Any]:
        """Lines and labels with every detection changed into none or one."""
        changed = [[change(one) for one in line["detections"]] for line in self.lines]
        lines = (
            {**line, "detections": [one for some in own for one in some]}
            for line, own in zip(self.lines, changed, strict=True)
        )
        labels = (
            tuple(label for label, some in zip(row, own, strict=True) if some)
            for row, own in zip(self.labels, changed, strict=True)
        )
        return tuple(lines), tuple(labels)


@dataclasses.dataclass(frozen=True)
class Answers:
    """What a tracker said of every row of a clip."""

    ids: Int[np.ndarray, "R"]  # -1: nothing
    confidence: Float[np.ndarray, "R"]  # NaN without one
    became: dict[int, int] = dataclasses.field(default_factory=dict)  # identities declared another
    seconds: float = float("nan")


@dataclasses.dataclass(frozen=True)
class Counts:
    """What is counted beside the usual scores; counts of several clips add up."""

    returns: Any
    recovered: Any
    kept: Any
    at_once: Any
    pairs: Any  # of objects of one class
    merged: Any
    sure: Any
    sure_right: Any
    binned: Any  # [..., bins] answers by confidence
    binned_sure: Any  # [..., bins] sums of their confidence
    binned_right: Any  # [..., bins]


@dataclasses.dataclass(frozen=True)
class Judged:
    """One tracker on one clip."""

    evaluation: Evaluation
    counts: Counts
    seconds: float


def find_clips(folder: Path, wanted: Sequence[str] = ()) -> list[Clip]:
    """The clips of a folder, by name."""
    return [
        _read_clip(file.parent)
        for file in sorted(folder.glob("*/metadata.json"))
        if not wanted or file.parent.name in wanted
    ]


def _read_clip(folder: Path) -> Clip:
    told = json.loads((folder / "metadata.json").read_text())
    (packed,) = folder.glob("*.jsonl.gz")
    lines = tuple(map(json.loads, gzip.decompress(packed.read_bytes()).splitlines()))
    labels = tuple(map(tuple, told["labels_of_detections"]))
    classes = {int(number): name for number, name in told["id_to_class"].items()}
    return Clip(folder.name, folder, lines, labels, classes)


def answer_ours(config: Config, clip: Clip, scratch: Path, delay: int = 0) -> Answers:
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


def judge(clip: Clip, answers: Answers) -> Judged:
    """Scores the answers about a clip; who is right is who has most rows, one to one."""
    frame, _, instance = clip.rows
    said = answers.ids != NO_LABEL
    rows = first_sayings(frame, answers.ids)
    sequence = TrackingSequence.create(
        len(clip.labels),
        (frame, instance),
        (frame[rows], answers.ids[rows]),
        (rows, np.arange(len(rows)), np.ones(len(rows))),
        name=clip.name,
    )
    given = collect_answers(sequence)
    reference = find_reference(given)
    right = said & (given.label == reference[np.searchsorted(given.objects, instance)])
    visits = [visit for own in _visits(clip) for visit in own[1:]]
    rated = said & np.isfinite(answers.confidence)
    sure, hit = answers.confidence[rated], right[rated]
    place = np.minimum((_BINS * sure).astype(int), _BINS - 1)
    merged, pairs = _merged(clip, answers)
    binned = [np.bincount(place, each, _BINS) for each in (None, sure, hit)]
    counts = (
        len(visits),
        sum(right[visit].any() for visit in visits),
        sum(2 * right[visit].sum() > len(visit) for visit in visits),
        sum(right[visit[0]] for visit in visits),
        pairs,
        merged,
        (sure >= SURE).sum(),
        hit[sure >= SURE].sum(),
        *binned,
    )
    return Judged(evaluate_sequence(sequence), Counts(*map(np.asarray, counts)), answers.seconds)


def _visits(clip: Clip) -> Iterable[list[np.ndarray]]:
    """The rows of every visit of every object, in order."""
    frame, _, instance = clip.rows
    for number in np.unique(instance):
        own = np.flatnonzero(instance == number)
        yield np.split(own, np.flatnonzero(np.diff(frame[own]) > ABSENT) + 1)


def _merged(clip: Clip, answers: Answers) -> tuple[int, int]:
    """Pairs of objects of one class that share an identity, and all such pairs."""
    called: dict[int, set[int]] = {}
    for number in np.unique(clip.rows[2]).tolist():
        own = answers.ids[(clip.rows[2] == number) & (answers.ids != NO_LABEL)].tolist()
        names = collections.Counter(_final(answers.became, one) for one in own)
        called[number] = {name for name, num in names.items() if num >= SHARED}
    same = [
        bool(called[a] & called[b])
        for a, b in itertools.combinations(called, 2)
        if clip.class_of[a] == clip.class_of[b]
    ]
    return sum(same), len(same)


def _final(became: dict[int, int], number: int) -> int:
    seen = set()
    while number in became and number not in seen:
        seen.add(number)
        number = became[number]
    return number


def _extra_scores(counts: Counts) -> dict[str, Any]:
    distance = np.abs(counts.binned_sure - counts.binned_right).sum(-1)
    counted = ("returns", "recovered", "kept", "at_once", "pairs", "merged")
    return {
        **{name: getattr(counts, name) for name in counted},
        "sure_right": ratio(counts.sure_right, counts.sure),
        "ece": ratio(distance, counts.binned.sum(-1)),
    }


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
    scores = {**evaluation.scores(), **_extra_scores(counts)}
    scores = {name: float(value) for name, value in scores.items()}
    scores["undecided"] = 1 - scores["Dets"] / scores["GT_Dets"]
    scores["seconds"] = sum(one.seconds for one in judged)
    if len(judged) < 2:
        return Row(title, scores)
    extra = bootstrap_intervals(stack_counts(one.counts for one in judged), _extra_scores)
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

    def run(change: Callable[[Clip], Clip], clip: Clip, delay: int = 0) -> Judged:
        changed = change(clip)
        say(f"{clip.name}, a turn")
        return judge(changed, answer_ours(config, changed, scratch, delay))

    people = [clip for clip in clips if list(clip.class_of.values()).count(PERSON) > 1]
    turns = {
        f"`--delay {DELAY}`": {clip.name: run(lambda c: c, clip, DELAY) for clip in clips},
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
