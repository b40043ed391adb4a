"""The explanations of a run as the report page holds them: packed by blocks of frames.

A block is a JSON list of frames, compressed and base64-encoded; the page unpacks the block that it
needs. A frame holds `detections`, and what they share once: of REMIND `anchors`, `context`, `sets`.
"""

from __future__ import annotations

import base64
import dataclasses
import gzip
import json
from typing import Any

from remind_jax.explanation.plus.account import PlusExplainer, PlusExplanation
from remind_jax.explanation.remind.account import Explanation, ObjectSet
from remind_jax.explanation.remind.explain import Explainer
from remind_jax.outputs.result import Result
from remind_jax.tracks import Tracks

FRAMES_PER_BLOCK = 32
# Later frames are left to `remind explain`: browsers get slow with bigger pages.
MAX_EMBEDDED_BYTES = 10_000_000

_SHOWN_SETS = 5
_OF_FRAME = ("anchors", "context", "sets")
_TOLD_ELSEWHERE = ("format", "version", "frame", "time_s", "frame_name", *_OF_FRAME)


def pack_explanations(result: Result) -> dict[str, Any] | None:
    """Blocks for the page, as many as fit; None if the run holds no trace that it can show."""
    if not isinstance(result.explainer, (Explainer, PlusExplainer)):
        return None
    blocks, num_bytes = [], 0
    for start in range(0, len(result.tracks), FRAMES_PER_BLOCK):
        frames = result.tracks[start : start + FRAMES_PER_BLOCK]
        block = _pack([_explain_frame(result, tracks) for tracks in frames])
        num_bytes += len(block)
        if num_bytes > MAX_EMBEDDED_BYTES:
            break
        blocks.append(block)
    return {"frames_per_block": FRAMES_PER_BLOCK, "blocks": blocks}


def _explain_frame(result: Result, tracks: Tracks) -> dict[str, Any] | None:
    """What the page tells about the detections of a frame; None without any."""
    told = [result.explain(tracks.frame_index, row) for row in range(len(tracks))]
    if not told:
        return None
    return {**_share(told[0]), "detections": [_tell_own(one) for one in told]}


def _share(told: Explanation | PlusExplanation) -> dict[str, Any]:
    """What all detections of the frame have in common."""
    if isinstance(told, PlusExplanation):
        return {}
    whole = dataclasses.replace(told, sets=_distinct(told.sets)).to_json()
    return {name: whole[name] for name in _OF_FRAME}


def _tell_own(told: Explanation | PlusExplanation) -> dict[str, Any]:
    if isinstance(told, Explanation):
        told = dataclasses.replace(told, anchors=(), sets=())
    whole = told.to_json()
    return {name: whole[name] for name in whole if name not in _TOLD_ELSEWHERE}


def _distinct(sets: tuple[ObjectSet, ...]) -> tuple[ObjectSet, ...]:
    """The best sets of different objects."""
    best: dict[tuple[int, ...], ObjectSet] = {}
    for found in sets:
        best.setdefault(found.object_ids, found)
    return tuple(best.values())[:_SHOWN_SETS]


def _pack(content: Any) -> str:
    text = json.dumps(_shorten(content), ensure_ascii=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")


def _shorten(content: Any) -> Any:
    """Numbers with the three decimals that the page shows."""
    if isinstance(content, float):
        return round(content, 3)
    if isinstance(content, dict):
        return {name: _shorten(value) for name, value in content.items()}
    if isinstance(content, list):
        return [_shorten(value) for value in content]
    return content
