"""What every part of REMIND plus is worth, where its assumptions break, and what it costs.

    python benchmarks/plus.py ladder SEQUENCE...       each part added in turn, and left out alone
    python benchmarks/plus.py stress [NAME ...]        generated tours that break its assumptions
    python benchmarks/plus.py reliability SEQUENCE...  how often sure answers are right
    python benchmarks/plus.py cost                     time of a step and size of the memory
    python benchmarks/plus.py endurance                3,000 frames along 200 made-up things

A sequence is whatever `remind_jax.sources.open_source` reads and holds true instances. Answers are
causal, every mask is a detection, an undecided one counts as the answer it would get now.
`--one-class` takes the classes away, `--backbone` changes the features, `--json FILE` writes rows.
"""

from __future__ import annotations

import argparse
import dataclasses
import functools
import json
import time
from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import remind_jax as rj
from remind_jax.backbone.registry import get_backbone
from remind_jax.config import Static, load_config
from remind_jax.frame import NO_INSTANCE, Frame
from remind_jax.live import Tracker
from remind_jax.mask_reduction import pad_masks
from remind_jax.metrics import TrackingSequence, evaluate_sequence
from remind_jax.observation import FrameFeats
from remind_jax.plus.observation import Motion, Sightings, observe
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import advance
from remind_jax.sources import open_source
from remind_jax.synthetic import (
    DetectorNoise,
    LookalikeGroup,
    SceneOptions,
    add_detector_noise,
    make_scene,
    render,
)
from remind_jax.synthetic.shapes import CLASSES

Changes = dict[str, dict[str, Any]]

# From nothing but looks to everything; each step keeps those before.
BARE: Changes = {
    "looks": {"whitening": False, "ring_weight": 0.0},
    "calibration": {"enabled": False},
    "decision": {
        "crowd": 0.0,
        "familiarity": 0.0,
        "familiarity_open": 0.0,
        "late_frames": 0,
        "ended_age": 0,
        "held": 0.0,
    },
    "place": {"weight": 0.0},
    "layout": {
        "weight": 0.0,
        "covisible_weight": 0.0,
        "optimism": 0.0,
        "moved": -100.0,
        "witness": 100.0,
        "gone_anchors": 1_000_000,
    },
    "motion": {"checked": False},
}
LADDER: tuple[tuple[str, Changes], ...] = (
    ("tracklets, looks, joint assignment", {}),
    ("+ whitening", {"looks": {"whitening": True}}),
    ("+ calibration", {"calibration": {"enabled": True}}),
    ("+ number of rivals", {"decision": {"crowd": 0.7}}),
    ("+ background", {"looks": {"ring_weight": 0.3}}),
    ("+ place", {"place": {"weight": 0.8}}),
    ("+ companions", {"layout": {"covisible_weight": 0.6}}),
    ("+ layout", {"layout": {"weight": 0.8, "moved": -3.0}}),
    ("+ optimism", {"layout": {"optimism": 4.0}}),
    ("+ familiarity", {"decision": {"familiarity": 0.8}}),
    ("+ late recognition", {"decision": {"late_frames": 60}}),
    ("+ memory of what ended open", {"decision": {"ended_age": 2}}),
    ("+ held while missed", {"decision": {"held": 3.0}}),
    ("+ checked motion", {"motion": {"checked": True}}),
    ("+ familiarity of what is in view", {"decision": {"familiarity_open": 1.0}}),
    ("+ empty places", {"layout": {"gone_anchors": 3}}),
    ("+ credible witnesses = plus", {"layout": {"witness": 0.5}}),
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
_TOUR = SceneOptions(
    width=480, height=360, min_mask_px=150, frames=160, num_rooms=2, objects_per_room=13,
    lookalikes=_ALIKE, absence_frames=60, light_drop=0.3,
)  # fmt: skip
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
}


@dataclasses.dataclass(frozen=True)
class Recording:
    """A sequence as the step sees it; leading axis `T` frames."""

    name: str
    sightings: Sightings
    motion: Motion
    truth: np.ndarray  # [T, N] true instance, NO_INSTANCE without one
    present: np.ndarray  # [T, N] slots that hold a mask


