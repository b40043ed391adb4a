"""Real clips: what is counted of returns, merges and confidence, and how clips are read."""

import gzip
import json

import numpy as np
import pytest

from benchmarks.clips import ABSENT, Answers, find_clips, judge
from benchmarks.realvideo import make_tables, row_of

VISIT = 6  # frames
AWAY = ABSENT + 1
NOBODY = -1


@pytest.fixture
def clip(tmp_path):
    """Two people side by side, and a cat between; person 1 is away twice, once too shortly."""
    visits = [(1, 2, 3)] * VISIT + [(2, 3)] * AWAY + [(1, 2, 3)] * VISIT
    visits += [(2, 3)] * (ABSENT - 1) + [(1, 2, 3)] * VISIT
    labels = [(*there, 0) for there in visits]
    names = {1: "person", 2: "person", 3: "cat", 0: "dog"}
    folder = tmp_path / "clips" / "two"
    folder.mkdir(parents=True)
    told = {
        "id_to_class": {str(one): names[one] for one in (1, 2, 3)},
        "labels_of_detections": labels,
    }
    (folder / "metadata.json").write_text(json.dumps(told))
    lines = [
        json.dumps({"frame": t, "detections": [{"label": names[one]} for one in row]})
        for t, row in enumerate(labels)
    ]
    (folder / "yolo.jsonl.gz").write_bytes(gzip.compress("\n".join(lines).encode()))
    (found,) = find_clips(tmp_path / "clips")
    return found


def judged(clip, name, sure=1.0, became=None):
    """Answers by a function of frame and true object."""
    frame, _, instance = clip.rows
    ids = [name(t, one) for t, one in zip(frame.tolist(), instance.tolist(), strict=True)]
    return judge(clip, Answers(np.array(ids), np.full(len(ids), sure), became or {}))


def scores(clip, name, **answers):
    return row_of("it", [judged(clip, name, **answers)]).scores


def back(frame):
    return frame >= VISIT + AWAY


def renamed(names):
    """Right until the return, then with other names."""
    return lambda frame, who: names.get(who, who) if back(frame) else who


def test_the_truth_is_all_right(clip):
    found = scores(clip, lambda frame, who: who)
    assert found["IDF1"] == found["AssA"] == found["sure_right"] == 1
    assert (found["returns"], found["recovered"], found["kept"], found["at_once"]) == (1, 1, 1, 1)
    assert (found["pairs"], found["merged"], found["undecided"], found["ece"]) == (1, 0, 0, 0)
    assert (found["IDs"], found["GT_IDs"]) == (3, 3)


def test_an_answer_that_comes_late_is_recovered_and_not_kept(clip):
    last = len(clip.labels) - 1

    def late(frame, who):
        return NOBODY if who == 1 and back(frame) and frame != last else who

    found = scores(clip, late)
    assert (found["recovered"], found["kept"], found["at_once"]) == (1, 0, 0)
    assert found["undecided"] == pytest.approx((2 * VISIT - 1) / clip.rows.shape[1])


@pytest.mark.parametrize(
    ("names", "became", "merged"),
    [
        ({1: 2, 2: 1}, {}, 1),
        ({1: 3, 3: 1}, {}, 0),  # of another class
        ({1: 9}, {}, 0),
        ({1: 9}, {9: 2}, 1),
    ],
)
def test_who_shares_a_name_is_merged(clip, names, became, merged):
    assert scores(clip, renamed(names), became=became)["merged"] == merged


def test_confidence_is_compared_with_the_share_right(clip):
    found = scores(clip, lambda t, who: who, sure=0.8)
    assert found["ece"] == pytest.approx(0.2)
    assert np.isnan(found["sure_right"])


def test_tables_have_a_pooled_row_with_intervals(clip):
    one = judged(clip, lambda t, who: who)
    other = judged(clip, lambda t, who: who + 10 * t)
    (table,) = make_tables({"set": [clip]}, {"a": {"two": one}, "b": {"two": other}})
    assert "| a | **100.00** |" in table.to_markdown()
    pooled = row_of("both", [one, other])
    low, high = pooled.intervals["IDF1"]
    assert low < pooled.scores["IDF1"] < high
    assert pooled.scores["returns"] == 2
