"""The examples of docs/method.md, and what settings change of them."""

import itertools
from collections.abc import Mapping
from typing import Any

import numpy as np
import pytest

from remind_jax.decision import Outcome, Reason, Status
from remind_jax.remind.memory.objects import Lifecycle
from remind_jax.remind.thresholds import Thresholds
from tests.remind.association.tables import Verdict, backed, decide_frames, visual_frame
from tests.statics import change_parts

MATCH, NEW, AMBIGUOUS = Outcome.MATCH, Outcome.NEW, Outcome.AMBIGUOUS
PARENT, PROVISIONAL = Outcome.PROVISIONAL_PARENT, Outcome.PROVISIONAL_NEW
STABILITY = Reason.KNOWN_BUT_AMBIGUOUS_IDENTITY_STABILITY
COMPETITION = Reason.KNOWN_AND_COMMITTED_NEW_COMPETITION

Known = dict[int, float]


def one(outcome: Outcome, known: Known | None = None, **more: Any) -> dict[str, Any]:
    """What is expected of one detection; `known` gives the objects named, in order, with scores."""
    return {"outcome": outcome, "known": known or {}, **more}


def match(slot: int, score: float | None = None, **more: Any) -> dict[str, Any]:
    return one(MATCH, object=slot, **({} if score is None else {"score": score}), **more)


INACTIVE: dict[str, Any] = {"lifecycle": Lifecycle.INACTIVE}
VISUAL = Reason.KNOWN_BUT_AMBIGUOUS_VISUAL_MATCH