def record(name: str, frames: Iterable[Frame], backbone: str, one_class: bool) -> Recording:
    """Reduces, describes and pools every frame once."""
    config = load_config("plus")
    live = Tracker(config, get_backbone(backbone))
    prepared, features = [], []
    for frame in frames:
        if one_class and frame.detections is not None:
            same = dataclasses.replace(frame.detections, labels=("thing",) * len(frame.detections))
            frame = dataclasses.replace(frame, detections=same)
        ready = live.prepare(frame)
        prepared.append(ready)
        assert ready.image is not None, "a sequence without images has no motion to observe"
        features.append(live.backbone.extract(ready.image[None])[0])
    num = max(1, max(len(one.detections) for one in prepared))
    look = jax.jit(functools.partial(observe, unit_patches=jnp.array(True)))
    seen = []
    for one, patches in zip(prepared, features, strict=True):
        feats = FrameFeats(patches, np.array(one.frame.size, np.int32))
        seen.append(jax.device_get(look(feats, pad_masks(one.masks, num), one.observed)))
    sightings, motion = jax.tree.map(lambda *leaves: np.stack(leaves), *seen)
    truth = np.full((len(prepared), num), NO_INSTANCE)
    present = np.zeros((len(prepared), num), bool)
    for row, one in enumerate(prepared):
        truth[row, : len(one.detections)] = one.detections.instance_ids
        present[row, : len(one.detections)] = one.masks.valid
    return Recording(name, sightings, motion, truth, present)


@functools.partial(jax.jit, static_argnames="static")
def _scan(state: Any, frames: Any, thresholds: PlusThresholds, static: Static) -> Any:
    def one(state: Any, frame: Any) -> Any:
        state = advance(state, *frame, static=static, thresholds=thresholds)
        told = (state.verdicts.answer_id, state.decisions.confidence, state.overflow.objects)
        return state, told

    return jax.lax.scan(one, state, frames)[1]


def answer(recording: Recording, thresholds: PlusThresholds) -> tuple[np.ndarray, np.ndarray]:
    """Answers and their confidence `[T, N]`."""
    static = Static(
        num_detections=recording.truth.shape[1],
        num_objects=128,
        feature_dim=recording.sightings.look.shape[-1],
    )
    frames = (recording.sightings, recording.motion, recording.present)
    while True:
        ids, confidence, lacking = jax.device_get(_scan(init(static), frames, thresholds, static))
        if not lacking.any():
            return ids, confidence
        static = static.grow(num_objects=2 * static.num_objects)


def judge(recording: Recording, ids: np.ndarray) -> dict[str, float]:
    """Scores of answers; `repeated` counts ids that a frame gives more than once."""
    frame = np.broadcast_to(np.arange(len(ids))[:, None], ids.shape)
    said = ids >= 0
    repeated = 0
    for row in range(len(ids)):
        given = np.flatnonzero(said[row])
        _, first = np.unique(ids[row, given], return_index=True)
        extra = np.delete(given, first)
        said[row, extra] = False
        repeated += len(extra)
    # Two detections of one object in a frame: the first one is the object.
    true = recording.truth != NO_INSTANCE
    for row in range(len(ids)):
        given = np.flatnonzero(true[row])
        _, first = np.unique(recording.truth[row, given], return_index=True)
        true[row, np.delete(given, first)] = False
    both = (true & said).ravel()
    pairs = (np.cumsum(true) - 1)[both], (np.cumsum(said) - 1)[both], np.ones(int(both.sum()))
    sequence = TrackingSequence.create(
        len(ids),
        (frame[true], recording.truth[true]),
        (frame[said], ids[said]),
        pairs,
        name=recording.name,
    )
    scores = evaluate_sequence(sequence).scores()
    return {
        "IDF1": 100 * scores["IDF1"],
        "AssA": 100 * scores["AssA"],
        "HardRecovery": 100 * scores["HardRecovery"],
        "IDSW": scores["IDSW"],
        "ids": float(len(np.unique(ids[said]))),
        "objects": float(len(np.unique(recording.truth[true]))),
        "repeated": float(repeated),
    }


