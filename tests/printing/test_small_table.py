import dataclasses
import math

import numpy as np
import pytest

from remind_jax.metrics import ComparisonTable, Row, SetEvaluation, evaluate_tracks
from remind_jax.outputs.result import Result
from remind_jax.printing.small_table import SmallTable
from remind_jax.sweeps.cross_validation import cross_validate
from remind_jax.sweeps.records import Row as SweepRow
from remind_jax.sweeps.result import SweepResult
from tests.outputs.fake_run import make_info, make_run, make_tracks

HOSTILE = "<script>alert(1)</script>\n| & '\""


def rows(number: int) -> SmallTable:
    table = [(f"cup {i}", str(i), "x" * 34, "y" * 34) for i in range(number)]
    return SmallTable("cups", ("all of them",), ("name", "number", "x", "y"), table)


def test_what_does_not_fit_is_counted():
    lines = rows(40).to_text().splitlines()
    assert len(lines) == 12
    assert lines[-1] == "  and 32 more rows, 1 more column"
    assert max(map(len, lines)) <= 80
    assert rows(9).to_text(width=200).splitlines()[-1].split()[:2] == ["cup", "8"]


def test_long_cells_are_shortened_visibly():
    text = SmallTable("t" * 200, ("f" * 200,), ("name", "b"), [("n" * 200, "1")]).to_text()
    assert max(map(len, text.splitlines())) <= 80
    assert all("..." in text.splitlines()[line] for line in (0, 1, 3))


def test_html_is_escaped():
    table = ComparisonTable([Row(HOSTILE, {"IDF1": 0.5})], ["IDF1"], title=HOSTILE)
    page = table._repr_html_()
    assert "<script" not in page
    assert page.count("&lt;script&gt;") == 2


def large_things():
    """One of each class that shows a summary, much larger than what is shown."""
    masks = np.ones((60, 8, 8), bool)
    crowd = make_tracks(0, masks, [{"object_id": i, "instance_id": i} for i in range(60)])
    _, result = make_run()
    crowded = dataclasses.replace(result, tracks=(crowd,))
    evaluation = evaluate_tracks([crowd], name="crowd")
    together = SetEvaluation("crowds", (evaluation,) * 30)
    scores = {"IDF1": 0.5, "HOTA": math.nan, "AssA": 0.25}
    settings = tuple({"matching.match": i / 40} if i else {} for i in range(40))
    scenes = ("a", "b")
    sweep = SweepResult(
        settings,
        scenes,
        tuple(tuple(SweepRow("", scene, s, scores) for scene in scenes) for s in settings),
        batch=8,
        program_bytes=0,
    )
    table = ComparisonTable([Row(f"method {i}", {"IDF1": 0.5}) for i in range(40)], ["IDF1"])
    return [crowd, crowded, make_info(), evaluation, together, sweep, table,
            cross_validate(sweep)]  # fmt: skip


@pytest.mark.parametrize("thing", large_things(), ids=lambda thing: type(thing).__name__)
def test_large_things_print_as_a_few_lines(thing):
    text = repr(thing)
    assert text == str(thing)
    assert len(text.splitlines()) <= 12
    assert max(map(len, text.splitlines())) <= 80
    assert "array(" not in text
    assert thing._repr_html_().startswith("<pre>")


def test_a_frame_names_its_detections():
    rows = [{"object_id": 3, "confidence": 0.75}, {"object_id": 4, "outcome": 2, "score": 0.0}]
    lines = str(make_tracks(7, np.ones((2, 8, 8), bool), rows)).splitlines()
    assert lines[0] == "frame 7 (0.70 s, 000014.jpg), 8 x 8: 2 detections"
    assert lines[2].split() == ["0", "cup", "3", "match", "0.75", "0", "0", "8", "8"]
    assert lines[3].split() == ["1", "cup", "4", "new", "0", "0", "8", "8"]


def test_a_run_names_what_it_found():
    _, result = make_run()
    lines = str(result).splitlines()
    assert lines[0] == "run 'kitchen tour': 40 frames, 6 identities, 3 returns, 2.0 % undecided"
    assert lines[3].strip() == result.events[0].message
    assert lines[5].split() == ["cup", "0", "0", "39", "40", "0"]


def test_runs_and_sweeps_of_nothing_print():
    assert "0 identities" in repr(Result((), make_info()))
    assert "nothing was run" in repr(SweepResult((), ("a",), (), 0, 0))
