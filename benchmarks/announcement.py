"""How many detections it takes to tell a thing from a false detection.

    python benchmarks/announcement.py [DATA --detector MODEL.onnx] [--tours 3] [--json FILE]

DATA is a folder of sequences with masks (`remind_jax.sources.open_source`), each of which the
detector looks at anew; `--sequence` chooses one. Tours are rendered, their masks worsened as a
detector's (`benchmarks/detector_noise.py`). Every sequence is tracked once and told for each
`announce_after`; `--config` chooses the tracker.

Columns: `identities` announced; `seen5`, the objects of the truth that were detected five times or
more (one to one in a frame, overlap at least 0.5, whatever the class), and with `--unannotated`
those that the truth lacks, counted by eye; their `ratio`; `returns` of objects and how many of them
were `recovered`, both over all frames with a mask of the truth; `false`, identities that hold more
false detections than any object; `undecided`, in percent of the detections, online and in the end;
IDF1 without classes.
"""

from __future__ import annotations

import argparse
import dataclasses
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from hotcoco import mask as coco
from scipy.optimize import linear_sum_assignment

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.detector_noise import DetectorNoise, add_detector_noise
from benchmarks.rows import show_rows
from remind_jax.detectors import DetectorOptions, as_detector
from remind_jax.frame import NO_INSTANCE, Detections, Frame
from remind_jax.masks.run_length import encode_masks
from remind_jax.metrics import TrackingSequence, evaluate_sequence
from remind_jax.metrics.recovery import collect_answers, count_recovery, find_reference
from remind_jax.numerics.absent import NO_ID
from remind_jax.outputs.presence import UNDECIDED
from remind_jax.session.announcement import Announcements, announce, as_announced
from remind_jax.session.live import Tracker
from remind_jax.sources import open_source
from remind_jax.synthetic import demo_options, make_scene, render
from remind_jax.synthetic.shapes import CLASSES
from remind_jax.tracks import Tracks

AFTER = (1, 2, 3, 4, 5, 6, 8)
OFTEN = 5  # detections of an object that should be announced

# About what a small network does on a video: the kitchen through YOLOv8n.
NOISE = DetectorNoise(
    jitter_px=1.5, missing=0.2, split=0.02, merged=0.01, false=0.15, wrong_class=0.02
)


@dataclasses.dataclass(frozen=True)
class Seen:
    """One frame of a sequence, as decided."""

    tracks: Tracks
    merges: list[tuple[int, int]]
    truth_ids: np.ndarray  # [G] objects visible
    overlap: np.ndarray  # [N, G] of detections and objects


def track(frames: Iterable[tuple[Frame, Detections]], config: str) -> list[Seen]:
    """Decides every frame; each comes with the detections of the truth."""
    live = Tracker(config, announce_after=1)
    seen = []
    for frame, truth in frames:
        tracks = live.update(frame)
        merges = [] if live.method.host.merges is None else live.method.host.merges(live.state)
        true_rles = list(encode_masks(truth.masks))
        overlap = np.zeros((len(tracks), len(true_rles)))
        if overlap.size:
            overlap = coco.iou(list(tracks.rles), true_rles, [0] * len(true_rles))
        seen.append(Seen(tracks, merges, truth.instance_ids, overlap))
    return seen


def replay(seen: list[Seen], after: int) -> tuple[list[Tracks], list[Tracks]]:
    """What is told of every frame at once, and in the end."""
    announced, online = Announcements() if after == 1 else Announcements.all_below(0), []
    for one in seen:
        announced = announce(announced, one.tracks, after, one.merges)
        online.append(as_announced(announced, one.tracks))
    return online, [as_announced(announced, one.tracks) for one in seen]


def match(one: Seen) -> list[tuple[int, int]]:
    """Detections and the objects that they show, one to one."""
    overlap = np.where(one.overlap >= 0.5, one.overlap, 0.0)
    pairs = zip(*linear_sum_assignment(-overlap), strict=True)
    return [(int(r), int(g)) for r, g in pairs if overlap[r, g] > 0]


def count_often_seen(seen: list[Seen]) -> int:
    """Objects that were detected often enough to be announced."""
    ids = [int(one.truth_ids[g]) for one in seen for _, g in match(one)]
    return int(np.sum(np.unique(ids, return_counts=True)[1] >= OFTEN))


def sequence_of(seen: list[Seen], told: list[Tracks]) -> TrackingSequence:
    """Truth and firm answers, without classes."""
    gt: list[tuple[int, int]] = []
    pred: list[tuple[int, int]] = []
    pairs: list[tuple[int, int, float]] = []
    for number, (one, tracks) in enumerate(zip(seen, told, strict=True)):
        _, first = np.unique(tracks.object_id, return_index=True)
        rows = [int(r) for r in first if tracks.object_id[r] != NO_ID]
        for place, row in enumerate(rows):
            pairs += [
                (len(gt) + g, len(pred) + place, float(value))
                for g, value in enumerate(one.overlap[row])
                if value > 0
            ]
        gt += [(number, int(i)) for i in one.truth_ids]
        pred += [(number, int(tracks.object_id[row])) for row in rows]
    columns = [np.array(column) for column in zip(*pairs, strict=True)]
    return TrackingSequence.create(
        len(seen),
        tuple(np.array(column) for column in zip(*gt, strict=True)),
        tuple(np.array(column) for column in zip(*pred, strict=True)),
        tuple(columns),
        name="",
    )


