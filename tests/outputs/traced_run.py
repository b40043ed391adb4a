"""A made-up run of up to three mugs per frame whose decisions are explained by a real trace."""

import dataclasses
import functools
from typing import Any

import jax
import numpy as np

from remind_jax.config import Config, load_config
from remind_jax.decision import Outcome
from remind_jax.explanation.archive import TraceArchive
from remind_jax.explanation.plus import PlusRecord
from remind_jax.explanation.remind.explainer import FrameRecord
from remind_jax.frame import Frame
from remind_jax.outputs.result import Result
from remind_jax.plus.verdicts import Stage, Verdicts, no_verdicts
from tests.explanation.scenes import decide_frame
from tests.outputs.fake_run import make_info, make_tracks
from tests.remind.association.tables import backed

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
    archive, frames, tracks = TraceArchive("remind", FrameRecord), [], []
    for index in range(num_frames):
        kind = {UNDECIDED: "undecided", EMPTY: "empty"}.get(index, "clear")
        record = _record(kind)
        archive.add(index, record, {0: "mug", 1: "mug"})
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


def make_plus_run(num_frames: int = 8, back_at: int = 99) -> Result:
    """Mug 0 as REMIND plus recognises it: settled, but for frame 3, where mug 1 is likely, too.

    In the five frames before `back_at` it is nobody; two frames after it, it is decided again.
    """
    archive, tracks = TraceArchive("plus", PlusRecord), []
    masks = np.zeros((1, *SIZE), bool)
    masks[:, 20:60, 10:50] = True
    for index in range(num_frames):
        blank: dict[str, Any] = vars(jax.tree.map(np.array, no_verdicts(1)))
        tracklet = 5 if index < back_at else 6
        shown = blank | {"tracklet_id": np.array([tracklet]), "answer_id": np.array([0])}
        if index == 3:
            shown |= {"stage": np.array([Stage.OPEN]), "age": np.array([2])}
            shown |= {"new_odds": np.array([0.5], np.float32)}
            parts = {0: {"looks": 1.5, "layout": 0.75}, 1: {"looks": 1.25, "place": -2.0}}
            for place, (object_id, evidence) in enumerate(parts.items()):
                shown["option_id"][0, place] = object_id
                shown["option_odds"][0, place] = sum(evidence.values())
                shown["option_belief"][0, place] = (0.75, 0.125)[place]
                for kind, value in evidence.items():
                    getattr(shown["evidence"], kind)[0, place] = value
        else:
            stage = Stage.OPEN if back_at <= index <= back_at + 2 else Stage.SETTLED
            is_decided = not back_at <= index < back_at + 2
            shown |= {"stage": np.array([stage]), "is_decided": np.array([is_decided])}
        row = {"label": "mug", "outcome": Outcome.MATCH, "object_id": 0}
        if back_at - 5 <= index < back_at:
            row |= {"outcome": Outcome.AMBIGUOUS, "object_id": -1}
        row |= {"score": 0.75, "confidence": 0.75}  # plus has one number
        tracks.append(make_tracks(index, masks, [row]))
        record = PlusRecord(Verdicts(**shown), tracks[-1].object_id, tracks[-1].confidence)
        archive.add(index, record, {0: "mug", 1: "mug"})
    info = dataclasses.replace(make_info("mugs", SIZE), config=load_config("plus").to_dict())
    return Result(tuple(tracks), info, trace=archive)