# Number in method.md#example-frames: visual scores per detection, surroundings, what is expected.
EXAMPLES: dict[str, tuple[list[Known], dict[str, Any], list[dict[str, Any]]]] = {
    "1": ([{0: 0.78}], {}, [match(0, 0.78, status=Status.AMBIGUOUS, confidence=0.253500)]),
    "2": ([{0: 0.91}], {}, [match(0, 0.91, status=Status.STRONG, confidence=0.345042)]),
    "3": ([{0: 0.91, 1: 0.74}], {}, [match(0, status=Status.STRONG, confidence=0.192452)]),
    "4": (
        [{0: 0.91, 1: 0.85}],
        {},
        [one(AMBIGUOUS, {0: 0.91, 1: 0.85}, status=Status.AMBIGUOUS, reason=VISUAL)],
    ),
    "5": ([{0: 0.80, 1: 0.73}], {}, [one(AMBIGUOUS, {0: 0.80, 1: 0.73})]),
    "6": ([{0: 0.80, 1: 0.7195}], {}, [match(0, status=Status.STRONG)]),
    "7": (
        [{0: 0.80, 1: 0.79, 2: 0.775}],
        {},
        [one(AMBIGUOUS, {0: 0.80, 1: 0.79, 2: 0.775})],
    ),
    "8": ([{0: 0.88, 1: 0.70}, {0: 0.72, 1: 0.86}], {}, [match(0), match(1)]),
    "9": (
        [{0: 0.88, 1: 0.80}, {0: 0.87, 1: 0.76}],
        {},
        [
            one(AMBIGUOUS, {0: 0.88, 1: 0.80}, reason=STABILITY, assigned=1),
            one(AMBIGUOUS, {0: 0.87, 1: 0.76}, reason=STABILITY, assigned=0),
        ],
    ),
    "10": (
        [{0: 0.80, 1: 0.79}, {0: 0.78, 1: 0.78}],
        {},
        [
            one(AMBIGUOUS, {0: 0.80, 1: 0.79}, reason=STABILITY),
            one(AMBIGUOUS, {1: 0.78, 0: 0.78}, reason=STABILITY),
        ],
    ),
    "11": (
        [{0: 0.93}, {0: 0.90}],
        {},
        [one(AMBIGUOUS, {0: 0.93, 1: 0.93}, reason=COMPETITION, score=0.93)] * 2,
    ),
    "12": (
        [{0: 0.93}, {0: 0.90}],
        {"lifecycle": Lifecycle.TENTATIVE, "age": 3},
        [match(0), one(NEW)],
    ),
    "13": (
        [{0: 0.95}, {0: 0.91}],
        {},
        [one(AMBIGUOUS, {0: 0.95, 1: 0.95}, reason=COMPETITION)] * 2,
    ),
    "14": ([{0: 0.89}, {0: 0.85}], {}, [match(0), one(NEW)]),
    "15": ([{0: 0.93}, {0: 0.91}, {0: 0.90}], {}, [match(0), one(NEW), one(NEW)]),
    "16": ([{0: 0.80}, {0: 0.80}], INACTIVE, [match(0), one(NEW)]),
    "17": (
        [{0: 0.80, 1: 0.79}, {0: 0.79}, {1: 0.95}],
        INACTIVE,
        [one(NEW), match(0), match(1)],
    ),
    "18": ([{0: 0.74, 1: 0.50}], {}, [one(PARENT, {0: 0.74}, reason=Reason.UNCERTAIN_PARENT)]),
    "19a": ([{0: 0.73}], {}, [one(NEW)]),
    "19b": ([{0: 0.7301}], {}, [one(PARENT, {0: 0.7301})]),
    "20": (
        [{0: 0.95}, {0: 0.74}],
        {},
        [match(0), one(PROVISIONAL, {0: 0.74}, reason=Reason.UNCERTAIN_KNOWN_BLOCKED, blocked=1)],
    ),
    "21": ([{0: 0.50}], {}, [one(NEW, score=0.0)]),
    "22": (
        [{0: 0.66, 1: 0.55}],
        {"context": {0: backed(0.10)}},
        [match(0, 0.76, status_final=Status.AMBIGUOUS)],
    ),
    "23": (
        [{0: 0.78}],
        {"context": {0: {"bonus_raw": -0.05, "score_sets": -1.0}}},
        [one(NEW)],
    ),
    "24": (
        [{0: 0.64, 1: 0.30}],
        {"context": {0: backed(0.05)}},
        [one(PARENT, {0: 0.69}, score=0.69)],
    ),
    "25": (
        [{0: 0.95}, {0: 0.70}],
        {"context": {0: backed(0.05)}},
        [match(0, 0.95), one(PROVISIONAL, {0: 0.75}, score=0.75, blocked=1)],
    ),
    "26": (
        [{0: 0.84, 1: 0.78}],
        {"context": {1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.84, 1: 0.83}, reason=VISUAL)],
    ),
    "27": ([{0: 0.92, 1: 0.76}], {"context": {1: backed(0.05)}}, [match(0)]),
    "28": (
        [{0: 0.66, 1: 0.65}],
        {"context": {0: backed(0.05), 1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.71, 1: 0.70}, reason=Reason.KNOWN_BUT_AMBIGUOUS, assigned=-1)],
    ),
    "29": (
        [{0: 0.71, 1: 0.70}],
        {"context": {0: backed(0.05), 1: backed(0.05)}},
        [one(AMBIGUOUS, {0: 0.76, 1: 0.75}, reason=Reason.KNOWN_BUT_AMBIGUOUS_MATCH, assigned=0)],
    ),
    "30": (
        [{0: 0.95, 1: 0.30}, {0: 0.80, 1: 0.66}],
        {"context": {0: backed(0.05), 1: backed(0.05)}, **INACTIVE},
        [
            match(0),
            one(
                AMBIGUOUS,
                {0: 0.85, 1: 0.71},
                reason=Reason.KNOWN_BUT_AMBIGUOUS_CONTEXTUAL_FALLBACK,
            ),
        ],
    ),
    "31": (
        [{0: 0.95, 1: 0.20}, {0: 0.85, 1: 0.70}],
        {"context": {1: backed(0.08)}},
        [match(0), match(1, 0.78, status=Status.STRONG)],
    ),
}


Changes = dict[str, dict[str, Any]]
GUARDS = ("ambiguous", "competition", "provisional", "known_sets")


def without(*groups: str, **changed: dict[str, Any]) -> Changes:
    """Thresholds with some guards switched off, and others changed."""
    return {**{name: {"enabled": False} for name in groups}, **changed}


def context(**bonus: float) -> dict[str, Any]:
    """Objects that the context speaks for, called `o0` and so on."""
    return {"context": {int(name[1:]): backed(value) for name, value in bonus.items()}}


def ambiguous(row: Known, expected: dict[str, Any], around: Any = None, **changed: Any) -> Any:
    return [row], around or {}, without("provisional", ambiguous=changed), [expected]


def competing(scores: tuple[float, float], competes: bool, life: Any = None, **changed: Any) -> Any:
    """Two detections of one object: both may be it or a new one, or the second one is new."""
    best = scores[0]
    both = [one(AMBIGUOUS, {0: best, 1: best}, reason=COMPETITION)] * 2
    lifecycle, age = life or (Lifecycle.CONFIRMED, 50)
    around = {"lifecycle": lifecycle, "age": age}
    expected = both if competes else [match(0), one(NEW)]
    return [{0: score} for score in scores], around, {"competition": changed}, expected