def count_false(seen: list[Seen], told: list[Tracks]) -> int:
    """Identities most of whose detections show no object."""
    shows: dict[int, list[int]] = {}
    for one, tracks in zip(seen, told, strict=True):
        true = {row: int(one.truth_ids[g]) for row, g in match(one)}
        for row, object_id in enumerate(tracks.object_id.tolist()):
            if object_id != NO_ID:
                shows.setdefault(object_id, []).append(true.get(row, NO_INSTANCE))
    return sum(max(set(kinds), key=kinds.count) == NO_INSTANCE for kinds in shows.values())


def undecided_percent(told: list[Tracks]) -> float:
    outcomes = np.concatenate([tracks.outcome for tracks in told])
    return 100 * float(np.mean(np.isin(outcomes, UNDECIDED)))


def rows_of(name: str, seen: list[Seen], unannotated: int = 0) -> Iterator[dict[str, Any]]:
    often = count_often_seen(seen) + unannotated
    for after in AFTER:
        online, final = replay(seen, after)
        sequence = sequence_of(seen, final)
        answers = collect_answers(sequence)
        returns = count_recovery(answers, find_reference(answers))
        ids = {int(i) for tracks in final for i in tracks.object_id if i != NO_ID}
        yield {
            "name": f"{name}, announce_after {after}",
            "identities": len(ids),
            "seen5": often,
            "ratio": f"{len(ids) / often:.2f}",
            "returns": int(returns.opportunities.sum()),
            "recovered": int(returns.recovered.sum()),
            "false": count_false(seen, final),
            "online": undecided_percent(online),
            "undecided": undecided_percent(final),
            "IDF1": 100 * evaluate_sequence(sequence).scores()["IDF1"],
        }


def detected(folder: Path, model: Path, options: DetectorOptions) -> Iterator[Any]:
    """Frames with the detections of a network, and the true ones."""
    detector = as_detector(model, options)
    assert detector is not None
    for frame in open_source(folder):
        assert frame.image is not None
        assert frame.detections is not None
        yield dataclasses.replace(frame, detections=detector(frame.image)), frame.detections


def worsened(seed: int, num_frames: int) -> Iterator[Any]:
    """Frames of a rendered tour with worse detections, and the true ones."""
    options = dataclasses.replace(demo_options(seed), frames=num_frames)
    true = list(render(make_scene(options)))
    noise = dataclasses.replace(NOISE, seed=seed)
    for frame, worse in zip(true, add_detector_noise(true, noise, tuple(CLASSES)), strict=True):
        yield worse, frame.detections


def measure(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    options = DetectorOptions(
        confidence=args.confidence, suppress_across_classes=args.class_agnostic
    )
    folders = sorted(args.data.iterdir()) if args.data and args.data.is_dir() else []
    sequences = [f for f in folders if (f / "Annotations").is_dir()]
    if args.sequence:
        sequences = [folder for folder in sequences if folder.name in args.sequence]
    if args.detector is None or not args.detector.is_file():
        yield {"name": "sequences", "absent": "no detector: give --detector MODEL.onnx"}
        sequences = []
    elif not sequences:
        yield {"name": "sequences", "absent": f"no sequence with masks in {args.data}"}
    for folder in sequences:
        seen = track(detected(folder, args.detector, options), args.config)
        yield from rows_of(folder.name, seen, args.unannotated)
    for seed in range(1, args.tours + 1):
        seen = track(worsened(seed, args.frames), args.config)
        yield from rows_of(f"tour {seed}", seen)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("data", type=Path, nargs="?", help="folder of sequences with masks")
    parser.add_argument("--detector", type=Path, help="ONNX segmentation export")
    parser.add_argument("--sequence", nargs="*", help="only these")
    parser.add_argument("--unannotated", type=int, default=0, help="seen5 that the truth lacks")
    parser.add_argument("--confidence", type=float, default=DetectorOptions.confidence)
    parser.add_argument("--class-agnostic", action="store_true")
    parser.add_argument("--config", default="default")
    parser.add_argument("--tours", type=int, default=3, help="rendered tours, seeds from 1 on")
    parser.add_argument("--frames", type=int, default=120, help="of a tour")
    parser.add_argument("--json", type=Path)
    args = parser.parse_args()
    show_rows(measure(args), args.json)


if __name__ == "__main__":
    main()
