"""Frames given as tables of visual scores, decided by the real rules, with their trace.

One class `mug`; only the object channel is seen and its weight is 1, so a score is the visual one.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from types import SimpleNamespace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.decision import Outcome
from remind_jax.explanation.archive import TraceArchive
from remind_jax.explanation.remind.explainer import FrameRecord, RemindExplainer
from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.remind.association.diagnosis import find_anchors
from remind_jax.remind.association.quality import Quality
from remind_jax.remind.association.similarity import Comparison, Terms
from remind_jax.remind.context.hypotheses import no_hypotheses
from remind_jax.remind.context.influence import find_supported, no_influence
from remind_jax.remind.context.reasoning import Reasoning
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.state import init
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import collect_trace
from remind_jax.remind.tracker import DescribedFrame, decide_pairs
from tests.outputs.fake_run import make_tracks
from tests.remind.association.tables import unrelated
from tests.statics import make_static

NUM, SLOTS = 3, 4
STATIC = make_static(num_detections=NUM, num_objects=SLOTS, num_pending=1, feature_dim=2)
CONTEXT = ("bonus_raw", "support", "score_sets", "compat_rel", "kernel_raw", "compat_band")
OTHER = 0.30  # score of pairs that are not given

Known = Mapping[int, float]


def backed(bonus: float) -> dict[str, Any]:
    """What context says of an object that it clearly supports."""
    values = dict.fromkeys(CONTEXT, 0.5)
    return {**values, "bonus_raw": bonus, "compat_band": True}


def decide_frame(
    rows: Sequence[Known],
    *,
    context: Mapping[int, Mapping[str, Any]] | None = None,
    lifecycle: Lifecycle = Lifecycle.CONFIRMED,
    vetoes: Mapping[tuple[int, int], int] | None = None,
) -> FrameRecord:
    """Decides a frame in which each detection has the given scores for known objects."""
    score = np.full((NUM, SLOTS), OTHER, np.float32)
    for row, known in enumerate(rows):
        for slot, value in known.items():
            score[row, slot] = value
    num_objects = 1 + max((slot for known in rows for slot in known), default=-1)
    said = {name: np.zeros(SLOTS, bool if "band" in name else np.float32) for name in CONTEXT}
    for slot, values in (context or {}).items():
        for name, value in values.items():
            said[name][slot] = value
    veto = np.zeros((NUM, SLOTS), np.int32)
    for pair, code in (vetoes or {}).items():
        veto[pair] = code
    numbers = len(rows), num_objects, int(lifecycle), context is not None
    decisions, trace = jax.device_get(_decide(score, said, veto, *map(jnp.int32, numbers)))
    return FrameRecord.of_step(len(rows), decisions, trace)


def explain(record: FrameRecord, row: int) -> RemindExplanation:
    """The explanation of a detection of this frame, in which no mask was seen."""
    archive = TraceArchive("remind", FrameRecord)
    archive.add(0, record, {int(i): "mug" for i in record.detections.candidates.id.ravel()})
    d = record.decisions
    rows = [
        {"label": "mug", "outcome": Outcome(int(d.outcome[i])), "object_id": int(d.object_id[i])}
        for i in range(len(record))
    ]
    tracks = make_tracks(0, np.ones((len(record), 2, 2), bool), rows)
    explanation = RemindExplainer(archive, [tracks], {}).explain(0, row)
    assert isinstance(explanation, RemindExplanation)
    return explanation


def chain(record: FrameRecord, row: int) -> list[str]:
    """The reasons of a detection; new objects and tracks have no number without a memory."""
    return list(explain(record, row).why)


@functools.partial(jax.jit)
def _decide(score, said, veto, num, num_objects, lifecycle, has_context):
    t = Thresholds().as_arrays(STATIC.scalar)
    state = init(STATIC)
    exists = jnp.arange(SLOTS) < num_objects
    objects = dataclasses.replace(
        state.objects,
        id=jnp.where(exists, jnp.arange(SLOTS), -1),
        class_id=jnp.where(exists, 0, -1),
        lifecycle=jnp.full(SLOTS, lifecycle),
        age=jnp.full(SLOTS, 50),
    )
    state = dataclasses.replace(state, objects=objects, next_id=num_objects)
    valid = jnp.arange(NUM) < num
    candidate = valid[:, None] & exists[None]
    value = jnp.zeros((3, NUM, SLOTS)).at[0].set(jnp.where(candidate, score, 0.0))
    present = jnp.zeros((3, NUM, SLOTS), bool).at[0].set(True)
    terms = Terms(value, present, jnp.ones((NUM, SLOTS)))
    comparison = Comparison(
        candidate=candidate,
        score=value[0],
        terms=terms,
        auto=terms,
        neutral=terms,
        neutral_weights=jnp.ones((3, NUM, 1)),
        pending_score=jnp.zeros((NUM, 1)),
    )
    descriptors: Any = SimpleNamespace(
        valid=valid,
        class_id=jnp.where(valid, 0, -1),
        num_bad_patches=jnp.int32(0),
        patch_sum=jnp.full(NUM, 40.0),
    )
    masks: Any = SimpleNamespace(valid=valid, detector_score=valid)
    anchors = find_anchors(comparison.score, candidate, t.diagnosis)
    on = has_context > 0
    felt = dataclasses.replace(
        no_influence(SLOTS, STATIC.scalar), **said, enabled=on, global_ok=on, quality=0.7 * on
    )
    reasoning = Reasoning(
        felt, candidate & (veto == 0), find_supported(felt, t), veto,
        no_hypotheses(NUM, SLOTS, STATIC),
    )  # fmt: skip
    ones = jnp.ones(NUM)
    decisions, made_of = decide_pairs(
        state, DescribedFrame(descriptors, masks), Quality(ones, ones, ones, ones, ones),
        unrelated(NUM, STATIC.scalar), comparison, anchors, reasoning, STATIC, t,
    )  # fmt: skip
    new = decisions.outcome == Outcome.NEW
    decisions = dataclasses.replace(
        decisions, object_id=jnp.where(new, num_objects, decisions.object_id)
    )
    return decisions, collect_trace(made_of, STATIC, t)
