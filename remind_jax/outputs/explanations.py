"""The explanations of a run as the report page holds them: packed by blocks of frames.

A block is a JSON list of frames, compressed and base64-encoded; the page unpacks the block that it
needs. A frame holds `detections`, and once what they have in common (`Explanation.OF_FRAME`).
"""

from __future__ import annotations

import base64
import gzip
import json
from typing import Any

from remind_jax.outputs.result import Result
from remind_jax.tracks import Tracks

FRAMES_PER_BLOCK = 32
# Later frames are left to `remind explain`: browsers get slow with bigger pages.
MAX_EMBEDDED_BYTES = 10_000_000

# What the page has elsewhere.
_LEFT_OUT = ("format", "version", "frame", "time_s", "frame_name")


def pack_explanations(result: Result) -> dict[str, Any] | None:
    """Blocks for the page, as many as fit; None if the run holds no trace."""
    if result.explainer is None:
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
    """What the page says about the detections of a frame; None without any."""
    shared: dict[str, Any] = {}
    own = []
    for row in range(len(tracks)):
        explanation = result.explain(tracks.frame_index, row).shortened()
        whole = explanation.to_json()
        shared = {name: whole[name] for name in explanation.OF_FRAME}
        own.append({k: v for k, v in whole.items() if k not in (*_LEFT_OUT, *shared)})
    return {**shared, "detections": own} if own else None


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