def provisional(row: Known, expected: dict[str, Any], around: Any = None, **changed: Any) -> Any:
    return [row], around or {}, without("ambiguous", provisional=changed), [expected]


def beside_a_taken_support(most: int, known: Known) -> Any:
    """More objects are named: at least one more, up to the limit."""
    rows = [{0: 0.97, 1: 0.1, 2: 0.1}, {0: 0.80, 1: 0.64, 2: 0.63}]
    around = context(o0=0.02, o1=0.02, o2=0.02)
    changed = without("ambiguous", provisional={"max_support": most})
    return rows, around, changed, [match(0), one(AMBIGUOUS, known)]


def rescued(margin: float, expected: list[int]) -> Any:
    """Detection 0 fits better what 1 was rescued onto (method.md#gating-fragile)."""
    rows = [{0: 0.80, 1: 0.77}, {0: 0.30, 1: 0.705}]
    changed = without(*GUARDS, stability={"alternative_margin": margin})
    told = [
        one(NEW if slot < 0 else MATCH, assigned=n, guarded=slot) for n, slot in enumerate(expected)
    ]
    return rows, context(o1=0.05), changed, told


PAIR, NEAR, THREE = (0.93, 0.90), {0: 0.80, 1: 0.73}, {0: 0.80, 1: 0.79, 2: 0.775}
MISSED, YOUNG = {0: 0.74, 1: 0.50}, Lifecycle.TENTATIVE
UNBACKED = {"visual_fallback": False, "supported_only": False}
CLOSE = {"visual_min_gap": 0.0}
# Rules: method.md#ambiguity, method.md#competition, method.md#provisional,
# method.md#identity-stability.
VARIANTS = [
    ambiguous({0: 0.80, 1: 0.79, 2: 0.785, 3: 0.775}, one(AMBIGUOUS, {0: 0.8, 1: 0.79, 2: 0.785})),
    ambiguous(NEAR, match(0), **UNBACKED),
    ambiguous(NEAR, one(AMBIGUOUS, NEAR), **UNBACKED, require_context=False),
    ambiguous(THREE, match(0), max_candidates=2),  # three are too many
    ambiguous(
        {0: 0.90, 1: 0.86, 2: 0.70},
        one(AMBIGUOUS, {0: 0.95, 1: 0.91}),
        context(o0=0.05, o1=0.05),
    ),
    competing(PAIR, False, confirmed_parents=False),
    competing(PAIR, False, enabled=False),
    competing(PAIR, False, (Lifecycle.INACTIVE, 0)),
    competing(PAIR, True, (YOUNG, 2)),
    competing(PAIR, True, (YOUNG, 3), young_only=False),
    competing(PAIR, True, (YOUNG, 3), max_parent_age=3),
    competing(PAIR, True, (Lifecycle.NEW, 1)),
    competing((0.89, 0.87), True),
    competing((0.86, 0.84), False),  # confirmed parents: at least 0.85 each
    competing((0.95, 0.89), False),  # behind a lock: at most 0.05 apart
    provisional({0: 0.74, 1: 0.67}, one(NEW)),  # no clear winner
    provisional({0: 0.74, 1: 0.72}, one(NEW), **CLOSE),  # two are close
    provisional({0: 0.74, 1: 0.72}, one(PROVISIONAL, {0: 0.74}), **CLOSE, visual_max_close=2),
    provisional(MISSED, one(NEW), visual_fallback=False),
    provisional(MISSED, one(NEW), visual_single_only=True),
    provisional({0: 0.74}, one(PARENT, {0: 0.74}), visual_single_only=True),
    provisional(MISSED, one(NEW), visual_min_score=0.745),
    provisional({0: 0.70, 1: 0.50}, one(PARENT, {0: 0.70}), visual_margin=0.06),
    # Object 0 is supported, but scores too little to be named.
    *(
        provisional(
            {0: 0.64},
            one(outcome),
            context(o0=0.05),
            min_candidate=0.75,
            require_context=is_required,
            from_strong=is_admitted,
        )
        for is_required, is_admitted, outcome in (
            (True, True, NEW),
            (False, True, PROVISIONAL),
            (False, False, NEW),
        )
    ),
    beside_a_taken_support(1, {0: 0.82, 1: 0.66}),
    beside_a_taken_support(2, {0: 0.82, 1: 0.66}),
    beside_a_taken_support(3, {0: 0.82, 1: 0.66, 2: 0.65}),
    rescued(0.05, [1, -1]),
    rescued(0.10, [0, 1]),
]


