"""The explanation as data and as text."""

import dataclasses
import json

import numpy as np
import pytest

from remind_jax.decision import Outcome
from remind_jax.errors import OutputError
from remind_jax.explanation.explanation import id_or_none, lay_out, render_frame
from remind_jax.explanation.remind.explanation import Candidate, RemindExplanation
from remind_jax.remind.association.gating import Gate
from remind_jax.session.answers import as_merged
from tests.outputs.fake_run import make_run
from tests.outputs.traced_run import EMPTY, UNDECIDED, make_traced_run


@pytest.fixture(scope="module")
def result():
    return make_traced_run(20)[1]


def test_a_match_by_its_numbers(result):
    explanation = result.explain(3, 0)
    assert (explanation.name, explanation.outcome, explanation.object_id) == (
        "mug 0",
        Outcome.MATCH,
        0,
    )
    assert (explanation.assigned_id, explanation.guarded_id, explanation.pending) == (0, 0, None)
    best, other = explanation.candidates
    assert best.visual_score == pytest.approx(0.93)
    assert best.terms["object"].score == pytest.approx(0.93)
    assert best.terms["object"].weight == pytest.approx(0.60)  # perfect quality
    assert best.terms["parts"].score is None
    assert (best.gate, best.backed, best.held_by) == (Gate.PASS_MATCH_THR, True, None)
    assert (best.bonus, best.bonus_raw) == (0.0, pytest.approx(0.06))  # strong without it
    assert other.held_by == 1
    assert [(a.detection, a.object_id) for a in explanation.anchors] == [(0, 0), (1, 1)]


def test_an_undecided_one_by_its_options(result):
    explanation = result.explain(UNDECIDED, 0)
    assert (explanation.name, explanation.object_id) == ("mug 0 or 1?", None)
    assert explanation.pending is not None
    assert (explanation.pending.kind, explanation.pending.track_id) == ("ambiguous", 0)
    assert [option.object_id for option in explanation.pending.options] == [0, 1]
    (known, again) = explanation.known_sets
    assert known.status.name == "NOT_CLOSED"
    assert known.options == again.options


def test_of_merged_objects_it_says_what_the_run_says(result):
    both = as_merged(dataclasses.replace(result.tracks[3], names={0: "my mug"}), {1: 0})
    merged = dataclasses.replace(result, tracks=(both,))
    has_id, lost = np.argsort(both.object_id == -1).tolist()
    for row in (has_id, lost):
        told = merged.explain(3, row)
        said = (told.outcome, told.reason, told.object_id, told.name)
        object_id = id_or_none(both.object_id[row])
        assert said == (both.outcome[row], both.reason[row], object_id, both.display_name(row))
    assert told.object_id is None
    assert told.why[-1] == (
        f"Its object and that of detection {has_id} were merged into my mug, and detection "
        f"{has_id} is the better match."
    )


def test_json_has_the_documented_keys(result):
    content = json.loads(json.dumps(result.explain(UNDECIDED, 0).to_json()))
    assert content["format"] == RemindExplanation.FORMAT
    fields = [field.name for field in dataclasses.fields(RemindExplanation)]
    assert list(content) == ["format", "version", *fields]
    candidate = content["candidates"][0]
    assert list(candidate) == [field.name for field in dataclasses.fields(Candidate)]
    assert list(candidate["terms"]) == ["object", "background", "parts"]
    assert candidate["gate"] == "pass_match_thr"
    assert content["outcome"] == "ambiguous"


def test_the_page_fits_a_terminal(result):
    explanation = result.explain(UNDECIDED, 0)
    page = explanation.to_text(80)
    assert max(map(len, page.splitlines())) <= 80
    # Only where lines break differs, and that the first column comes again.
    assert set(explanation.to_text().split()) == set(page.split())


def test_text_has_every_part(result):
    text = str(result.explain(UNDECIDED, 0))
    assert text.startswith(
        f"frame {UNDECIDED} (1.70 s, {2 * UNDECIDED:06d}.jpg), detection 0: mug 0 or 1?"
    )
    for part in ("why\n  1. Of 2 objects", "candidates (2 of 2)", "0.80 x 0.60", "anchors: none"):
        assert part in text
    assert "ambiguous track 0: could be mug 0 (0.80) or mug 1" in text
    assert "* mug 0" in str(result.explain(3, 0))  # what it became is marked
    assert "nan" not in text
    assert all(line == line.rstrip() for line in text.splitlines())


def test_a_frame_is_listed_to_choose_from(result):
    lines = render_frame(result.tracks[3]).splitlines()
    assert lines[0] == "frame 3 (0.30 s, 000006.jpg)"
    assert lines[2].split() == ["0", "mug", "0", "match", "0.93", "0.80"]
    assert render_frame(result.tracks[EMPTY]).endswith("nothing was detected")


@pytest.mark.parametrize(
    ("frame", "detection", "message"),
    [
        (20, 0, "the run has no frame 20; it has frames 0 to 19"),
        (-1, 0, "the run has no frame -1; it has frames 0 to 19"),
        ("3", 0, "the run has no frame '3'; it has frames 0 to 19"),
        (3, "0", "frame 3 has no detection '0'; it has detections 0 to 1"),
        (3, 2, "frame 3 has no detection 2; it has detections 0 to 1"),
        (3, -1, "frame 3 has no detection -1; it has detections 0 to 1"),
        (UNDECIDED, 1, f"frame {UNDECIDED} has no detection 1; it has detection 0 only"),
        (EMPTY, 0, f"frame {EMPTY} has no detection 0; nothing was detected in it"),
    ],
)
def test_what_is_not_there_is_named(result, frame, detection, message):
    with pytest.raises(OutputError) as raised:
        result.explain(frame, detection)
    assert str(raised.value) == message


def test_a_trace_of_another_run_is_noticed(result):
    other = dataclasses.replace(result, tracks=make_run(4)[1].tracks)
    with pytest.raises(OutputError, match="does not fit frame 0"):
        other.explain(0, 0)


def test_columns():
    assert lay_out((("a", "long"), ("bb", "1")), (0,)) == ["  a   long", "  bb     1"]
