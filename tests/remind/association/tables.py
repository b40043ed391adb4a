"""One frame as a table of channel scores, and what the association decides about it.

Everything between the channel scores and the decisions runs as in `remind_jax.remind.tracker.step`;
perception, graphs and memory do not. All frames of `decide_frames` share one compiled program.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.decision import Decisions
from remind_jax.remind.association import similarity
from remind_jax.remind.association.assignment import Assignment
from remind_jax.remind.association.channel_scores import ChannelScores, Score
from remind_jax.remind.association.diagnosis import find_anchors
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import Comparison
from remind_jax.remind.context.hypotheses import no_hypotheses
from remind_jax.remind.context.influence import find_supported, no_influence
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.outcome import Intermediates
from remind_jax.remind.perception.relations import Relations
from remind_jax.remind.stages import Stages
from remind_jax.remind.state import init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.tracker import DescribedFrame, decide_pairs
from remind_jax.static import Static
from tests.statics import change_parts, make_static

NUM, SLOTS, PENDING = 5, 8, 1  # detections, objects, undecided tracks
BATCH = 64  # frames that are decided at once
STATIC = make_static(
    num_detections=NUM,
    num_objects=SLOTS,
    num_pending=PENDING,
    feature_dim=2,
    num_candidates=SLOTS,
    precision="float64",
    solver="host",  # quicker to compile
)
CONTEXT = ("bonus_raw", "score_sets", "support", "compat_rel", "compat_band", "kernel_raw")


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Frame:
    """Detections fill the first rows, objects the first slots; an object's id is its slot."""

    class_id: Any  # [N], -1 in padding
    object_class: Any  # [O], -1 in free slots
    lifecycle: Any  # [O]
    age: Any  # [O]
    channels: ChannelScores  # columns: O objects, P undecided tracks
    quality: Quality
    plausible: Any  # [N, O], not vetoed
    context: Any  # name -> [O], or of the frame
    influences: Any  # context may change scores


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Verdict:
    """What is decided about a frame, and on what grounds."""

    decided: Decisions
    stages: Stages
    comparison: Comparison
    assignment: Assignment
    anchors: Any  # [N, O]

    @property
    def decisions(self) -> Any:
        """What was decided, and in what stages."""
        return SimpleNamespace(**vars(self.decided), **vars(self.stages))


def empty_frame(num: int, num_objects: int) -> Frame:
    """One class, confirmed objects, no channel seen, perfect quality, no context."""
    rows, slots = np.arange(NUM) < num, np.arange(SLOTS) < num_objects

    def absent(channels: int) -> Score:
        shape = (2, channels, NUM, SLOTS + PENDING)
        return Score(np.zeros(shape), np.zeros(shape, bool))

    authority = np.ones((2, 2, NUM, SLOTS + PENDING))
    return Frame(
        class_id=np.where(rows, 0, -1).astype(np.int32),
        object_class=np.where(slots, 0, -1).astype(np.int32),
        lifecycle=np.full(SLOTS, Lifecycle.CONFIRMED, np.int32),
        age=np.full(SLOTS, 50, np.int32),
        channels=ChannelScores(absent(2), authority, absent(2), absent(1)),
        quality=Quality(*(np.ones(NUM) for _ in dataclasses.fields(Quality))),
        plausible=np.ones((NUM, SLOTS), bool),
        context={name: np.zeros(SLOTS, bool if "band" in name else float) for name in CONTEXT},
        influences=np.bool_(True),
    )


def visual_frame(
    rows: Sequence[Mapping[int, float]],
    *,
    lifecycle: Lifecycle = Lifecycle.CONFIRMED,
    age: int = 50,
    context: Mapping[int, Mapping[str, Any]] | None = None,
    other: float = 0.30,
) -> Frame:
    """A frame of one class where only the object term is seen, so that it is the visual score.

    `rows` gives the scores of each detection by object; pairs that it leaves out score `other`.
    """
    num_objects = 1 + max((slot for row in rows for slot in row), default=-1)
    frame = empty_frame(len(rows), num_objects)
    value = np.full((NUM, SLOTS + PENDING), other)
    for n, row in enumerate(rows):
        for slot, score in row.items():
            value[n, slot] = score
    seen = np.zeros((2, 2, NUM, SLOTS + PENDING), bool)
    seen[0, 0, :, :num_objects] = True  # the first channel, in the work bank
    score = Score(np.where(seen, value, 0.0), seen)
    values = {name: column.copy() for name, column in frame.context.items()}
    for slot, said in (context or {}).items():
        for name, number in said.items():
            values[name][slot] = number
    return dataclasses.replace(
        frame,
        channels=dataclasses.replace(frame.channels, objects=score),
        lifecycle=np.full(SLOTS, lifecycle, np.int32),
        age=np.full(SLOTS, age, np.int32),
        context=values,
    )


