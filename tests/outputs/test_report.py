import base64
import dataclasses
import gzip
import json
import re
from collections.abc import Callable
from html.parser import HTMLParser
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from remind_jax.frame import SkippedFrame
from remind_jax.outputs import report
from remind_jax.outputs.result import Result
from remind_jax.outputs.run_records import Event
from remind_jax.outputs.writer import TRACE_NAME
from tests.outputs.fake_run import collect, make_info, make_run, make_tracks, write_run
from tests.outputs.traced_run import make_plus_run, make_traced_run

HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)> {{data}} \u2028 & '\""


def data_of(page: str) -> dict:
    (text,) = re.findall(r'<script type="application/json" id="run-data">(.*?)</script>', page)
    return json.loads(text)


class Tags(HTMLParser):
    """Collects the tags of a page and the addresses that it would load."""

    def __init__(self) -> None:
        super().__init__()
        self.tags: list[str] = []
        self.addresses: list[str] = []

    def handle_starttag(self, tag, attrs):
        self.tags.append(tag)
        self.addresses += [str(value) for name, value in attrs if name in ("src", "href")]


def test_hostile_text_stays_text():
    tracks = make_tracks(0, np.ones((1, 8, 8), bool), [{"object_id": 0, "label": HOSTILE}])
    info = dataclasses.replace(
        make_info(name=HOSTILE),
        config={"tracker": "iou", HOSTILE: HOSTILE},
        backbone=HOSTILE,
        device=HOSTILE,
    )
    result = Result(
        (dataclasses.replace(tracks, name=HOSTILE),),
        info,
        skipped=(SkippedFrame(HOSTILE, HOSTILE),),
        events=(Event(0, HOSTILE, HOSTILE),),
    )
    page = report.render_report(result, [], None)
    plain = Tags()
    plain.feed(report.render_report(Result((), make_info()), [], None))
    found = Tags()
    found.feed(page)
    assert found.tags == plain.tags  # the same elements, whatever the text says
    data = data_of(page)
    assert data["identities"][0]["label"] == HOSTILE
    assert data["settings"]["Configuration"] == {"tracker": "iou", HOSTILE: HOSTILE}


def test_page_is_filled_in_whole_and_loads_nothing_from_elsewhere():
    _, result = make_run(4)
    page = report.render_report(result, [], None)
    found = Tags()
    found.feed(page)
    assert all(address.startswith("data:") for address in found.addresses)
    assert not any(text in page for text in ("http:", "https:", "url(", "{{"))
    assert data_of(page)["frames"][2]["name"] == "000004.jpg"


def test_numbers_that_are_not_finite_become_null():
    tracks = make_tracks(0, np.ones((1, 8, 8), bool), [{"object_id": 0, "score": float("nan")}])
    page = report.render_report(Result((tracks,), make_info()), [], None)
    assert data_of(page)["frames"][0]["detections"][0][4] is None


def test_crops_can_be_read_back(tmp_path):
    frames, result = make_run(40)
    sightings = collect(frames, result)
    report.write_report(tmp_path, result, sightings)
    read = report.read_sightings(tmp_path / "report.html")
    assert len(read) == len(sightings)
    ours = {(s.object_id, s.position): s for s in read}
    for sighting in sightings:
        mine = ours[sighting.object_id, sighting.position]
        assert vars(mine) | {"image": None} == vars(sighting) | {"image": None}
        # JPEG changes noise and sharp outlines, but not the picture.
        assert np.abs(mine.image.astype(int) - sighting.image).mean() < 12


def test_crops_are_shown_in_the_visits_of_the_final_answers(tmp_path):
    """They were collected as answers came; one shows what is another object in the end."""
    frames, result = make_run(40)
    sightings = collect(frames, result)
    early = [dataclasses.replace(one, position=39, absent_frames=0) for one in sightings]
    back = next(one for one in sightings if one.absent_frames)
    wrong = dataclasses.replace(back, picture_position=back.position - 1)
    report.write_report(tmp_path, result, [wrong, *early])
    shown = {(s.object_id, s.position, s.absent_frames) for s in sightings}
    read = report.read_sightings(tmp_path / "report.html")
    assert {(s.object_id, s.position, s.absent_frames) for s in read} == shown
    assert len(read) == len(sightings)


@pytest.mark.parametrize(
    "content",
    [None, "", "<html></html>", '<script type="application/json" id="run-data">{</script>'],
)
def test_a_report_without_crops_gives_none(tmp_path, content):
    path = tmp_path / "report.html"
    if content is not None:
        path.write_text(content)
    assert report.read_sightings(path) == []


def test_large_videos_stay_beside_the_page(tmp_path, monkeypatch):
    (tmp_path / "overlay.mp4").write_bytes(b"1234")
    monkeypatch.setattr(report, "is_playable", Path.is_file)
    _, result = make_run(2)
    report.write_report(tmp_path, result, [])
    page = tmp_path / "report.html"
    assert data_of(page.read_text())["video"] == "data:video/mp4;base64,MTIzNA=="
    monkeypatch.setattr(report, "MAX_EMBEDDED_VIDEO_BYTES", 3)
    report.write_report(tmp_path, result, [])
    assert data_of(page.read_text())["video"] == "overlay.mp4"


def unpack(packed: dict[str, Any]) -> list[Any]:
    blocks = [json.loads(gzip.decompress(base64.b64decode(text))) for text in packed["blocks"]]
    assert all(len(block) == packed["frames_per_block"] for block in blocks[:-1])
    return [frame for block in blocks for frame in block]


@pytest.mark.parametrize("make", [lambda: make_traced_run()[1], make_plus_run])
def test_every_detection_is_explained_as_in_python(make: Callable[[], Result]):
    result = make()
    frames = unpack(report.pack_explanations(result))
    assert len(frames) == len(result)
    for tracks, frame in zip(result.tracks, frames, strict=True):
        explained = [result.explain(tracks.frame_index, row) for row in range(len(tracks))]
        shown = [] if frame is None else frame["detections"]
        assert [one["why"] for one in shown] == [list(one.why) for one in explained]
        assert [one["name"] for one in shown] == [one.name for one in explained]
        sections = [[section["title"] for section in one["sections"]] for one in shown]
        assert sections == [[section.title for section in one.sections()] for one in explained]
    (candidates, *_) = frames[3]["detections"][0]["sections"]
    assert candidates["title"].startswith("candidates")
    assert [row[0] for row in candidates["rows"]][:2] == ["* mug 0", "  mug 1"]


def test_a_long_run_is_explained_as_far_as_the_page_can_hold(monkeypatch):
    _, result = make_traced_run()
    monkeypatch.setattr(report, "FRAMES_PER_BLOCK", 8)
    whole = report.pack_explanations(result)
    room = sum(len(block) for block in whole["blocks"][:2])
    monkeypatch.setattr(report, "MAX_EMBEDDED_BYTES", room)
    assert report.pack_explanations(result)["blocks"] == whole["blocks"][:2]


def test_a_run_without_trace_has_no_explanations():
    _, result = make_run(4)
    assert report.report_data(result, [], None)["explanations"] is None


def test_a_folder_keeps_the_trace_of_its_own_run_only(tmp_path):
    frames, result = make_traced_run(4)
    for made, has_trace in ((result, True), (dataclasses.replace(result, trace=None), False)):
        write_run(tmp_path, frames, made, overlay=False, overwrite=True)
        assert (tmp_path / TRACE_NAME).exists() == has_trace
        assert (Result.load(tmp_path).explainer is not None) == has_trace
