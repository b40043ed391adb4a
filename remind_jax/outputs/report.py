"""`report.html`: one page that shows a run and needs nothing else, neither files nor network.

All text of the run reaches the page as JSON and is set as text, never as HTML.
"""

from __future__ import annotations

import base64
import bisect
import dataclasses
import gzip
import html
import json
import re
from collections.abc import Mapping, Sequence
from importlib import resources
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from remind_jax import files
from remind_jax.decision import NO_ID, Outcome, Reason
from remind_jax.explanation.explanation import to_jsonable
from remind_jax.outputs.drawing import encode_jpeg, identity_color, to_hex
from remind_jax.outputs.gallery import Sighting
from remind_jax.outputs.overlay import OVERLAY_NAME, is_playable, shown_fps
from remind_jax.outputs.presence import ObjectHistory, Span, join_positions
from remind_jax.outputs.result import COMPARISON_HEADS, Result
from remind_jax.tracks import Tracks

REPORT_NAME = "report.html"
SCRIPT_NAME = "report_page.js"
# Larger videos stay beside the page: browsers get slow with bigger pages.
MAX_EMBEDDED_VIDEO_BYTES = 25_000_000

FRAMES_PER_BLOCK = 32
# Later frames are left to `remind explain`: browsers get slow with bigger pages.
MAX_EMBEDDED_BYTES = 10_000_000

_SHOWN_CANDIDATES = 3
_SLOT = re.compile(r"\{\{(\w+)\}\}")
_RUN_DATA = re.compile(r'<script type="application/json" id="run-data">(.*?)</script>', re.DOTALL)


def write_report(folder: Path, result: Result, sightings: Sequence[Sighting]) -> None:
    """Writes `report.html` into the folder of a run."""
    page = render_report(result, sightings, video_address(folder))
    files.replace_file(folder / REPORT_NAME, page.encode("utf-8"))


def render_report(result: Result, sightings: Sequence[Sighting], video: str | None) -> str:
    """The page as text; `video` is an address that the page can load, or None."""
    return render_page(result.info.name, report_data(result, sightings, video), (SCRIPT_NAME,))


def render_page(title: str, data: dict[str, Any], scripts: Sequence[str]) -> str:
    """A page of the template: its data, and scripts that lie beside this module."""
    parts = resources.files("remind_jax.outputs")
    slots = {
        "title": html.escape(title),
        "data": _to_script_json(data),
        "script": "\n".join(parts.joinpath(name).read_text(encoding="utf-8") for name in scripts),
    }
    template = parts.joinpath("report_template.html").read_text(encoding="utf-8")
    return _SLOT.sub(lambda match: slots[match[1]], template)