def backed(bonus: float) -> dict[str, Any]:
    """Context that clearly speaks for an object (method.md#example-frames)."""
    return {
        "support": 0.5, "score_sets": 0.5, "compat_band": True, "compat_rel": 0.9,
        "kernel_raw": 0.2, "bonus_raw": bonus,
    }  # fmt: skip


def decide_frames(frames: Sequence[Frame], thresholds: Sequence[Thresholds] = ()) -> Verdict:
    """Verdicts of all frames on the host, with a leading axis.

    `thresholds` are those of each frame, the published ones if left out.
    """
    thresholds = thresholds or [Thresholds()] * len(frames)
    lacking = -len(frames) % BATCH
    rows = list(zip(frames, thresholds, strict=True))
    rows += [(empty_frame(0, 0), Thresholds())] * lacking
    stack = lambda *leaves: np.stack(leaves)  # noqa: E731
    verdicts = [
        jax.device_get(_decide_batch(*jax.tree.map(stack, *rows[start : start + BATCH])))
        for start in range(0, len(rows), BATCH)
    ]
    return jax.tree.map(lambda *leaves: np.concatenate(leaves)[: len(frames)], *verdicts)


@jax.jit
@jax.vmap
def _decide_batch(frame: Frame, thresholds: Thresholds) -> Verdict:
    t = change_parts(thresholds.as_arrays(STATIC.scalar), influence={"enabled": frame.influences})
    decisions, made_of = decide_one(frame, STATIC, t)
    comparison, anchors = made_of.table.comparison, made_of.anchors
    return Verdict(decisions, made_of.stages, comparison, made_of.assignment, anchors)


def decide_one(
    frame: Frame, static: Static, t: Thresholds, veto: Any = 0
) -> tuple[Decisions, Intermediates]:
    """Decides a frame; `veto` `[N, O]` says why pairs are ruled out that are."""
    state = init(static)
    exists, valid = frame.object_class >= 0, frame.class_id >= 0
    objects = dataclasses.replace(
        state.objects,
        id=jnp.where(exists, jnp.arange(SLOTS, dtype=jnp.int32), -1),
        class_id=frame.object_class,
        lifecycle=frame.lifecycle,
        age=frame.age,
    )
    state = dataclasses.replace(state, objects=objects, next_id=jnp.sum(exists, dtype=jnp.int32))
    descriptors: Any = SimpleNamespace(
        valid=valid,
        class_id=frame.class_id,
        num_bad_patches=jnp.int32(0),
        patch_sum=jnp.full(NUM, 40.0),
    )
    masks: Any = SimpleNamespace(valid=valid, detector_score=valid)
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(similarity, "compare_channels", lambda *_: frame.channels)
        comparison = similarity.compare(state, descriptors, frame.quality, static, t)
    anchors = find_anchors(comparison.score, comparison.candidate, t.diagnosis)
    felt = dataclasses.replace(no_influence(SLOTS, static.scalar), **frame.context)
    vetoes = jnp.broadcast_to(jnp.int32(veto), (NUM, SLOTS))
    plausible = comparison.candidate & frame.plausible & (vetoes == 0)
    sets = no_hypotheses(NUM, SLOTS, static)
    reasoning = Reasoning(felt, plausible, find_supported(felt, t), vetoes, sets)
    relations = unrelated(NUM, static.scalar)
    seen = DescribedFrame(descriptors, masks)
    return decide_pairs(
        state, seen, frame.quality, relations, comparison, anchors, reasoning, static, t
    )


def unrelated(num: int, scalar: Any) -> Relations:
    """Detections of which nothing is known of how they lie."""
    apart, never = jnp.zeros((num, num), scalar), jnp.zeros((num, num), bool)
    return Relations(apart, apart, apart.astype(jnp.int32), apart, never, apart, never, never)
