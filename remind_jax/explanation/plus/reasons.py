"""The decision about one detection in sentences, in the order in which it was made."""

from __future__ import annotations

from collections.abc import Iterator

from remind_jax.decision import Outcome, Reason
from remind_jax.explanation.plus.explanation import PlusCandidate, PlusExplanation
from remind_jax.plus.answers import SMALL
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.verdicts import Stage
from remind_jax.printing.words import change, compare, listing, number, plural, sentence

_NOTABLE = 0.25  # log odds; less is not mentioned


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
        yield _explain_stage(e)
        yield from _explain_candidates(e, t)
        yield from _explain_new(e, t)
        yield from _explain_taken(e)
        yield _explain_verdict(e, t)
    if e.is_decided and e.id_without_delay is None:
        yield "since then it passed to another thing more likely than not: no answer is firm"
    yield from _explain_revision(e)


def _explain_stage(e: PlusExplanation) -> str:
    if e.age == 1:
        return "it goes on with no tracklet of the frames before: the first detection of one"
    return f"it is detection {e.age} of a tracklet that is not decided yet"


def _explain_candidates(e: PlusExplanation, t: PlusThresholds) -> Iterator[str]:
    """The evidence for and against the two best."""
    if not e.candidates:
        yield f"no known {e.label} is free to be it"
        return
    for place, candidate in enumerate(e.candidates[:2]):
        lead = "most likely" if place == 0 else "next comes"
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
    parts = [(k, v) for k, v in candidate.parts.items() if k != "moved" and abs(v) >= _NOTABLE]
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
    if e.confidence is not None:
        sure = f"confidence {number(e.confidence)}, calibrated from {sure}"
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
    if e.decided_at is not None and e.decided_at > e.frame:
        yield f"its tracklet was decided in frame {e.decided_at}"
    if e.object_id is not None and e.object_id != e.id_without_delay:
        before = (
            "no firm answer" if e.id_without_delay is None else f"{e.label} {e.id_without_delay}"
        )
        yield f"later frames changed the answer: {e.label} {e.object_id} instead of {before}"


def _answer(e: PlusExplanation) -> str:
    is_new = e.answer_id == e.tracklet_id and e.outcome == Outcome.NEW
    named = (one.name for one in e.candidates if one.object_id == e.answer_id)
    name = next(named, f"{e.label} {e.answer_id}")
    return f"{'a new object, ' if is_new else ''}{name}"