def check(verdict: Verdict, row: int, n: int, expected: Mapping[str, Any]) -> None:
    d = verdict.decisions
    assert Outcome(d.outcome[row, n]) is expected["outcome"]
    for field, values in (
        ("reason", d.reason),
        ("status", d.status),
        ("status_final", d.status_final),
        ("object", d.object_id),
        ("assigned", d.assigned_id),
        ("guarded", d.guarded_id),
    ):
        if field in expected:
            assert values[row, n] == expected[field], field
    # Scores pass through one weighted mean: off by an ulp; six decimals are given.
    for field, values in (("score", d.score), ("confidence", d.confidence)):
        if field in expected:
            assert values[row, n] == pytest.approx(expected[field], abs=5e-7), field
    named = [int(slot) for slot in d.option_id[row, n] if slot >= 0]
    assert named == list(expected["known"])
    scores = d.option_score[row, n, : len(named)]
    np.testing.assert_allclose(scores, list(expected["known"].values()), atol=1e-9)
    assert d.option_blocked[row, n].sum() == expected.get("blocked", 0)


def test_worked_examples(x64):
    cases = {name: (rows, around, {}, told) for name, (rows, around, told) in EXAMPLES.items()}
    cases |= {f"variant {number}": case for number, case in enumerate(VARIANTS)}
    frames = [visual_frame(rows, **around) for rows, around, _, _ in cases.values()]
    verdict = decide_frames(
        frames, [change_parts(Thresholds(), **changes) for _, _, changes, _ in cases.values()]
    )
    failed = []
    for row, (name, (_, _, _, expected)) in enumerate(cases.items()):
        for n, about in enumerate(expected):
            try:
                check(verdict, row, n, about)
            except AssertionError as error:
                failed.append(f"example {name}, detection {n}: {error}")
    assert not failed, "\n".join(failed)


def decide(rows: list[list[float]], **changed: Any) -> Verdict:
    """Without the other guards a detection is matched, new, or doubtful."""
    thresholds = change_parts(Thresholds(), **without(*GUARDS, stability=changed))
    return decide_frames([visual_frame([dict(enumerate(row)) for row in rows])], [thresholds])


def doubtful(verdict: Verdict) -> list[int]:
    d = verdict.decisions
    assert (d.reason[0][d.outcome[0] == AMBIGUOUS] == STABILITY).all()
    return np.flatnonzero(d.outcome[0] == AMBIGUOUS).tolist()


@pytest.mark.parametrize("gap", [0.0, 0.02, 0.05, 0.2])
def test_doubt_is_the_gap_of_the_two_best_assignments(x64, gap):
    """Against all assignments of three look-alikes, one by one."""
    rng = np.random.default_rng(int(100 * gap))
    num_doubtful = 0
    for _ in range(12):
        table = rng.uniform(0.76, 0.89, (3, 3))  # all open, no locks
        ways = sorted(
            itertools.permutations(range(3)),
            key=lambda way: -sum(table[n, o] for n, o in enumerate(way)),
        )
        first, second = (np.array(way) for way in ways[:2])
        lead = sum(table[n, first[n]] - table[n, second[n]] for n in range(3))
        verdict = decide(table.tolist(), assignment_gap=gap)
        expected = np.flatnonzero(first != second).tolist() if lead <= gap else []
        assert doubtful(verdict) == expected
        num_doubtful += len(expected)
        for n in set(range(3)) - set(expected):
            assert verdict.decisions.object_id[0, n] == first[n]
        for n in expected:
            named = {int(o) for o in verdict.decisions.option_id[0, n] if o >= 0}
            assert named >= {int(first[n]), int(second[n])}
    assert (num_doubtful > 0) == (gap > 0)


def test_five_look_alikes_are_too_many_to_enumerate(x64):
    """Components of more than four are left as they are unless they lean on rescued pairs."""
    table = np.full((5, 5), 0.80) + 0.001 * np.eye(5)
    assert doubtful(decide(table.tolist())) == []
    assert doubtful(decide(table[:4, :4].tolist())) != []