def report_data(result: Result, sightings: Sequence[Sighting], video: str | None) -> dict[str, Any]:
    """What the page draws. Positions count processed frames 0, 1, 2, ..."""
    info, summary = result.info, result.summary()
    position_of = {tracks.frame_index: place for place, tracks in enumerate(result.tracks)}
    class_of = {label: number for number, label in enumerate(result.class_names)}

    def places(spans: Sequence[Span]) -> list[Span]:
        return [(position_of[first], position_of[last]) for first, last in spans]

    return {
        "about": ", ".join(info.facts()),
        "complete": result.complete,
        "facts": _facts(summary),
        "footer": f"Made by remind-jax {info.versions['remind_jax']}.",
        "video": video,
        "explanations": pack_explanations(result),
        "fps": shown_fps(info.fps),
        "classes": list(class_of),
        "frames": [
            {
                "frame": tracks.frame_index,
                "time_s": round(float(tracks.time_s), 3),
                "name": tracks.name,
                "detections": [
                    _detection_data(tracks, row, class_of) for row in range(len(tracks))
                ],
            }
            for tracks in result.tracks
        ],
        "outcomes": [outcome.name.lower() for outcome in Outcome],
        "reasons": [reason.name.lower() for reason in Reason],
        "identities": [
            {
                "id": row.object_id,
                "label": row.label,
                "name": row.title,
                "color": to_hex(identity_color(row.object_id)),
                "seen": places(row.seen),
                "candidate": places(row.candidate),
                "absences": places(row.absences),
                "returns": [position_of[frame] for frame in row.returns],
                "decided": [
                    position_of.get(_frame_decided(result, row.object_id, position_of[frame]), -1)
                    for frame in row.returns
                ],
                "first": position_of[row.first_frame],
                "last": position_of[row.last_frame],
                "num_frames": row.num_frames,
                "sightings": [
                    _sighting_data(sighting) for sighting in _by_visit(sightings, row, position_of)
                ],
            }
            for row in sorted(result.objects(), key=lambda row: row.first_frame)
        ],
        "comparison": [COMPARISON_HEADS, *result.comparison] if result.comparison else [],
        "ambiguous": spans_with(result, Outcome.AMBIGUOUS),
        "provisional": spans_with(result, Outcome.PROVISIONAL_NEW, Outcome.PROVISIONAL_PARENT),
        "stages": [{"name": name, **times} for name, times in summary["ms_per_frame"].items()],
        "start_up": _start_up(result),
        "skipped": [{"name": frame.name, "reason": frame.reason} for frame in result.skipped],
        "events": [
            {
                "frame_index": event.frame_index,
                "position": position_of.get(event.frame_index),
                "kind": event.kind,
                "message": event.message,
            }
            for event in result.events
        ],
        "settings": {
            "Configuration": info.config,
            **({"Detector": info.detector} if info.detector else {}),
            "Source": info.source or {"source": "not kept; it cannot be opened again"},
            "Versions and device": info.versions | {"device": info.device},
        },
    }


def _by_visit(
    sightings: Sequence[Sighting], identity: ObjectHistory, position_of: Mapping[int, int]
) -> list[Sighting]:
    """Those of an identity, each in the visit that it shows by the final answers.

    They were collected as answers came; later ones may have changed where visits begin and end.
    """
    starts = [position_of[frame] for frame in (identity.first_frame, *identity.returns)]
    absent = [0, *(position_of[last] - position_of[first] + 1 for first, last in identity.absences)]
    seen = [range(position_of[first], position_of[last] + 1) for first, last in identity.seen]
    placed: dict[int, Sighting] = {}
    for one in sightings:
        is_there = any(one.picture_position in span for span in seen)
        if one.object_id == identity.object_id and is_there:
            visit = bisect.bisect(starts, one.picture_position) - 1
            shown = dataclasses.replace(one, position=starts[visit], absent_frames=absent[visit])
            placed.setdefault(visit, shown)
    return [placed[visit] for visit in sorted(placed)]


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
    explained = (result.explain(tracks.frame_index, row) for row in range(len(tracks)))
    detections = [
        {"name": one.name, "why": one.why, "sections": to_jsonable([*one.sections()])}
        for one in explained
    ]
    return {"detections": detections} if detections else None


def _pack(content: Any) -> str:
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"))
    return base64.b64encode(gzip.compress(text.encode("utf-8"), mtime=0)).decode("ascii")


def read_sightings(path: Path) -> list[Sighting]:
    """The crops that an earlier report holds; empty if there is none that can be read."""
    try:
        match = _RUN_DATA.search(files.read_text(path))
        run = json.loads(match[1]) if match else {"identities": []}
        return [
            Sighting(
                object_id=who["id"],
                label=who["label"],
                name="" if who["name"] == f"{who['label']} {who['id']}" else who["name"],
                position=crop["position"],
                absent_frames=crop["absent_frames"],
                picture_position=crop["picture_position"],
                image=_image_from_address(crop["image"]),
            )
            for who in run["identities"]
            for crop in who["sightings"]
        ]
    except (OSError, ValueError, KeyError, IndexError, TypeError, cv2.error):
        return []


