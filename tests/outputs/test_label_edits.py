"""Edits change labels as they say, and what they leave is truth that scores 100 against itself."""

import json

import msgspec
import numpy as np
import pytest

from remind_jax.decision import NO_ID
from remind_jax.errors import OutputError, SourceError
from remind_jax.formats.instance_maps import write_instance_maps
from remind_jax.formats.mot import mot_lines
from remind_jax.metrics import evaluate
from remind_jax.outputs.label_edits import (
    Assign,
    Edits,
    Merge,
    Move,
    apply_edits,
    digest,
    first_labels,
    read_edits,
)
from remind_jax.outputs.result import Result
from tests.formats.test_cvat import write_cvat
from tests.outputs.fake_run import make_info, make_run, make_tracks


@pytest.fixture(scope="module")
def result() -> Result:
    return make_run()[1]


def made(result: Result, *edits) -> Edits:
    num = sum(len(tracks) for tracks in result.tracks)
    return Edits("remind-jax edits", 1, result.info.name, num, list(edits))


def labels_of(result: Result) -> list[list[int]]:
    return [tracks.object_id.tolist() for tracks in result.tracks]


def test_without_edits_firm_identities_are_labels(result):
    same = apply_edits(result, made(result), "edits.json")
    assert labels_of(same) == labels_of(result)
    assert all((tracks.is_firm == (tracks.object_id != NO_ID)).all() for tracks in same.tracks)


def test_edits_are_applied_in_order(result):
    edits = made(
        result,
        Move(2, 10, 39, 20),  # object 2 is another one from frame 10 on
        Merge(20, 0),  # which is object 0: twice in these frames, until
        Move(0, 10, 39, 21),  # both are moved away
        Move(21, 0, 39, None),
        Assign(5, 0, 22),
    )
    before, after = labels_of(result), labels_of(apply_edits(result, edits, "e"))
    for frame, (old, new) in enumerate(zip(before, after, strict=True)):
        expected = [NO_ID if frame >= 10 and one in (0, 2) else one for one in old]
        if frame == 5:
            expected[0] = 22
        assert new == expected, frame


def test_an_identity_has_the_class_of_most_of_its_detections(result):
    first = result.tracks[0]
    assert [first.labels[first.object_id.tolist().index(one)] for one in (1, 2)] == ["cup", "book"]
    # Object 1 is away in the middle: there object 2 takes its place, for fewer frames.
    labeled = apply_edits(result, made(result, Move(2, 20, 22, 1)), "e")
    own = labeled.tracks[21].object_id.tolist().index(1)
    assert result.tracks[21].labels[own] == "book"
    assert labeled.tracks[21].labels[own] == "cup"


@pytest.mark.parametrize(
    ("edit", "named"),
    [
        (Merge(77, 1), "identity 77 into 1"),
        (Move(1, 15, 20, 2), "identity 1 in frames 15 to 20"),
        (Assign(3, 99, 1), "detection 99 of frame 3"),
        (Assign(400, 0, 1), "detection 0 of frame 400"),
    ],
)
def test_an_edit_of_what_is_not_there_is_refused(result, edit, named):
    with pytest.raises(SourceError, match=f"'e', edit 1 .{named}.: there is no such detection"):
        apply_edits(result, made(result, edit), "e")


def test_an_identity_twice_in_a_frame_is_refused(result):
    with pytest.raises(
        SourceError, match=r"leaves identity 0 twice in frame 0 .detections 0 and 2"
    ):
        apply_edits(result, made(result, Merge(2, 0)), "e")


def test_edits_of_another_run_are_refused(result):
    edits = Edits("remind-jax edits", 1, "attic", 5, [])
    with pytest.raises(SourceError, match=r"a run of 5 detections \('attic'\)"):
        apply_edits(result, edits, "e")
    # The same detections, decided otherwise: ids mean others.
    edits = made(result, Merge(77, 1))
    own = msgspec.structs.replace(edits, labels=digest(first_labels(result.tracks)))
    with pytest.raises(SourceError, match="there is no such detection"):
        apply_edits(result, own, "e")
    other = msgspec.structs.replace(edits, labels=digest([np.array([2])]))
    with pytest.raises(SourceError, match="with other identities than this one; give the run"):
        apply_edits(result, other, "e")


@pytest.mark.parametrize(
    "change",
    [
        {"format": "something"},
        {"version": 2},
        {"edits": [{"edit": "paint", "id": 1}]},
        {"edits": [{"edit": "merge", "id": -1, "into": 2}]},
        {"edits": [{"edit": "merge", "id": 1, "into": 2, "why": "x"}]},
        {"edits": [{"edit": "move", "id": 1, "first": 0, "last": 2**40, "to": None}]},
        {"more": 1},
    ],
)
def test_what_is_no_file_of_edits_is_refused(tmp_path, change):
    good = {"format": "remind-jax edits", "version": 1, "run": "a", "num_detections": 3}
    (tmp_path / "good.json").write_text(json.dumps({**good, "edits": []}))
    assert read_edits(tmp_path / "good.json").edits == []
    (tmp_path / "bad.json").write_text(json.dumps({**good, "edits": [], **change}))
    with pytest.raises(SourceError, match=r"bad\.json"):
        read_edits(tmp_path / "bad.json")


SOME = (Merge(5, 7), Move(3, 30, 39, 50), Move(4, 0, 5, None), Assign(8, 2, 60))


@pytest.mark.parametrize("format", ["davis", "cvat"])
def test_the_truth_scores_the_labeled_run_with_100(result, tmp_path, format):
    labeled = apply_edits(result, made(result, *SOME), "e")
    truth = tmp_path / ("truth" if format == "davis" else "cvat.xml")
    if format == "davis":
        write_instance_maps(labeled.tracks, labeled.info.name, truth)
    else:
        write_cvat(labeled, truth)
    labeled.save(tmp_path / "run")
    scores = evaluate(truth, tmp_path / "run").scores()
    names = ("IDF1", "HOTA", "AssA", "Recovery", "HardRecovery")
    assert {name: scores[name] for name in names} == dict.fromkeys(names, 1.0)
    # Text of the same run counts the frames of the source, of which it took every second one.
    (tmp_path / "mot.txt").write_text("\n".join(mot_lines(labeled.tracks)))
    assert evaluate(truth, tmp_path / "mot.txt").scores()["IDF1"] == 1
    result.save(tmp_path / "unlabeled")
    assert evaluate(truth, tmp_path / "unlabeled").scores()["IDF1"] < 1


def test_instance_maps_of_16_bits_where_8_do_not_suffice(tmp_path):
    masks = np.zeros((2, 8, 8), bool)
    masks[0, :2, :2], masks[1, 4:6, 4:6] = True, True
    tracks = make_tracks(0, masks, [{"object_id": 3}, {"object_id": 300}])
    run = Result((tracks,), make_info(size=(8, 8)))
    write_instance_maps(run.tracks, run.info.name, tmp_path / "truth")
    run.save(tmp_path / "run")
    assert evaluate(tmp_path / "truth", tmp_path / "run").scores()["IDF1"] == 1


def test_maps_of_something_else_are_left_alone(result, tmp_path):
    write_instance_maps(result.tracks, result.info.name, tmp_path)
    (maps,) = (tmp_path / "Annotations").iterdir()
    write_instance_maps(result.tracks, result.info.name, tmp_path)
    (maps / "mine.png").write_bytes(b"")
    with pytest.raises(OutputError, match=r"holds 'mine.png', which is no map of this run"):
        write_instance_maps(result.tracks, result.info.name, tmp_path)
