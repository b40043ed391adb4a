"""Why REMIND plus decided as it did: evidence that adds up, and sentences that fit the answer."""

import copy
import dataclasses
import json

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.cli.main import main
from remind_jax.decision import NO_ID, Outcome
from remind_jax.explanation.explainer import new_archive
from remind_jax.explanation.plus import give_reasons
from remind_jax.method import get_method
from remind_jax.plus.evidence import Evidence
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.verdicts import Stage
from remind_jax.session.answers import as_merged
from tests.plus.test_method import pan_frames


@pytest.fixture(scope="module")
def result() -> rj.Result:
    return rj.run(pan_frames(), config="plus", trace=True)


@pytest.fixture(scope="module")
def explained(result):
    return [
        result.explain(tracks.frame_index, row)
        for tracks in result.tracks
        for row in range(len(tracks))
    ]


def test_evidence_adds_up_to_the_log_odds(explained):
    candidates = [candidate for one in explained for candidate in one.candidates]
    assert candidates
    for candidate in candidates:
        assert tuple(candidate.parts) == Evidence.kinds()
        # Sums of seven numbers below 100 in 32 bits.
        assert sum(candidate.parts.values()) == pytest.approx(candidate.log_odds, abs=1e-3)


def test_candidates_are_called_by_their_own_class(result):
    archive = result.trace.renumbered(lambda ids: {one: one for one in ids})
    archive._labels = dict.fromkeys(archive.labels, "lamp")
    explainer = type(result.explainer)(archive, result.tracks, result.info.config)
    told = [explainer.explain(tracks.frame_index, 0) for tracks in result.tracks[-3:]]
    assert all(one.answer_name == f"lamp {one.answer_id}" for one in told)
    names = {c.name for one in told for c in one.candidates}
    assert all(name.startswith("lamp ") for name in names)


def test_probabilities_of_open_tracklets_add_up_to_one(explained):
    for one in explained:
        if one.new_probability is None:
            continue
        total = one.new_probability + sum(c.probability for c in one.candidates)
        assert total == pytest.approx(1.0, abs=1e-5)  # at most nine numbers in 32 bits


def test_every_stage_is_explained_and_fits_the_answer(explained):
    assert {one.stage for one in explained} == {Stage.OPEN, Stage.SETTLED}
    for one in explained:
        text = " ".join(one.why)
        assert str(one.answer_id) in text or one.object_id is None
        assert ("that was decided in frame" in text) == (one.stage == Stage.SETTLED)
        if one.stage == Stage.OPEN:
            assert ("not decided yet and" in text.lower()) == (one.object_id is None)


def test_that_an_answer_waits_because_none_leads_is_told(explained):
    early = next(one for one in explained if one.stage == Stage.OPEN and not one.is_decided)
    for age in (7, 8):
        told = give_reasons(dataclasses.replace(early, age=age), PlusThresholds())
        assert any("No answer leads clearly" in text for text in told) == (age == 8)


def test_evidence_is_called_as_in_the_table(explained):
    one = next(one for one in explained if one.candidates)
    other = dataclasses.replace(one.candidates[0], parts={"class_name": -3.5, "moved": 0.0})
    told = give_reasons(dataclasses.replace(one, candidates=(other,)), PlusThresholds())
    assert any("class name -3.50 against it" in text for text in told)


def test_what_passed_to_another_thing_is_told(explained):
    decided = next(one for one in explained if one.stage == Stage.SETTLED)
    assert not any("passed to another thing" in text for text in decided.why)
    doubtful = dataclasses.replace(decided, id_without_delay=None)
    told = give_reasons(doubtful, PlusThresholds())
    assert any("passed to another thing" in text for text in told)


def test_the_frame_in_which_a_tracklet_was_decided_is_named(explained):
    by_tracklet: dict[int, list] = {}
    for one in explained:
        by_tracklet.setdefault(one.tracklet_id, []).append(one)
    for views in by_tracklet.values():
        decided = [one.frame for one in views if one.is_decided]
        expected = (decided[:1] or [None])[0]
        assert {one.decided_at for one in views} == {expected}
        for one in views:
            waits = expected is not None and one.frame < expected
            assert (f"Its tracklet was decided in frame {expected}." in one.why) == waits


def test_what_an_earlier_session_decided_has_no_frame(result, explained):
    late = explained[-1].frame
    archive = new_archive(get_method("plus"))
    archive.add(late, dict(result.trace.frames())[late], {})
    rest = dataclasses.replace(result, tracks=result.tracks[-1:], trace=archive)
    settled = [one for one in explained if (one.frame, one.stage) == (late, Stage.SETTLED)]
    assert settled
    for one in settled:
        again = rest.explain(late, one.detection)
        assert again.decided_at is None
        assert "that was decided before: " in again.why[0]


