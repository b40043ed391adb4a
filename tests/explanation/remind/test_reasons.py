"""The chain of reasons on the worked examples of method.md#example-frames and on a drawn world."""

import dataclasses
import operator
import re
from typing import Any

import numpy as np
import pytest

from remind_jax.decision import Outcome, Reason
from remind_jax.remind.context.veto import Veto
from remind_jax.remind.memory.objects import Lifecycle
from tests.explanation.scenes import chain, decide_frame, explain
from tests.remind.association.tables import backed
from tests.remind.undecided.test_examples import EXAMPLES

HOLDS = {">=": operator.ge, ">": operator.gt, "<=": operator.le, "<": operator.lt}

# Of an example, by its number there: a detection, and what its chain must say.
SAID = {
    "2, a lock": (
        0,
        ["STRONG evidence: 0.91 >= 0.80.", "locked to mug 0", "0.91 >= 0.90", "Matched as mug 0"],
    ),
    "4, two of a kind": (
        0,
        ["AMBIGUOUS evidence: ahead by 0.06", "Open between mug 0 and mug 1"],
    ),
    "6, just clear": (
        0,
        ["it looks most like mug 0 (0.80), then mug 1 (0.72)", "Matched as mug 0"],
    ),
    "9, a swap": (
        0,
        [
            "Mug 0, which it looks most like, goes to detection 1",
            "Detections 0 and 1 could swap their objects, so the match with mug 1 is withdrawn",
        ],
    ),
    "11, a birth beside a match": (
        1,
        ["claims an object that another holds with nearly", "Open between mug 0 and mug 1"],
    ),
    "17, the uncertain gives way": (
        0,
        ["No object is assigned to it: mug 0 goes to detection 1", "A new object: mug 2"],
    ),
    "18, a near miss": (
        0,
        ["misses the threshold (0.74 < 0.75)", "Probably mug 0, to be confirmed"],
    ),
    "20, a near miss that is taken": (
        1,
        ["that another detection holds", "Probably new; mug 0 cannot be excluded"],
    ),
    "21, unlike": (0, ["mug 0 looks too unlike (0.50 < 0.60)", "A new object: mug 1"]),
    "22, a rescue": (
        0,
        ["although 0.66 < 0.75: with the bonus of +0.10 it reaches 0.76 >= 0.75"],
    ),
    "23, a penalty": (0, ["contradicts mug 0 (-0.05)", "is open, but with context 0.73 < 0.75"]),
    "25, context may not help the strong": (
        0,
        ["backs mug 0 (+0.05), but is not allowed to change"],
    ),
    "28, two backed": (0, ["Context backs several", "mug 0 (0.71) and mug 1 (0.70)"]),
    "30, no object but two backed": (
        1,
        ["mug 0 goes to detection 0", "context backs known ones well enough: mug 0 (0.85)"],
    ),
}


@pytest.mark.parametrize("name", SAID)
def test_worked_examples_are_explained_with_their_numbers(name):
    rows, around, _ = EXAMPLES[name.partition(",")[0]]
    detection, expected = SAID[name]
    sentences = " ".join(chain(decide_frame(rows, **around), detection))
    for part in expected:
        assert part in sentences


def test_a_veto_is_named():
    record = decide_frame(
        [{0: 0.9, 1: 0.88}],
        context={0: backed(0.05)},
        vetoes={(0, 1): Veto.LOCAL_CTX_CONTRADICTION},
    )
    sentences = " ".join(chain(record, 0))
    assert "Context rules out mug 1." in sentences
    assert "Matched as mug 0" in sentences


def test_nothing_known_is_a_short_story():
    sentences = chain(decide_frame([{}]), 0)
    assert sentences == [
        "No mug is known yet, so it can be none of those seen before.",
        "A new object: mug 0.",
    ]


def test_a_second_claim_is_given_up_in_words():
    """What layout gave, the rule of one detection per identity takes again."""
    record = decide_frame([{0: 0.93, 1: 0.62}, {0: 0.60, 1: 0.92}])
    d = record.decisions
    changes: dict[str, Any] = {
        "outcome": np.array([Outcome.MATCH, Outcome.AMBIGUOUS]),
        "reason": np.array([Reason.ASSIGNED, Reason.KNOWN_BUT_HELD_BY_BETTER_MATCH]),
        "object_id": np.array([0, -1]),
        "option_id": np.array([[-1, -1, -1], [0, 1, -1]]),
        "option_score": np.array([[0, 0, 0], [0.60, 0.92, 0]]),
    }
    record = dataclasses.replace(record, decisions=dataclasses.replace(d, **changes))
    assert chain(record, 1)[-2:] == [
        "Its match was given up for another detection with a better score: mug 0 (0.60) and "
        "mug 1 (0.92).",
        "Open between mug 0 and mug 1.",
    ]
    assert "given up" not in " ".join(chain(record, 0))


def drawn_frames(num: int):
    """Frames of random scores, context and vetoes."""
    rng = np.random.default_rng(5)
    for _ in range(num):
        shape = int(rng.integers(1, 4)), int(rng.integers(1, 5))
        score = rng.choice([0.3, 0.62, 0.7, 0.74, 0.76, 0.8, 0.83, 0.91, 0.95], shape)
        score = score + rng.uniform(-0.01, 0.01, shape)
        rows = [dict(enumerate(row.tolist())) for row in score]
        backing = {
            slot: backed(float(rng.uniform(0.0, 0.2)))
            for slot in range(shape[1])
            if rng.random() < 0.4
        }
        vetoes = {
            (row, slot): int(rng.integers(1, 3))
            for row in range(shape[0])
            for slot in range(shape[1])
            if slot not in backing and rng.random() < 0.1
        }
        around = {"context": backing, "vetoes": vetoes} if rng.random() < 0.7 else {}
        yield decide_frame(rows, lifecycle=Lifecycle(rng.integers(0, 4)), **around)


def test_what_is_said_of_drawn_frames_holds():
    """Comparisons that are shown hold, the verdict is the decision, no sentence lacks a number."""
    num_compared, reasons = 0, set()
    for record in drawn_frames(150):
        for row in range(len(record)):
            explanation = explain(record, row)
            for left, sign, right in re.findall(
                r"([\d.]+\d) (>=|<=|<|>) ([\d.]+\d)", " ".join(explanation.why)
            ):
                assert HOLDS[sign](float(left), float(right))
                num_compared += 1
            options = record.decisions.option_id[row]
            named = [int(i) for i in re.findall(r"mug (\d+)", explanation.why[-1])]
            if explanation.outcome in (Outcome.MATCH, Outcome.NEW):
                assert named == [explanation.object_id]
            else:
                assert named == options[options >= 0].tolist()
            reasons.add(explanation.reason)
            assert len(set(explanation.why)) == len(explanation.why)
            for text in explanation.why:
                assert text.endswith(".")
                assert "None" not in text
                assert "nan" not in text
    assert num_compared > 500
    assert len(reasons) >= 9  # of the 15 reasons that a usable detection can have