def changed(thresholds: PlusThresholds, changes: Changes) -> PlusThresholds:
    """Thresholds with some values of some groups changed."""
    groups = {
        group: dataclasses.replace(getattr(thresholds, group), **values)
        for group, values in changes.items()
    }
    return dataclasses.replace(thresholds, **groups)


def climb(recordings: list[Recording]) -> Iterator[dict[str, Any]]:
    """The ladder upwards, then every part left out of the whole."""
    thresholds = changed(PlusThresholds(), BARE)
    for name, changes in LADDER:
        thresholds = changed(thresholds, changes)
        yield _row(name, recordings, thresholds)
    for name, changes in LADDER[1:]:
        without = {
            group: {key: BARE[group][key] for key in values} for group, values in changes.items()
        }
        label = name.removeprefix("+ ").removesuffix(" = plus")
        yield _row(f"plus without {label}", recordings, changed(PlusThresholds(), without))


def _row(name: str, recordings: list[Recording], thresholds: PlusThresholds) -> dict[str, Any]:
    scores = [judge(one, answer(one, thresholds)[0]) for one in recordings]
    return {
        "name": name,
        **{
            key: float(np.mean([s[key] for s in scores]))
            for key in ("IDF1", "AssA", "HardRecovery")
        },
        **{key: sum(s[key] for s in scores) for key in ("IDSW", "ids", "objects", "repeated")},
        "each": "/".join(f"{s['IDF1']:.1f}" for s in scores),
    }


def strain(names: list[str], backbone: str, one_class: bool) -> Iterator[dict[str, Any]]:
    """Plus, plus without place evidence, and the bank of twelve on tours that break assumptions."""
    for name in names or STRESS:
        options, noise = STRESS[name]
        frames: Iterable[Frame] = render(make_scene(dataclasses.replace(_TOUR, **options)))
        if noise is not None:
            frames = add_detector_noise(frames, noise, tuple(CLASSES))
        kept = list(frames)
        recording = record(name, kept, backbone, one_class)
        plus = judge(recording, answer(recording, PlusThresholds())[0])
        blind = changed(PlusThresholds(), WITHOUT_PLACE)
        without = judge(recording, answer(recording, blind)[0])
        bank = judge(recording, _bank_answers(recording, kept, backbone, one_class))
        yield {
            "name": name,
            "plus": plus["IDF1"],
            "without_place": without["IDF1"],
            "bank": bank["IDF1"],
            "ids": plus["ids"],
            "objects": plus["objects"],
            "repeated": plus["repeated"],
        }


def _bank_answers(
    recording: Recording, frames: list[Frame], backbone: str, one_class: bool
) -> np.ndarray:
    config = {"tracker": "bank", "input": {"ignored_classes": []}}
    live = Tracker(config, get_backbone(backbone))
    ids = np.full(recording.truth.shape, -1)
    for row, frame in enumerate(frames):
        if one_class and frame.detections is not None:
            labels = ("thing",) * len(frame.detections)
            same = dataclasses.replace(frame.detections, labels=labels)
            frame = dataclasses.replace(frame, detections=same)
        told = live.update(frame)
        ids[row, : len(told)] = told.object_id
    return ids


def reliability(recordings: list[Recording]) -> Iterator[dict[str, Any]]:
    """Confidence against the share of right answers, in ten bins, and their mean distance."""
    sure, right = [], []
    for one in recordings:
        ids, confidence = answer(one, PlusThresholds())
        known = (one.truth != NO_INSTANCE) & (ids >= 0)
        sure.append(confidence[known])
        right.append(_is_right(one.truth[known], ids[known]))
    sure, right = np.concatenate(sure), np.concatenate(right)
    bins = np.minimum((10 * sure).astype(int), 9)
    error = 0.0
    for k in np.unique(bins):
        here = bins == k
        gap = abs(sure[here].mean() - right[here].mean())
        error += here.mean() * gap
        yield {
            "name": f"{k / 10:.1f} to {(k + 1) / 10:.1f}",
            "told": 100 * sure[here].mean(),
            "right": 100 * right[here].mean(),
            "detections": float(here.sum()),
        }
    yield {"name": "expected calibration error", "told": 100 * error}


