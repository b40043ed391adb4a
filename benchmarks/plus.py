"""What every part of REMIND plus is worth, and where its assumptions break.

    python benchmarks/plus.py ladder SEQUENCE...       each part added in turn, and left out alone
    python benchmarks/plus.py hardship SEQUENCE...     with less information, in another order, cut
    python benchmarks/plus.py stress [NAME ...]        generated tours that break its assumptions
    python benchmarks/plus.py reliability SEQUENCE...  how often sure answers are right

A sequence is whatever `remind_jax.sources.open_source` reads and holds true instances. Answers are
causal, every mask is a detection, an undecided one counts as the answer it would get now.
`--one-class` takes the classes away, `--backbone` changes the features, `--json FILE` writes rows,
`--seeds N` makes each row of `stress` the mean of up to four tours.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import sys
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

from benchmarks.detector_noise import DetectorNoise, add_detector_noise
from benchmarks.plus_recording import (
    Changes,
    Recording,
    answer,
    as_one_class,
    changed,
    is_right,
    judge,
    record,
)
from benchmarks.rows import show_rows
from remind_jax.backbone.registry import get_backbone
from remind_jax.frame import NO_INSTANCE, Frame
from remind_jax.plus.observation import Motion
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.session.live import Tracker
from remind_jax.sources import open_source
from remind_jax.synthetic import LookalikeGroup, SceneOptions, make_scene, render
from remind_jax.synthetic.shapes import CLASSES

# From appearance alone to the complete method; each step keeps those before.
BARE: Changes = {
    "looks": {"whitening": False, "ring_weight": 0.0},
    "calibration": {"enabled": False},
    "decision": {
        "crowd": 0.0,
        "familiarity": 0.0,
        "familiarity_open": 0.0,
        "tentative": 0.0,
        "tentative_border": 0.0,
        "ended_age": 0,
        "held": 0.0,
    },
    "place": {"weight": 0.0},
    "layout": {
        "weight": 0.0,
        "covisible_weight": 0.0,
        "moved": -100.0,
        "gone_anchors": 1_000_000,
    },
    "motion": {"checked": False},
    "mobility": {"weight": 0.0},
}
# Settings that each step brings, at their present values.
LADDER: tuple[tuple[str, dict[str, tuple[str, ...]]], ...] = (
    ("tracklets, appearance, joint assignment", {}),
    ("+ whitening", {"looks": ("whitening",)}),
    ("+ calibration", {"calibration": ("enabled",)}),
    ("+ number of candidates", {"decision": ("crowd",)}),
    ("+ background", {"looks": ("ring_weight",)}),
    ("+ place", {"place": ("weight",)}),
    ("+ companions", {"layout": ("covisible_weight",)}),
    ("+ layout", {"layout": ("weight", "moved")}),
    ("+ familiarity", {"decision": ("familiarity",)}),
    ("+ memory of undecided tracklets", {"decision": ("ended_age",)}),
    ("+ missed objects held", {"decision": ("held",)}),
    ("+ checked motion", {"motion": ("checked",)}),
    ("+ familiarity of what is in view", {"decision": ("familiarity_open",)}),
    ("+ empty places", {"layout": ("gone_anchors",)}),
    ("+ early preference for known", {"decision": ("tentative", "tentative_border")}),
    ("+ own movement = plus", {"mobility": ("weight",)}),
)
WITHOUT_PLACE: Changes = {
    "place": {"weight": 0.0},
    "layout": {"weight": 0.0, "covisible_weight": 0.0},
}

_ALIKE = (
    LookalikeGroup("mug", 3, "glaze"),
    LookalikeGroup("box", 2, "identical", rooms=(0, 1)),
    LookalikeGroup("vase", 2, "tint"),
)
# Development seeds, below those of the benchmark.
TOUR = SceneOptions(
    width=480, height=360, min_mask_px=150, frames=160, num_rooms=2, objects_per_room=13,
    lookalikes=_ALIKE, absence_frames=60, light_drop=0.3,
)  # fmt: skip
# From one tour of a `STRESS` row to the next; with more tours, seeds would reach the benchmark's.
SEEDS_APART, MOST_SEEDS = 20, 4
# Twenty objects that fly about one room, in sight of a camera that stays there.
MOVING_WORLD = {
    "frames": 200, "num_rooms": 1, "objects_per_room": 20, "absence_frames": 0, "light_drop": 1.0,
    "roaming": 1.0,
    "lookalikes": (
        LookalikeGroup("mug", 3, "glaze"),
        LookalikeGroup("vase", 2, "tint"),
        LookalikeGroup("box", 3, "pattern"),
    ),
}  # fmt: skip
STRESS: dict[str, tuple[dict[str, Any], DetectorNoise | None]] = {
    "as is": ({"seed": 1}, None),
    "moved 30 %": ({"seed": 4, "moved": 0.3}, None),
    "removed, added 30 %": ({"seed": 5, "removed": 0.3, "added": 0.3}, None),
    "swapped 30 %": ({"seed": 6, "swapped": 0.3}, None),
    "roll 15 deg": ({"seed": 7, "roll_deg": 15.0}, None),
    "zoom 1.6": ({"seed": 8, "zoom": 1.6}, None),
    "jumps": ({"seed": 9, "jumps": 8}, None),
    "walking": ({"seed": 10, "shake": 8.0}, None),
    "half of the frames": ({"seed": 11, "dropped_frames": 0.5}, None),
    "masks jittered": ({"seed": 12}, DetectorNoise(jitter_px=2.0)),
    "30 % missing": ({"seed": 13}, DetectorNoise(missing=0.3)),
    "split, merged, false": ({"seed": 14}, DetectorNoise(split=0.1, merged=0.1, false=0.3)),
    "wrong classes 10 %": ({"seed": 15}, DetectorNoise(wrong_class=0.1)),
    "masks every 3 frames": ({"seed": 16}, DetectorNoise(every=3)),
    "all roam, still camera": ({**MOVING_WORLD, "seed": 31, "camera": "still"}, None),
    "all roam, still camera 2": ({**MOVING_WORLD, "seed": 32, "camera": "still"}, None),
    "all roam, camera pans": ({**MOVING_WORLD, "seed": 33, "camera": "pan"}, None),
    "all roam, camera pans 2": ({**MOVING_WORLD, "seed": 34, "camera": "pan"}, None),
    "40 % roam, camera pans": ({**MOVING_WORLD, "seed": 35, "camera": "pan", "roaming": 0.4}, None),
    "30 % roam, tour": ({"seed": 36, "roaming": 0.3}, None),
    "half roams, still camera": (
        {**MOVING_WORLD, "seed": 37, "camera": "still", "roaming": 0.5, "objects_per_room": 24},
        None,
    ),
}
HARDSHIPS = {
    "30 % of the masks missing": DetectorNoise(missing=0.3),
    "masks in every third frame": DetectorNoise(every=3),
}


def climb(names: list[str], backbone: str, one_class: bool) -> Iterator[dict[str, Any]]:
    """Each part added in turn, then each part left out of the complete method."""
    recordings = _record_all(names, backbone, one_class)
    complete = PlusThresholds()
    thresholds = changed(complete, BARE)
    for name, brought in LADDER:
        present = {
            group: {key: getattr(getattr(complete, group), key) for key in keys}
            for group, keys in brought.items()
        }
        thresholds = changed(thresholds, present)
        yield _row(name, recordings, thresholds)
    assert thresholds == complete, "the last step is the complete method"
    for name, brought in LADDER[1:]:
        without = {
            group: {key: BARE[group][key] for key in keys} for group, keys in brought.items()
        }
        label = name.removeprefix("+ ").removesuffix(" = plus")
        yield _row(f"plus without {label}", recordings, changed(complete, without))
    frames_alone = _record_all(names, backbone, one_class, closeups="never")
    yield _row("plus without closeups", frames_alone, complete)


def _record_all(
    names: list[str], backbone: str, one_class: bool, closeups: str = "auto"
) -> list[Recording]:
    return [
        record(Path(name).name, open_source(name), backbone, one_class, closeups) for name in names
    ]


def _row(name: str, recordings: list[Recording], thresholds: PlusThresholds) -> dict[str, Any]:
    scores = [judge(one, answer(one, thresholds)[0]) for one in recordings]
    return {
        "name": name,
        **{key: _mean(scores, key) for key in ("IDF1", "AssA", "HardRecovery")},
        **{key: sum(s[key] for s in scores) for key in ("IDSW", "ids", "objects", "repeated")},
        "each": _each(scores),
    }


def bear(names: list[str], backbone: str, one_class: bool) -> Iterator[dict[str, Any]]:
    """Sequences as they are, with missing or wrong input, in another order, and cut."""

    def recorded(change: Callable[[str], Iterable[Frame]]) -> list[Recording]:
        return [record(Path(name).name, change(name), backbone, one_class) for name in names]

    as_is = recorded(open_source)
    yield _row("as is", as_is, PlusThresholds())
    motions = {
        "no image motion": _without_motion,
        "a tenth of the motions wrong": _with_wrong_motion,
    }
    for label, observed in motions.items():
        changed_motion = [dataclasses.replace(one, motion=observed(one.motion)) for one in as_is]
        yield _row(label, changed_motion, PlusThresholds())
    following = dict(zip(names, (*names[1:], names[0]), strict=True))
    changes: dict[str, Callable[[str], Iterable[Frame]]] = {
        "backwards": backwards,
        "second half first": second_half_first,
        **{label: functools.partial(_noisy, noise=noise) for label, noise in HARDSHIPS.items()},
        "another sequence cut into the middle": lambda name: _cut_into(name, following[name]),
    }
    for label, change in changes.items():
        yield _row(label, recorded(change), PlusThresholds())


def _noisy(name: str, noise: DetectorNoise) -> Iterator[Frame]:
    return add_detector_noise(open_source(name), noise, ())


def backwards(name: str) -> Iterator[Frame]:
    return _renumbered(reversed(list(open_source(name))))


def second_half_first(name: str) -> Iterator[Frame]:
    frames = list(open_source(name))
    half = len(frames) // 2
    return _renumbered((*frames[half:], *frames[:half]))


def _renumbered(frames: Iterable[Frame]) -> Iterator[Frame]:
    """The frames in this order as a sequence of their own."""
    for index, frame in enumerate(frames):
        yield dataclasses.replace(frame, index=index)


def _cut_into(name: str, other: str) -> Iterator[Frame]:
    """Half of a sequence, all of another of the same frame size, and the other half."""
    first, middle = list(open_source(name)), [_renamed(frame) for frame in open_source(other)]
    half = len(first) // 2
    return _renumbered((*first[:half], *middle, *first[half:]))


def _renamed(frame: Frame) -> Frame:
    """With other instances than those of the sequence that it is cut into."""
    assert frame.detections is not None
    ids = frame.detections.instance_ids
    others = np.where(ids == NO_INSTANCE, NO_INSTANCE, ids + 100_000)
    return dataclasses.replace(
        frame, detections=dataclasses.replace(frame.detections, instance_ids=others)
    )


def _without_motion(motion: Motion) -> Motion:
    """As if the motion of the image could not be estimated."""
    still = np.broadcast_to(np.eye(2, 3, dtype=motion.matrix.dtype), motion.matrix.shape)
    return dataclasses.replace(motion, matrix=still, score=np.zeros_like(motion.score))


def _with_wrong_motion(motion: Motion, share: float = 0.1) -> Motion:
    """Motion of some frames is wrong by up to half a frame, with a good score."""
    rng = np.random.default_rng(0)
    chosen = rng.random(len(motion.score)) < share
    units = motion.frame_size.max(axis=1, keepdims=True)
    matrix, score = motion.matrix.copy(), motion.score.copy()
    matrix[chosen, :, 2] += rng.uniform(-0.5, 0.5, (int(chosen.sum()), 2)) * units[chosen]
    score[chosen] = 0.95
    return dataclasses.replace(motion, matrix=matrix, score=score)


def strain(
    names: list[str], seeds: int, backbone: str, one_class: bool
) -> Iterator[dict[str, Any]]:
    """Plus, plus without place evidence, and the bank of twelve on tours that break assumptions.

    Each row is the mean of as many tours as there are seeds; identities and objects are sums.
    """
    blind = changed(PlusThresholds(), WITHOUT_PLACE)
    for name in names or STRESS:
        options, noise = STRESS[name]
        judged: dict[str, list[dict[str, float]]] = {"plus": [], "without_place": [], "bank": []}
        for repeat in range(seeds):
            seed = options["seed"] + repeat * SEEDS_APART
            scene = make_scene(dataclasses.replace(TOUR, **{**options, "seed": seed}))
            frames: Iterable[Frame] = render(scene)
            if noise is not None:
                noise_here = dataclasses.replace(noise, seed=noise.seed + repeat)
                frames = add_detector_noise(frames, noise_here, tuple(CLASSES))
            kept = list(frames)
            recording = record(name, kept, backbone, one_class)
            answers = {
                "plus": answer(recording, PlusThresholds())[0],
                "without_place": answer(recording, blind)[0],
                "bank": _bank_answers(recording, kept, backbone, one_class),
            }
            for method, ids in answers.items():
                judged[method].append(judge(recording, ids))

        plus, bank = judged["plus"], judged["bank"]
        yield {
            "name": name,
            **{method: _mean(scores, "IDF1") for method, scores in judged.items()},
            "first_frame": _mean(plus, "HardRecovery"),
            "first_frame_bank": _mean(bank, "HardRecovery"),
            **{key: sum(score[key] for score in plus) for key in ("ids", "objects", "repeated")},
            "each": _each(plus),
            "each_bank": _each(bank),
        }


def _mean(scores: list[dict[str, float]], key: str) -> float:
    return float(np.mean([score[key] for score in scores]))


def _each(scores: list[dict[str, float]]) -> str:
    return "/".join(f"{score['IDF1']:.1f}" for score in scores)


def _bank_answers(
    recording: Recording, frames: list[Frame], backbone: str, one_class: bool
) -> np.ndarray:
    config = {"tracker": "bank", "input": {"ignored_classes": []}}
    live = Tracker(config, get_backbone(backbone))
    ids = np.full(recording.truth.shape, -1)
    for row, frame in enumerate(frames):
        tracks = live.update(as_one_class(frame) if one_class else frame)
        ids[row, : len(tracks)] = tracks.object_id
    return ids


def reliability(recordings: list[Recording]) -> Iterator[dict[str, Any]]:
    """Confidence against the share of right answers, in ten bins, and their mean distance."""
    sure, right = [], []
    for one in recordings:
        ids, confidence = answer(one, PlusThresholds())
        known = (one.truth != NO_INSTANCE) & (ids >= 0)
        sure.append(confidence[known])
        right.append(is_right(one.truth[known], ids[known]))
    sure, right = np.concatenate(sure), np.concatenate(right)
    bins = np.minimum((10 * sure).astype(int), 9)
    error = 0.0
    for k in np.unique(bins):
        here = bins == k
        gap = abs(sure[here].mean() - right[here].mean())
        error += here.mean() * gap
        yield {
            "name": f"{k / 10:.1f} to {(k + 1) / 10:.1f}",
            "confidence": 100 * float(sure[here].mean()),
            "right": 100 * float(right[here].mean()),
            "detections": float(here.sum()),
        }
    yield {"name": "expected calibration error", "confidence": 100 * float(error)}


def main() -> None:
    """Prints a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("ladder", "hardship", "stress", "reliability"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--one-class", action="store_true")
    parser.add_argument("--backbone", default="patch-statistics")
    parser.add_argument(
        "--seeds",
        type=int,
        default=1,
        choices=range(1, MOST_SEEDS + 1),
        help="tours per stress row",
    )
    parser.add_argument("--json", type=Path)
    given = parser.parse_intermixed_args()  # so that names may follow options
    how = given.backbone, given.one_class
    if given.what == "stress":
        rows = strain(given.names, given.seeds, *how)
    elif given.what == "hardship":
        rows = bear(given.names, *how)
    elif given.what == "ladder":
        rows = climb(given.names, *how)
    else:
        rows = reliability(_record_all(given.names, *how))
    show_rows(rows, given.json)


if __name__ == "__main__":
    main()