def test_names_that_people_gave_are_told(result, explained):
    one = next(one for one in explained if one.stage == Stage.SETTLED)
    place = [tracks.frame_index for tracks in result.tracks].index(one.frame)
    tracks = dataclasses.replace(result.tracks[place], names={one.answer_id: "my mug"})
    named = dataclasses.replace(result, tracks=(tracks,)).explain(one.frame, one.detection)
    assert named.why[0].endswith("my mug.")
    new = next(one for one in explained if one.candidates and one.answer_id == one.tracklet_id)
    place = [tracks.frame_index for tracks in result.tracks].index(new.frame)
    tracks = dataclasses.replace(result.tracks[place], names={new.answer_id: "my mug"})
    named = dataclasses.replace(result, tracks=(tracks,)).explain(new.frame, new.detection)
    assert "* my mug, new " in str(named)


def test_what_people_merged_is_told(result):
    tracks = result.tracks[-1]
    kept, gone, *others = tracks.object_id.tolist()
    named = dataclasses.replace(tracks, names={kept: "my mug"})
    both = as_merged(named, {gone: kept})
    held, lost = (0, 1) if both.object_id[1] == NO_ID else (1, 0)
    told = dataclasses.replace(result, tracks=(both,)).explain(tracks.frame_index, lost)
    assert told.why[-1] == (
        f"Its object and that of detection {held} were merged into my mug, and detection {held} "
        "is the better match."
    )
    alone = dataclasses.replace(named, object_id=np.array([NO_ID, gone, *others]))
    merged = dataclasses.replace(result, tracks=(as_merged(alone, {gone: kept}),))
    told = merged.explain(tracks.frame_index, 1)
    assert told.why[-1] == f"Square {gone} was merged into my mug."


def test_a_recognized_square_names_the_evidence_for_it(explained):
    back = [
        one
        for one in explained
        if one.stage == Stage.OPEN and one.is_decided and one.outcome == Outcome.MATCH
        if one.answer_id != one.tracklet_id
    ]
    assert back
    for one in back:
        best = next(c for c in one.candidates if c.object_id == one.answer_id)
        strongest = max(best.parts, key=lambda part: best.parts[part])
        line = next(text for text in one.why if best.name in text.lower())
        assert f"{strongest} {best.parts[strongest]:+.2f}" in line
        assert best.name in one.to_text()


def test_saved_runs_explain_the_same(result, explained, tmp_path, capsys, monkeypatch):
    result.save(tmp_path)
    again = rj.Result.load(tmp_path)
    one = next(one for one in explained if one.candidates)
    assert again.explain(one.frame, one.detection) == one
    place = ["explain", str(tmp_path), "--frame", str(one.frame), "--detection", str(one.detection)]
    monkeypatch.setenv("COLUMNS", "400")
    assert main(place) == 0
    assert capsys.readouterr().out.strip() == one.to_text().strip()
    assert main([*place, "--json"]) == 0
    read = json.loads(capsys.readouterr().out)
    assert read["format"] == "remind-jax explanation of plus"
    assert read["stage"] == one.stage.name.lower()
    assert set(read["candidates"][0]["parts"]) == set(Evidence.kinds())


def test_a_run_with_settings_that_are_gone_is_explained(result, explained):
    config = copy.deepcopy(result.info.config)
    config["thresholds"]["linking"]["slack"] = 0.12
    config["thresholds"]["confidence"] = {"known": 0.0113}
    info = dataclasses.replace(result.info, config=config)
    one = explained[0]
    before = dataclasses.replace(result, info=info)
    assert before.explain(one.frame, one.detection) == one


def test_what_a_delay_revised_is_explained(result):
    first = result.tracks[0]
    changed = dataclasses.replace(first, object_id=first.object_id + 50)
    late = dataclasses.replace(result, tracks=(changed, *result.tracks[1:]))
    for row in range(len(first)):
        was, now = first.object_id[row], changed.object_id[row]
        why = late.explain(first.frame_index, row).why
        said = f"Later frames changed the answer: square {now}, with confidence "
        assert why[-1].startswith(said)
        assert why[-1].endswith(f" instead of square {was}.")


def test_the_confidence_of_a_frame_is_not_that_of_a_later_one(result):
    """The first answers of a run were less sure than they are once their tracklets are decided."""
    one = result.explain(result.tracks[0].frame_index, 0)
    then, now = one.confidence_without_delay, one.confidence
    assert then < now == result.tracks[0].confidence[0]
    assert one.why[-1] == f"By what later frames tell, the confidence is {now:.2f}."
    assert any(f"confidence {then:.2f}, calibrated from" in sentence for sentence in one.why)
    last = result.explain(result.tracks[-1].frame_index, 0)
    assert last.confidence_without_delay == last.confidence
    assert not any("later frames" in sentence for sentence in last.why)
