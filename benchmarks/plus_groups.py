"""REMIND plus on every group of development sequences, with any settings changed.

    python benchmarks/plus_groups.py --given shared/real/kitchen shared/real/rooms_a
    python benchmarks/plus_groups.py roam fly --try "layout.covisible_weight=0.4 decision.new=1.2"

What helps one kind of world often costs another, so a change is looked at on all of them, with
classes and as one class. Groups:

    given    the sequences named by `--given`
    order    the same backwards, and second half first
    tours    generated tours, some of which break assumptions
    mix      some things roam, furniture stays
    roam     everything roams; `roam_more`: other seeds
    moving   the worlds `moving` of field.py, other seeds
    alike    look-alikes that fly, as in field.py, other seeds

Each cell: IDF1, first frame of a return, ids per object, expected error of the confidence, with
every detection counted. Recordings are kept in `--cache` and made again when that is removed.
"""

from __future__ import annotations

import argparse
import dataclasses
import pickle
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.field_worlds import MOVING, Question, make_trials
from benchmarks.plus import MOVING_WORLD, STRESS, TOUR, backwards, second_half_first
from benchmarks.plus_recording import Changes, Recording, answer, changed, is_right, judge, record
from benchmarks.rows import show_rows
from remind_jax.frame import NO_INSTANCE, Frame
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.sources import open_source
from remind_jax.synthetic import make_scene, render

BACKBONE = "patch-statistics"
GROUPS = ("given", "order", "tours", "mix", "roam", "roam_more", "moving", "alike")
ALWAYS_ONE_CLASS = ("moving", "alike")
_TOURS = (
    "as is", "moved 30 %", "removed, added 30 %", "swapped 30 %", "roll 15 deg", "zoom 1.6",
    "jumps", "walking", "half of the frames",
)  # fmt: skip
_MIXED = ("40 % roam, camera pans", "30 % roam, tour", "half roams, still camera")
# All below the seeds of any benchmark.
_ROAM, _ROAM_MORE = (31, 32, 33, 34), (51, 52, 53, 54, 71, 72, 73, 74)
_FIELD_SEEDS, _ALIKE_SEEDS = (41, 42, 43), (44, 45, 46, 47)
_BINS = 10

Frames = Callable[[], Iterable[Frame]]


def sequences(group: str, given: list[str], cache: Path) -> Iterator[tuple[str, Frames]]:
    """Names and frames of a group."""
    if group == "given":
        for path in given:
            yield Path(path).name, lambda path=path: open_source(path)
    elif group == "order":
        for path in given:
            for change in (backwards, second_half_first):
                name = f"{Path(path).name} {change.__name__}"
                yield name, lambda path=path, change=change: change(path)
    elif group in ("tours", "mix"):
        for name in _TOURS if group == "tours" else _MIXED:
            yield name, lambda name=name: _rendered(**STRESS[name][0])
    elif group in ("roam", "roam_more"):
        for seed in _ROAM if group == "roam" else _ROAM_MORE:
            # Two before a camera at rest, two before one that pans, and so on.
            camera = "still" if (seed - 31) % 4 < 2 else "pan"
            options = {**MOVING_WORLD, "seed": seed, "camera": camera}
            yield f"{camera} {seed}", lambda options=options: _rendered(**options)
    else:
        asked = [Question("absence", MOVING, absence) for absence in (3, 10, 30, 100)]
        if group == "alike":
            asked = [Question("alike", MOVING, alike=number) for number in (4, 12)]
        for seed in _FIELD_SEEDS if group == "moving" else _ALIKE_SEEDS:
            for trial in make_trials(tuple(asked), seed, cache / "pictures"):
                yield trial.name, trial.frames


def _rendered(**options: Any) -> Iterable[Frame]:
    return render(make_scene(dataclasses.replace(TOUR, **options)))


def recordings(group: str, given: list[str], cache: Path) -> list[Recording]:
    """What the step sees of a group, with classes; recorded once."""
    recorded = []
    for name, frames in sequences(group, given, cache):
        file = cache / f"{group} {name}.pkl"
        if not file.is_file():
            cache.mkdir(parents=True, exist_ok=True)
            file.write_bytes(pickle.dumps(record(name, frames(), BACKBONE, one_class=False)))
        recorded.append(pickle.loads(file.read_bytes()))
    return recorded


def without_classes(recording: Recording) -> Recording:
    """The same detections, all of one class."""
    seen = recording.sightings
    same = dataclasses.replace(seen, class_id=np.zeros_like(seen.class_id))
    return dataclasses.replace(recording, sightings=same)


def measure(recorded: list[Recording], thresholds: PlusThresholds) -> str:
    """IDF1, first frames, ids per object, error of the confidence."""
    scores, sure, right = [], [], []
    for one in recorded:
        ids, confidence = answer(one, thresholds)
        scores.append(judge(one, ids))
        known = (one.truth != NO_INSTANCE) & (ids >= 0)
        sure.append(confidence[known])
        right.append(is_right(one.truth[known], ids[known]))
    means = [np.mean([score[key] for score in scores]) for key in ("IDF1", "HardRecovery")]
    ids, objects = (sum(score[key] for score in scores) for key in ("ids", "objects"))
    error = calibration_error(np.concatenate(sure), np.concatenate(right))
    return f"{means[0]:.1f}/{means[1]:.1f}/{ids / objects:.2f}/{100 * error:.1f}"


def calibration_error(sure: np.ndarray, right: np.ndarray) -> float:
    """Mean distance of confidence and share of right answers, in ten bins."""
    bins = np.minimum((_BINS * sure).astype(int), _BINS - 1)
    shares = [
        abs(sure[bins == k].mean() - right[bins == k].mean()) * (bins == k).mean()
        for k in np.unique(bins)
    ]
    return float(np.sum(shares))


def read_changes(text: str) -> Changes:
    """`group.setting=value ...` as changes of thresholds."""
    changes: Changes = {}
    for item in text.split():
        name, value = item.split("=")
        group, setting = name.split(".")
        kept = getattr(getattr(PlusThresholds(), group), setting)
        changes.setdefault(group, {})[setting] = type(kept)(float(value))
    return changes


def compare(groups: list[str], tried: list[str], given: list[str], cache: Path) -> Iterator[dict]:
    """One row per group and form, one cell per setting."""
    for group in groups:
        recorded = recordings(group, given, cache)
        if not recorded:
            continue
        one_class = [without_classes(one) for one in recorded]
        forms = [(f"{group}, one class", one_class)]
        if group not in ALWAYS_ONE_CLASS:
            forms.insert(0, (group, recorded))
        for name, sequence in forms:
            cells = {
                text: measure(sequence, changed(PlusThresholds(), read_changes(text)))
                for text in tried
            }
            yield {"name": name, **cells}


def main() -> None:
    """Prints a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("groups", nargs="*", help=f"of {', '.join(GROUPS)}; all without any")
    parser.add_argument("--given", nargs="+", default=[], help="sequences with true instances")
    parser.add_argument(
        "--try",
        dest="tried",
        action="append",
        default=[""],
        help='settings, as "layout.weight=1 decision.new=1.2"; beside those as they are',
    )
    parser.add_argument("--cache", type=Path, default=Path("build/plus_groups"))
    parser.add_argument("--json", type=Path)
    given = parser.parse_intermixed_args()
    unknown = set(given.groups) - set(GROUPS)
    if unknown:
        parser.error(f"there are no groups {', '.join(sorted(unknown))}; give {', '.join(GROUPS)}")
    show_rows(
        compare(given.groups or list(GROUPS), given.tried, given.given, given.cache), given.json
    )


if __name__ == "__main__":
    main()
