"""A made-up run of up to three mugs per frame whose decisions are explained by a real trace."""

from __future__ import annotations

import dataclasses
import functools

import numpy as np

from remind_jax.config import Config
from remind_jax.decision import Outcome
from remind_jax.explanation.archive import FrameRecord, TraceArchive
from remind_jax.frame import Frame
from remind_jax.result import Result
from tests.explanation.scenes import backed, decide_frame
from tests.outputs.fake_run import make_info, make_tracks

SIZE = (120, 160)
UNDECIDED = 17  # frame in which detection 0 is mug 0 or mug 1
EMPTY = 5  # frame without a detection


@functools.cache
def _record(kind: str) -> FrameRecord:
    scores, around = {
        "clear": ([{0: 0.93, 1: 0.62}, {0: 0.60, 1: 0.92}], {"context": {0: backed(0.06)}}),
        "undecided": ([{0: 0.80, 1: 0.79}], {}),
        "empty": ([], {}),
    }[kind]
    record = decide_frame(scores, **around)
    track = np.where(record.decisions.outcome == Outcome.AMBIGUOUS, 0, -1)
    return dataclasses.replace(
        record, decisions=dataclasses.replace(record.decisions, pending_id=track)
    )


def make_traced_run(num_frames: int = 40) -> tuple[list[Frame], Result]:
    """Two mugs in every frame but for the two named ones."""
    rng = np.random.default_rng(1)
    archive, frames, tracks = TraceArchive(), [], []
    archive._labels = {0: "mug", 1: "mug"}
    for index in range(num_frames):
        kind = {UNDECIDED: "undecided", EMPTY: "empty"}.get(index, "clear")
        record = dataclasses.replace(_record(kind), frame_index=index)
        archive._frames[index] = record
        d, masks = record.decisions, np.zeros((len(record), *SIZE), bool)
        rows = []
        for row in range(len(record)):
            masks[row, 20 + index : 60 + index, 10 + 70 * row : 50 + 70 * row] = True
            options = zip(d.option_id[row].tolist(), d.option_score[row].tolist(), strict=True)
            rows.append(
                {
                    "label": "mug",
                    "outcome": Outcome(int(d.outcome[row])),
                    "reason": int(d.reason[row]),
                    "object_id": int(d.object_id[row]),
                    "pending_id": int(d.pending_id[row]),
                    "score": float(d.score[row]),
                    "candidates": [pair for pair in options if pair[0] >= 0],
                }
            )
        image = rng.integers(0, 255, (*SIZE, 3), np.uint8)
        frames.append(Frame(index, 2 * index, index / 10, f"{index:06d}.jpg", image))
        tracks.append(make_tracks(index, masks, rows))
    info = dataclasses.replace(make_info("mugs", SIZE), config=Config().to_dict())
    return frames, Result(tuple(tracks), info, trace=archive)
