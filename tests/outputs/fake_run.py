"""A small made-up run: textured rectangles that move, leave and come back."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.formats.rows import boxes_of
from remind_jax.frame import Detections, Frame, SkippedFrame
from remind_jax.masks.run_length import encode_masks
from remind_jax.outputs.gallery import Sighting, SightingCollector
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import Event, MemoryUse, RunInfo
from remind_jax.outputs.writer import RunWriter
from remind_jax.tracks import Tracks

LABELS = ("cup", "cup", "book", "potted plant", "teddy bear", "chair")


def make_info(name: str = "kitchen tour", size: tuple[int, int] = (120, 160)) -> RunInfo:
    return RunInfo(
        name=name,
        source={"kind": "video", "path": "/data/kitchen.mp4", "stride": 2},
        frame_size=size,
        fps=10.0,
        class_names=tuple(dict.fromkeys(LABELS)),
        config={"tracker": "remind", "thresholds": {"match_min": 0.62, "use_parts": True}},
        backbone="patch-statistics",
        versions={"remind_jax": "0.1.0", "python": "3.11.7"},
        device="cpu",
        started_at="2026-11-21T03:00:00+00:00",
    )


def make_tracks(index: int, masks: np.ndarray, rows: list[dict]) -> Tracks:
    """Tracks of one frame; `rows` give what differs from a firm match with score 0.9."""
    rles = encode_masks(masks)
    candidate_id = np.full((len(rows), 3), -1, np.int32)
    candidate_score = np.zeros((len(rows), 3), np.float32)
    for row, values in enumerate(rows):
        for place, (object_id, score) in enumerate(values.get("candidates", ())):
            candidate_id[row, place], candidate_score[row, place] = object_id, score

    def column(key: str, default: float, kind: type) -> np.ndarray:
        return np.array([values.get(key, default) for values in rows], kind)

    return Tracks(
        frame_index=index,
        source_index=2 * index,
        time_s=index / 10,
        name=f"{2 * index:06d}.jpg",
        frame_size=(masks.shape[1], masks.shape[2]),
        outcome=column("outcome", Outcome.MATCH, np.int32),
        reason=column("reason", Reason.ASSIGNED, np.int32),
        object_id=column("object_id", -1, np.int32),
        pending_id=column("pending_id", -1, np.int32),
        status=column("status", Status.STRONG, np.int32),
        score=column("score", 0.9, np.float32),
        confidence=column("confidence", 0.8, np.float32),
        candidate_id=candidate_id,
        candidate_score=candidate_score,
        labels=tuple(values.get("label", "cup") for values in rows),
        boxes=boxes_of(rles).astype(np.float32),
        areas=masks.sum(axis=(1, 2), dtype=np.int32),
        detector_scores=column("detector_score", 0.95, np.float32),
        instance_ids=column("instance_id", -1, np.int32),
        rles=rles,
    )


def make_run(
    num_frames: int = 40, size: tuple[int, int] = (120, 160), num_objects: int = 6
) -> tuple[list[Frame], Result]:
    """Frames and the result of tracking them; odd objects leave for the middle third.

    Object 1 is undecided between 0 and 1 in the three frames after its return.
    """
    rng = np.random.default_rng(7)
    height, width = size
    background = rng.integers(60, 110, (height // 8, width // 8, 3), np.uint8)
    background = background.repeat(8, 0).repeat(8, 1)
    skins = [rng.integers(40, 255, (3,), np.uint8) for _ in range(num_objects)]
    gone = (num_frames // 3, 2 * num_frames // 3)
    frames, tracks, known = [], [], set[int]()
    for index in range(num_frames):
        image, masks, rows = background.copy(), [], []
        for number in range(num_objects):
            if number % 2 and gone[0] <= index < gone[1]:
                continue
            mask = _place(number, num_objects, index, num_frames, size)
            shade = rng.integers(-12, 12, (height, width, 1))
            image[mask] = np.clip(skins[number] + shade, 0, 255).astype(np.uint8)[mask]
            masks.append(mask)
            rows.append(_decide(number, index, gone[1], number in known))
            known.add(number)
        stack = np.array(masks)
        frames.append(
            Frame(
                index,
                2 * index,
                index / 10,
                f"{2 * index:06d}.jpg",
                image,
                Detections.create(stack, [row["label"] for row in rows]),
            )
        )
        tracks.append(make_tracks(index, stack, rows))
    result = Result(
        tracks=tuple(tracks),
        info=make_info(size=size),
        timings_ms={
            "decode": (rng.random(num_frames) + 2).tolist(),
            "step": (rng.random(num_frames) + 8).tolist(),
        },
        first_frame_ms=812.5,
        compile_s=6.25,
        memory=MemoryUse(objects=5, working_set=4, at_rest=1, bytes=1000),
        skipped=(SkippedFrame("000017.jpg", "the image is corrupt"),),
        events=(Event(12, "features", "2 patches were left out"),),
    )
    return frames, result


def _decide(number: int, index: int, back: int, known: bool) -> dict:
    row: dict = {"object_id": number, "label": LABELS[number % len(LABELS)]}
    if not known:
        return row | {"outcome": Outcome.NEW, "reason": Reason.CREATED_NEW, "score": 0.0}
    if number == 1 and back <= index < back + 3:
        return row | {
            "object_id": -1,
            "outcome": Outcome.AMBIGUOUS,
            "reason": Reason.KNOWN_BUT_AMBIGUOUS,
            "status": Status.AMBIGUOUS,
            "pending_id": 0,
            "candidates": [(1, 0.82), (0, 0.79)],
        }
    if number == 4 and index == back:
        return row | {
            "object_id": -1,
            "outcome": Outcome.PROVISIONAL_NEW,
            "reason": Reason.UNCERTAIN_NEW,
            "status": Status.WEAK,
        }
    return row | {"candidates": [(number, 0.9)]}


def _place(
    number: int, num_objects: int, index: int, num_frames: int, size: tuple[int, int]
) -> np.ndarray:
    """Mask of an object: rectangles and ellipses on a grid that drift to the right."""
    height, width = size
    columns = int(np.ceil(np.sqrt(num_objects * width / height)))
    rows = -(-num_objects // columns)
    cell_w, cell_h = width / (columns + 1), height / rows
    x = (number % columns + 0.5 + index / num_frames) * cell_w + cell_w / 4
    y = (number // columns + 0.55) * cell_h
    half_w, half_h = 0.32 * cell_w, 0.3 * cell_h
    ys, xs = np.mgrid[:height, :width]
    if number % 3 == 1:
        return ((xs - x) / half_w) ** 2 + ((ys - y) / half_h) ** 2 <= 1
    return (np.abs(xs - x) <= half_w) & (np.abs(ys - y) <= half_h)


def write_run(folder: Path, frames: Sequence[Frame], result: Result, **options: bool) -> None:
    """The folder of a run, as `remind run` writes it."""
    with RunWriter(folder, result.info, **options) as writer:
        for frame, tracks in zip(frames, result.tracks, strict=True):
            writer.add(frame, tracks)
        writer.finish(result)


def collect(frames: Sequence[Frame], result: Result) -> list[Sighting]:
    """The best views of each identity of a run."""
    collector = SightingCollector()
    for frame, tracks in zip(frames, result.tracks, strict=True):
        collector.add(frame.image, tracks)
    return collector.sightings
