"""What the report page holds of the explanations."""

from __future__ import annotations

import base64
import dataclasses
import gzip
import json
from typing import Any

from remind_jax.explanation.remind.explanation import RemindExplanation
from remind_jax.outputs import explanations, report
from remind_jax.outputs.explanations import pack_explanations
from remind_jax.outputs.result import Result
from remind_jax.outputs.writer import TRACE_NAME, RunWriter
from tests.outputs.fake_run import make_run
from tests.outputs.traced_run import EMPTY, UNDECIDED, make_plus_run, make_traced_run


def pack(result: Result) -> dict[str, Any]:
    packed = pack_explanations(result)
    assert packed is not None
    return packed


def unpack(packed: dict[str, Any]) -> list[Any]:
    blocks = [json.loads(gzip.decompress(base64.b64decode(text))) for text in packed["blocks"]]
    assert all(len(block) == packed["frames_per_block"] for block in blocks[:-1])
    return [frame for block in blocks for frame in block]


def test_every_detection_is_explained_as_in_python():
    _, result = make_traced_run()
    frames = unpack(pack(result))
    assert len(frames) == len(result)
    for tracks, frame in zip(result.tracks, frames, strict=True):
        if not len(tracks):
            assert frame is None
            continue
        told = [result.explain(tracks.frame_index, row) for row in range(len(tracks))]
        assert [one["why"] for one in frame["detections"]] == [list(one.why) for one in told]
        assert [one["name"] for one in frame["detections"]] == [one.name for one in told]
        first = told[0]
        assert isinstance(first, RemindExplanation)
        assert len(frame["anchors"]) == len(first.anchors)
        best = first.candidates[0]
        shown = frame["detections"][0]["candidates"][0]
        assert (shown["object_id"], shown["gate"]) == (best.object_id, best.gate.name.lower())
        assert abs(shown["visual_score"] - best.visual_score) <= 5e-4
    assert not len(result.tracks[EMPTY])
    assert frames[UNDECIDED]["detections"][0]["pending"]["kind"] == "ambiguous"


def test_runs_of_plus_are_explained_too():
    result = make_plus_run()
    frames = unpack(pack(result))
    for tracks, frame in zip(result.tracks, frames, strict=True):
        told = result.explain(tracks.frame_index, 0).to_json()
        (shown,) = frame["detections"]
        assert (shown["why"], shown["stage"]) == (told["why"], told["stage"])
        assert shown["candidates"] == told["candidates"]  # with three decimals or fewer
    assert len(frames[3]["detections"][0]["candidates"]) == 2


def test_a_long_run_is_explained_as_far_as_the_page_can_hold(monkeypatch):
    _, result = make_traced_run()
    monkeypatch.setattr(explanations, "FRAMES_PER_BLOCK", 8)
    whole = pack(result)
    room = sum(len(block) for block in whole["blocks"][:2])
    monkeypatch.setattr(explanations, "MAX_EMBEDDED_BYTES", room)
    assert pack(result)["blocks"] == whole["blocks"][:2]


def test_same_run_same_bytes():
    _, result = make_traced_run(8)
    assert pack_explanations(result) == pack_explanations(result)


def test_a_run_without_trace_has_no_explanations():
    _, result = make_run(4)
    assert report.report_data(result, [], None)["explanations"] is None


def test_a_folder_keeps_the_trace_of_its_own_run_only(tmp_path):
    frames, result = make_traced_run(4)
    for made, has_trace in ((result, True), (dataclasses.replace(result, trace=None), False)):
        with RunWriter(tmp_path, made.info, overlay=False, overwrite=True) as writer:
            for frame, tracks in zip(frames, made.tracks, strict=True):
                writer.add(frame, tracks)
            writer.finish(made)
        assert (tmp_path / TRACE_NAME).exists() == has_trace
        assert (Result.load(tmp_path).explainer is not None) == has_trace