def _is_right(truth: np.ndarray, ids: np.ndarray) -> np.ndarray:
    """Whether an answer is the one id that fits its object best, one to one over the sequence."""
    from scipy.optimize import linear_sum_assignment

    _, row = np.unique(truth, return_inverse=True)
    _, column = np.unique(ids, return_inverse=True)
    common = np.zeros((row.max() + 1, column.max() + 1))
    np.add.at(common, (row, column), 1)
    reference = dict(zip(*linear_sum_assignment(-common), strict=True))
    return np.array([reference.get(r) == c for r, c in zip(row, column, strict=True)])


def cost() -> Iterator[dict[str, Any]]:
    """Milliseconds of a step and megabytes of the memory for some capacities."""
    for detections, objects, dim in ((12, 60, 177), (12, 60, 384), (30, 200, 384), (30, 500, 384)):
        static = Static(
            num_detections=detections, num_objects=objects + detections, feature_dim=dim
        )
        frames = _made_up_frames(detections, objects, dim)
        state = init(static)
        size = sum(leaf.nbytes for leaf in jax.tree.leaves(state)) / 2**20
        step = jax.jit(
            functools.partial(advance, static=static, thresholds=PlusThresholds()),
            donate_argnums=0,
        )
        spent = []
        for frame in frames:
            start = time.perf_counter()
            state = jax.block_until_ready(step(state, *frame))
            spent.append(1000 * (time.perf_counter() - start))
        known = int(jnp.sum(state.objects.exists))
        settled = spent[len(spent) // 2 :]
        yield {
            "name": f"{detections} detections, {known} objects, D {dim}",
            "median_ms": float(np.median(settled)),
            "p95_ms": float(np.percentile(settled, 95)),
            "least_ms": float(np.min(settled)),
            "compile_s": spent[0] / 1000,
            "memory_MiB": size,
        }


def endure(num_frames: int = 3000, num_things: int = 200) -> Iterator[dict[str, Any]]:
    """There and back along a corridor of things: identities, time and memory as it goes on."""
    recording = _corridor(num_frames, num_things)
    num, dim = recording.sightings.look.shape[1:]
    static = Static(num_detections=num, num_objects=num_things + 56, feature_dim=dim)
    state = init(static)
    size = sum(leaf.nbytes for leaf in jax.tree.leaves(state)) / 2**20
    step = jax.jit(
        functools.partial(advance, static=static, thresholds=PlusThresholds()), donate_argnums=0
    )
    ids, spent = np.full(recording.truth.shape, -1), np.zeros(num_frames)
    inputs = (recording.sightings, recording.motion, recording.present)
    for row in range(num_frames):
        frame = jax.tree.map(lambda leaf, row=row: leaf[row], inputs)
        start = time.perf_counter()
        state = jax.block_until_ready(step(state, *frame))
        spent[row] = 1000 * (time.perf_counter() - start)
        assert not int(state.overflow.objects), "more objects than there is room for"
        ids[row] = state.verdicts.answer_id
        if (row + 1) % (num_frames // 3) == 0:
            so_far = dataclasses.replace(recording, truth=recording.truth[: row + 1])
            scores = judge(so_far, ids[: row + 1])
            recent = spent[row + 1 - num_frames // 3 : row + 1]
            yield {
                "name": f"{row + 1} frames",
                **{key: scores[key] for key in ("IDF1", "IDSW", "ids", "objects", "repeated")},
                "in_memory": float(jnp.sum(state.objects.exists)),
                "median_ms": float(np.median(recent)),
                "memory_MiB": size,
            }


def _corridor(num_frames: int, num_things: int, dim: int = 64, most: int = 14) -> Recording:
    """A camera that goes there and back along things at random heights, six times."""
    rng = np.random.default_rng(0)
    along = 0.5 * np.arange(num_things)
    place = np.stack([along, rng.uniform(0.8, 4, num_things)], axis=1).astype(np.float32)
    look = rng.normal(size=(num_things, dim)).astype(np.float32)
    size = rng.uniform(0.3, 0.5, num_things).astype(np.float32)
    far = along[-1] - 5
    camera = far * (0.5 - 0.5 * np.cos(np.linspace(0, 6 * np.pi, num_frames))) - 0.5
    shape = (num_frames, most)
    truth = np.full(shape, NO_INSTANCE)
    center = np.zeros((*shape, 2), np.float32)
    for row, left in enumerate(camera):
        seen = np.flatnonzero((along > left + 0.3) & (along < left + 6.1))[:most]
        truth[row, : len(seen)] = seen
        center[row, : len(seen)] = place[seen] - np.float32([left, 0])
    present = truth != NO_INSTANCE
    which = np.where(present, truth, 0)
    center += rng.normal(0, 0.02, center.shape).astype(np.float32)
    half = size[which][..., None] / 2
    matrix = np.tile(np.eye(2, 3, dtype=np.float32), (num_frames, 1, 1))
    matrix[1:, 0, 2] = -np.diff(camera)
    sightings = Sightings(
        look=look[which] + rng.normal(0, 0.3, (*shape, dim)).astype(np.float32),
        ring=np.ones((*shape, dim), np.float32),
        has_ring=present,
        box=np.concatenate([center - half, center + half], axis=-1),
        center=center,
        size=size[which],
        patches=np.full(shape, 3.0, np.float32),
        class_id=np.zeros(shape, np.int32),
        touches=np.zeros(shape, bool),
        valid=present,
        frame_center=np.tile(np.float32([3.2, 2.4]), (num_frames, 1)),
        num_bad_patches=np.zeros(num_frames, np.int32),
    )
    score = np.full(num_frames, 0.9, np.float32)
    motion = Motion(matrix, score, np.tile(np.int32([480, 640]), (num_frames, 1)))
    return Recording("corridor", sightings, motion, truth, present)


def _made_up_frames(detections: int, objects: int, dim: int) -> list[Any]:
    """Every object in view for ten frames, group after group, twice."""
    rng = np.random.default_rng(0)
    look = rng.normal(size=(objects, dim)).astype(np.float32)
    place = rng.uniform(0.5, 5.5, (objects, 2)).astype(np.float32)
    groups = [
        np.arange(first, first + detections) % objects for first in range(0, objects, detections)
    ]
    motion = Motion(np.eye(2, 3, dtype=np.float32), np.float32(0.9), np.array([480, 640], np.int32))
    half, here = np.float32(0.2), np.ones(detections, bool)
    frames = []
    for index in 2 * [group for group in groups for _ in range(10)]:
        center = place[index]
        frames.append(
            (
                Sightings(
                    look=look[index] + 0.1 * rng.normal(size=(detections, dim)).astype(np.float32),
                    ring=look[index],
                    has_ring=here,
                    box=np.concatenate([center - half, center + half], axis=1),
                    center=center,
                    size=np.full(detections, 0.4, np.float32),
                    patches=np.full(detections, 3.0, np.float32),
                    class_id=np.zeros(detections, np.int32),
                    touches=~here,
                    valid=here,
                    frame_center=np.array([3.2, 2.4], np.float32),
                    num_bad_patches=np.int32(0),
                ),
                motion,
                here,
            )
        )
    return frames


def main() -> None:
    """Prints a table row by row."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("ladder", "stress", "reliability", "cost", "endurance"))
    parser.add_argument("names", nargs="*")
    parser.add_argument("--one-class", action="store_true")
    parser.add_argument("--backbone", default="patch-statistics")
    parser.add_argument("--json", type=Path)
    given = parser.parse_args()
    print(f"remind-jax {rj.__version__}, {jax.devices()[0].device_kind}", flush=True)
    if given.what == "cost":
        rows = cost()
    elif given.what == "endurance":
        rows = endure()
    elif given.what == "stress":
        rows = strain(given.names, given.backbone, given.one_class)
    else:
        recordings = [
            record(Path(name).name, open_source(name), given.backbone, given.one_class)
            for name in given.names
        ]
        rows = climb(recordings) if given.what == "ladder" else reliability(recordings)
    kept = []
    for row in rows:
        kept.append(row)
        cells = [f"{k} {v:.1f}" if isinstance(v, float) else str(v) for k, v in row.items()]
        print(f"{cells[0]:38s}", "  ".join(cells[1:]), flush=True)
    if given.json is not None:
        given.json.write_text(json.dumps(kept, indent=1))


if __name__ == "__main__":
    main()