def _facts(summary: dict[str, Any]) -> list[tuple[str, str]]:
    step = summary["ms_per_frame"].get("step")
    facts = [
        (str(summary["frames"]), "frames"),
        (str(summary["identities"]), "identities"),
        (str(summary["returns"]), "returns"),
        (str(summary["detections"]), "detections"),
        (f"{100 * summary['undecided_share']:.1f} %", "undecided"),
    ]
    return facts + ([(f"{step['median']:.1f} ms", "tracker step")] if step else [])


def _start_up(result: Result) -> str:
    parts = []
    if result.first_frame_ms is not None:
        parts.append(f"first frame after {result.first_frame_ms / 1000:.1f} s")
    if result.compile_s is not None:
        parts.append(f"{result.compile_s:.1f} s spent on compiling")
    return ", ".join(parts).capitalize()


def _frame_decided(result: Result, object_id: int, position: int) -> int:
    """The frame in which it was decided who returned.

    It is -1 if the run does not tell, or if a tracklet goes on that was decided before.
    """
    if result.explainer is None:
        return -1
    tracks = result.tracks[position]
    (row, *_) = np.flatnonzero(tracks.object_id == object_id)
    at = result.explain(tracks.frame_index, int(row)).decided_at
    return -1 if at is None or at < tracks.frame_index else at


def _detection_data(tracks: Tracks, row: int, class_of: Mapping[str, int]) -> list[Any]:
    """Id, name, outcome, reason, score, confidence, candidates, class; a list is small."""
    shown = np.flatnonzero(tracks.candidate_id[row] != NO_ID)[:_SHOWN_CANDIDATES]
    return [
        int(tracks.object_id[row]),
        tracks.display_name(row),
        int(tracks.outcome[row]),
        int(tracks.reason[row]),
        _short(tracks.shown_score(row)),
        _short(tracks.shown_confidence(row)),
        [
            [int(tracks.candidate_id[row, place]), _short(tracks.candidate_score[row, place])]
            for place in shown
        ],
        class_of[tracks.labels[row]],
    ]


def _short(value: float | None) -> float | None:
    return None if value is None or not np.isfinite(value) else round(float(value), 3)


def _sighting_data(sighting: Sighting) -> dict[str, Any]:
    encoded = base64.b64encode(encode_jpeg(sighting.image, 88)).decode("ascii")
    return {
        "position": sighting.position,
        "absent_frames": sighting.absent_frames,
        "picture_position": sighting.picture_position,
        "image": f"data:image/jpeg;base64,{encoded}",
    }


def _image_from_address(address: str) -> np.ndarray:
    jpeg = np.frombuffer(base64.b64decode(address.partition(",")[2]), np.uint8)
    image = cv2.imdecode(jpeg, cv2.IMREAD_COLOR)
    if image is None:
        raise ValueError("not an image")
    return cv2.cvtColor(image, cv2.COLOR_BGR2RGB)


def video_address(folder: Path) -> str | None:
    """The overlay video of a run itself as an address; its name if it is too large for the page.

    None if there is none that plays.
    """
    video = folder / OVERLAY_NAME
    if not is_playable(video):
        return None
    with files.writing(video):
        if video.stat().st_size > MAX_EMBEDDED_VIDEO_BYTES:
            return video.name
        return "data:video/mp4;base64," + base64.b64encode(video.read_bytes()).decode("ascii")


def _to_script_json(content: dict[str, Any]) -> str:
    """JSON that no text inside it can end early or turn into markup."""
    text = json.dumps(content, ensure_ascii=False, separators=(",", ":"), default=str)
    for character in "<>&\u2028\u2029":
        text = text.replace(character, f"\\u{ord(character):04x}")
    return text


def spans_with(result: Result, *outcomes: Outcome) -> tuple[Span, ...]:
    """Frames with at least one detection of these outcomes."""
    return join_positions(
        position
        for position, tracks in enumerate(result.tracks)
        if np.isin(tracks.outcome, outcomes).any()
    )
