"""Why REMIND plus took a detection for what it did: evidence in log odds, candidate by candidate.

Probabilities and confidences lie in [0, 1].
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator
from typing import cast

import numpy as np
from jaxtyping import Array, Float, Int

from remind_jax.decision import NO_ID, Decisions, Outcome, Reason
from remind_jax.explanation.archive import first_rows
from remind_jax.explanation.explainer import Explainer, Name, say_merged
from remind_jax.explanation.explanation import Explanation, Section, id_or_none, read_row
from remind_jax.numerics.pytree import pytree
from remind_jax.plus.answers import SMALL
from remind_jax.plus.evidence import Evidence
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.verdicts import Stage, Verdicts
from remind_jax.printing.words import change, compare, listing, number, plural, sentence
from remind_jax.tracks import Tracks

_NOTABLE = 0.25  # log odds; less is not mentioned


@dataclasses.dataclass(frozen=True)
class PlusCandidate:
    """A known object that the tracklet could have been."""

    object_id: int
    name: str
    log_odds: float  # sum of the parts
    probability: float  # beside all other candidates and a new object
    parts: dict[str, float]  # by kind of `evidence.Evidence`
    held_by: int | None  # other detection of the frame that was taken for it


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlusExplanation(Explanation):
    """Why one detection became what it became."""

    FORMAT = "remind-jax explanation of plus"

    id_without_delay: int | None  # the answer that was not revised by later frames
    confidence_without_delay: float | None
    stage: Stage  # how far the tracklet was decided before
    tracklet_id: int | None  # names the tracklet, and its object if that is new
    age: int  # detections of the tracklet, with this one
    is_decided: bool
    answer_id: int | None  # best answer, firm or not
    answer_name: str | None
    probability: float  # of the answer, before calibration
    margin: float | None  # log odds to the next best answer; None where nothing was open
    new_log_odds: float | None  # of being no known object; None where nothing was open
    new_probability: float | None
    candidates: tuple[PlusCandidate, ...]  # the most probable first

    def sections(self) -> Iterator[Section]:
        """The candidates, and a new object beside them."""
        if not self.candidates:
            return
        kinds = Evidence.kinds()
        rows = [
            (
                f"{'*' if c.object_id == self.answer_id else ' '} {c.name}",
                *(change(c.parts[part]) if c.parts[part] else "-" for part in c.parts),
                change(c.log_odds),
                number(c.probability),
                "" if c.held_by is None else f"detection {c.held_by} got it",
            )
            for c in self.candidates
        ]
        assert self.new_log_odds is not None
        assert self.new_probability is not None
        is_new = self.answer_id == self.tracklet_id
        called = self.answer_name if is_new else f"{self.label} {self.tracklet_id}"
        new = f"{'*' if is_new else ' '} {called}, new"
        blank = ["-"] * len(kinds)
        rows.append((new, *blank, change(self.new_log_odds), number(self.new_probability), ""))
        heads = ("candidate", *(kind.replace("_", " ") for kind in kinds), "sum", "probability", "")
        ends = (0, len(heads) - 1)
        yield Section("candidates, evidence in log odds", (), heads, tuple(rows), ends)


@pytree
class PlusRecord:
    """What the decisions of one frame were made of; NumPy arrays without padding rows."""

    verdicts: Verdicts
    object_id: Int[Array, "N"]  # without delay; -1 without a firm identity
    confidence: Float[Array, "N"]  # without delay

    def __len__(self) -> int:
        return len(self.object_id)


class PlusExplainer(Explainer[PlusRecord]):
    """Explains decisions of one run."""

    RECORD = PlusRecord

    @staticmethod
    def record(num: int, decisions: Decisions, trace: Verdicts) -> PlusRecord:
        """What is kept of a frame."""
        return first_rows(PlusRecord(trace, decisions.object_id, decisions.confidence), num)

    def _explain(self, record: PlusRecord, tracks: Tracks, row: int) -> PlusExplanation:
        v, label, name = record.verdicts, tracks.labels[row], self._namer(tracks, row)
        is_open = v.stage[row] == Stage.OPEN
        candidates = _candidates(v, row, name)
        answer_id = id_or_none(v.answer_id[row])
        known = sum(candidate.probability for candidate in candidates)
        confidence = tracks.shown_confidence(row)
        explanation = read_row(
            PlusExplanation,
            row,
            tracks,
            v,
            frame=tracks.frame_index,
            time_s=float(tracks.time_s),
            frame_name=tracks.name,
            detection=row,
            label=label,
            name=tracks.display_name(row),
            object_id=id_or_none(tracks.object_id[row]),
            decided_at=self._decided_at.get(int(v.tracklet_id[row])),
            confidence=confidence,
            id_without_delay=id_or_none(record.object_id[row]),
            confidence_without_delay=None if confidence is None else float(record.confidence[row]),
            tracklet_id=id_or_none(v.tracklet_id[row]),
            answer_id=answer_id,
            answer_name=None if answer_id is None else name(answer_id),
            margin=float(v.margin[row]) if is_open and candidates else None,
            new_log_odds=float(v.new_odds[row]) if is_open else None,
            new_probability=max(0.0, 1.0 - known) if is_open else None,
            candidates=candidates,
            why=(),
        )
        why = give_reasons(explanation, cast(PlusThresholds, self._config.thresholds))
        if explanation.reason == Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH:
            why = (*why, *say_merged(explanation.name, tracks, row))
        return dataclasses.replace(explanation, why=why)

    @functools.cached_property
    def _decided_at(self) -> dict[int, int]:
        """By tracklet, the frame in which it was decided; none of those decided before the run."""
        found: dict[int, int] = {}
        for frame, record in self._archive.frames():
            v = record.verdicts
            for row in np.flatnonzero(v.is_decided & (v.stage == Stage.OPEN)):
                found.setdefault(int(v.tracklet_id[row]), frame)
        return found


def _candidates(v: Verdicts, row: int, name: Name) -> tuple[PlusCandidate, ...]:
    found = []
    for place in np.argsort(-v.option_belief[row], kind="stable"):
        object_id = int(v.option_id[row, place])
        if object_id == NO_ID:
            continue
        others = [int(k) for k in np.flatnonzero(v.answer_id == object_id) if k != row]
        found.append(
            PlusCandidate(
                object_id=object_id,
                name=name(object_id),
                log_odds=float(v.option_odds[row, place]),
                probability=float(v.option_belief[row, place]),
                parts={k: float(getattr(v.evidence, k)[row, place]) for k in Evidence.kinds()},
                held_by=others[0] if others else None,
            )
        )
    return tuple(found)


def give_reasons(e: PlusExplanation, t: PlusThresholds) -> tuple[str, ...]:
    """The sentences of an explanation that has none yet."""
    return tuple(sentence(text) for text in _explain(e, t))


def _explain(e: PlusExplanation, t: PlusThresholds) -> Iterator[str]:
    """The same without capital and full stop."""
    if e.stage == Stage.NONE:
        yield (
            "another detection shows the same thing, so it is left out"
            if e.reason == Reason.DOUBLE
            else "it shows too little of anything to be described and is left out"
        )
        return
    if e.stage == Stage.SETTLED:
        yield (
            f"it goes on with a tracklet of {plural(e.age, 'detection')} that was decided "
            f"{'before' if e.decided_at is None else f'in frame {e.decided_at}'}: {_answer(e)}"
        )
    else:
        yield (
            "it goes on with no tracklet of the frames before: the first detection of one"
            if e.age == 1
            else f"it is detection {e.age} of a tracklet that is not decided yet"
        )
        yield from _explain_candidates(e)
        yield from _explain_new(e, t)
        yield from _explain_taken(e)
        yield _explain_verdict(e, t)
    if e.is_decided and e.id_without_delay is None:
        yield "since then it passed to another thing more likely than not: no answer is firm"
    yield from _explain_revision(e)


def _explain_candidates(e: PlusExplanation) -> Iterator[str]:
    """The evidence for and against the two best."""
    if not e.candidates:
        yield f"no known {e.label} is free to be it"
        return
    for place, candidate in enumerate(e.candidates[:2]):
        lead = "the likeliest of the known is" if place == 0 else "next comes"
        yield (
            f"{lead} {candidate.name}, log odds {change(candidate.log_odds)}, probability "
            f"{number(candidate.probability)}: {_weigh(candidate)}"
        )
        if candidate.parts["moved"] > _NOTABLE:
            against = candidate.parts["place"] + candidate.parts["layout"]
            counted = change(against + candidate.parts["moved"])
            yield (
                f"where it lies, by itself and from the others, is evidence against "
                f"{candidate.name}: {change(against)}, of which {counted} count, as it may have "
                "been moved"
            )


def _weigh(candidate: PlusCandidate) -> str:
    """The notable kinds of evidence, strongest first."""
    parts = [
        (kind.replace("_", " "), value)
        for kind, value in candidate.parts.items()
        if kind != "moved" and abs(value) >= _NOTABLE
    ]
    parts.sort(key=lambda part: -abs(part[1]))
    pro = listing([f"{kind} {change(value)}" for kind, value in parts if value > 0])
    con = listing([f"{kind} {change(value)}" for kind, value in parts if value < 0])
    sides = [f"{pro} for it"] if pro else []
    sides += [f"{con} against it"] if con else []
    return ", ".join(sides) or "no evidence is strong"


def _explain_new(e: PlusExplanation, t: PlusThresholds) -> Iterator[str]:
    if e.new_log_odds is None:
        return
    d = t.decision
    handicap = d.tentative if e.age < d.commit_age else 0.0
    off = e.new_log_odds - d.new + handicap
    why = ""
    if abs(off) >= _NOTABLE:
        why = f"; {change(off)} of it because of what came last, or is in view"
        why += " or cut off by the border" if off < 0 else ""
    if handicap >= _NOTABLE:
        why += f"; {change(-handicap)} because it is not decided yet"
    yield f"a new object has log odds {change(e.new_log_odds)}{why}"


def _explain_taken(e: PlusExplanation) -> Iterator[str]:
    """A better candidate that another detection got."""
    for candidate in e.candidates:
        if candidate.object_id == e.answer_id:
            return
        better = e.new_log_odds is None or candidate.log_odds > e.new_log_odds
        if candidate.held_by is not None and better:
            yield (
                f"{candidate.name} goes to detection {candidate.held_by}: one assignment gives "
                "each object to one detection"
            )


def _explain_verdict(e: PlusExplanation, t: PlusThresholds) -> str:
    d = t.decision
    # There are two numbers for one answer: what the evidence says, and how often answers of which
    # it says so are right.
    sure = f"probability {number(e.probability)}"
    if e.confidence_without_delay is not None:
        sure = f"confidence {number(e.confidence_without_delay)}, calibrated from {sure}"
    if e.is_decided and e.age >= d.commit_age:
        return f"after {e.age} detections it is decided: {_answer(e)}; {sure}"
    if e.is_decided:
        margin = "" if e.margin is None else f" ({compare(e.margin, '>', d.early_margin)} log odds)"
        return f"the lead is clear{margin}, so it is decided: {_answer(e)}; {sure}"
    waits = "not decided yet"
    if e.age >= d.commit_age:
        waits = "no answer leads clearly, so it is not decided yet"
    if e.id_without_delay is not None:
        return f"{waits}, and more likely than not {_answer(e)}; {sure}"
    possible = [c for c in e.candidates if c.probability >= d.possible]
    options = [f"{c.name} ({number(c.probability)})" for c in possible]
    new = f"new ({number(e.new_probability or 0.0)})"
    firm = number(d.firm)
    if e.answer_id == e.tracklet_id:
        firm += f", a new object of a size under {number(SMALL)} from {number(d.firm_small)}"
    return (
        f"{waits} and no answer is likely enough ({sure}; firm from {firm}): "
        f"{listing([*options, new], 'or')}"
    )


def _explain_revision(e: PlusExplanation) -> Iterator[str]:
    """When it was decided, if not yet, and what a delay changed."""
    now, then = (
        None if sure is None else number(sure)
        for sure in (e.confidence, e.confidence_without_delay)
    )
    if e.decided_at is not None and e.decided_at > e.frame:
        yield f"its tracklet was decided in frame {e.decided_at}"
    if e.object_id in (None, e.id_without_delay):
        if now != then:
            yield f"by what later frames tell, the confidence is {now}"
        return
    if e.id_without_delay is not None and e.is_decided:  # no later frame changes what is decided
        yield f"{e.answer_name} was merged into {e.name}"
        return
    before = "no firm answer" if e.id_without_delay is None else e.answer_name
    yield f"later frames changed the answer: {e.name}, with confidence {now}, instead of {before}"


def _answer(e: PlusExplanation) -> str:
    is_new = e.answer_id == e.tracklet_id and e.outcome == Outcome.NEW
    return f"{'a new object, ' if is_new else ''}{e.answer_name}"
