"""Frames given as tables of visual scores, decided by the real rules, with their trace.

One class `mug`; a score is the visual one.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.decision import Outcome
from remind_jax.explanation.archive import TraceArchive
from remind_jax.explanation.remind.explainer import FrameRecord, RemindExplainer
from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.thresholds import Thresholds
from remind_jax.remind.trace import collect_trace
from tests.outputs.fake_run import make_tracks
from tests.remind.association import tables
from tests.statics import change_static

STATIC = change_static(tables.STATIC, precision="float32")


def decide_frame(
    rows: Sequence[Mapping[int, float]],
    *,
    context: Mapping[int, Mapping[str, Any]] | None = None,
    lifecycle: Lifecycle = Lifecycle.CONFIRMED,
    vetoes: Mapping[tuple[int, int], int] | None = None,
) -> FrameRecord:
    """Decides a frame in which each detection has the given scores for known objects."""
    frame = tables.visual_frame(rows, lifecycle=lifecycle, context=context)
    is_on = np.bool_(context is not None)
    of_frame = {"enabled": is_on, "global_ok": is_on, "quality": np.float32(0.7 * is_on)}
    frame = dataclasses.replace(frame, context=frame.context | of_frame)
    veto = np.zeros((tables.NUM, tables.SLOTS), np.int32)
    for pair, code in (vetoes or {}).items():
        veto[pair] = code
    decisions, trace = jax.device_get(_decide(frame, veto))
    return FrameRecord.of_step(len(rows), decisions, trace)


def explain(record: FrameRecord, row: int) -> RemindExplanation:
    """The explanation of a detection of this frame, in which no mask was seen."""
    archive = TraceArchive("remind", FrameRecord)
    archive.add(0, record, {int(i): "mug" for i in record.detections.candidates.id.ravel()})
    d = record.decisions
    rows = [
        {name: int(getattr(d, name)[i]) for name in ("outcome", "reason", "object_id")}
        | {"label": "mug"}
        for i in range(len(record))
    ]
    tracks = make_tracks(0, np.ones((len(record), 2, 2), bool), rows)
    explanation = RemindExplainer(archive, [tracks], {}).explain(0, row)
    assert isinstance(explanation, RemindExplanation)
    return explanation


def chain(record: FrameRecord, row: int) -> list[str]:
    """The reasons of a detection; new objects and tracks have no number without a memory."""
    return list(explain(record, row).why)


@jax.jit
def _decide(frame, veto):
    t = Thresholds().as_arrays(STATIC.scalar)
    decisions, made_of = tables.decide_one(frame, STATIC, t, veto)
    new, num_objects = decisions.outcome == Outcome.NEW, made_of.state.next_id
    decisions = dataclasses.replace(
        decisions, object_id=jnp.where(new, num_objects, decisions.object_id)
    )
    return decisions, collect_trace(made_of, STATIC, t)
