"""Every row of a sweep is the single run with that setting; nothing is done twice."""

import dataclasses
import math

import numpy as np
import pytest

from remind_jax import method as methods
from remind_jax.backbone.registry import get_backbone
from remind_jax.config import load_config
from remind_jax.errors import ConfigError, OutputError, SourceError, SweepError
from remind_jax.frame import Detections
from remind_jax.method import get_method
from remind_jax.sources import open_source
from remind_jax.sweeps import batches, sweep
from remind_jax.sweeps.batches import run_batch
from remind_jax.sweeps.bench import _distinct
from remind_jax.sweeps.program import SCORES
from remind_jax.sweeps.records import Records, Row, row_key
from remind_jax.sweeps.scene_arrays import describe_scene, load_scene
from remind_jax.sweeps.settings import complete
from tests import tiny_world as world
from tests.sweeps.fake_bench import FakeBench
from tests.sweeps.tiny_sweep import CONFIG, SCENES, SETTINGS

# What is kept and done again does not depend on who decides.
QUICK = {"tracker": "iou"}
BOXES = [{"min_iou": value} for value in (0.1, 0.3, 0.5, 0.7, 0.9)]


@pytest.mark.slow
def test_a_batch_without_room_to_grow_gives_no_answers():
    scene = load_scene(open_source(SCENES[0]), CONFIG, get_backbone("patch-statistics"))
    small = dataclasses.replace(world.STATIC, num_objects=2)
    described = describe_scene(scene, small, CONFIG)
    answers, grown = run_batch(described, CONFIG, SETTINGS[:4], small, budget_bytes=1)
    assert answers is None
    assert grown.num_objects > 2
    answers, _ = run_batch(described, CONFIG, SETTINGS[:1], small, budget_bytes=1)
    assert answers is not None


def test_nothing_is_done_twice(tmp_path, monkeypatch):
    first = sweep(SCENES[:1], BOXES[:3], config=QUICK, batch=4, out=tmp_path)
    calls = []
    run = batches.run_batch
    monkeypatch.setattr(
        "remind_jax.sweeps.worker.run_batch", lambda *args: calls.append(args) or run(*args)
    )
    with (tmp_path / "rows.jsonl").open("a") as stream:
        stream.write('{"key": "cut o')
    again = sweep(SCENES[:1], BOXES, config=QUICK, batch=4, out=tmp_path)
    assert len(calls) >= 1
    assert sum(len({str(s) for s in args[2]}) for args in calls) == 2
    np.testing.assert_array_equal(again.table()[:3], first.table())
    calls.clear()
    sweep(SCENES[:1], BOXES, config=QUICK, batch=4, out=tmp_path)
    assert not calls


def test_damaged_rows_are_made_again(tmp_path):
    """Bytes that are no text, deep nesting, other fields: each counts as missing."""
    key = row_key("scene", {"matching.match": 0.5}, {})
    scores = dict.fromkeys(SCORES, 0.25) | {"Recovery": math.nan, "Identities": 5, "HOTA": 1.0}
    row = Row(key, "scene", {"matching.match": 0.5, "matching.lock": True}, scores)
    Records(tmp_path).add([row])
    path = tmp_path / "rows.jsonl"
    with path.open("ab") as stream:
        stream.write(b'{"key":"\xff\xfe"}\n{"key":' + b"[" * 100_000 + b"\n")
        whole = path.read_bytes().splitlines()[0].replace(key.encode(), b"a")
        for damaged in (b'"IDF1":"high",', b'"IDF1":5.0,', b'"Other":0.25,', b""):
            stream.write(whole.replace(b'"IDF1":0.25,', damaged) + b"\n")
    found = Records(tmp_path)
    assert key in found
    assert "a" not in found
    assert found[key].setting == row.setting
    # Tables show 5 and 5.0 as they are.
    assert str(found[key]) == str(row)


def test_a_score_that_no_scene_has_is_shown_as_nothing():
    result = FakeBench(lambda setting, scene: {"IDF1": 0.5, "Recovery": math.nan}).run([{}])
    assert result.to_markdown().splitlines()[-1] == "| 0 | 0.500 | - |"
    assert "nan" not in str(result)


@pytest.mark.parametrize("data", [b"hello\n", b"\xff\xfe\x00", b"[1]\n", b"\x80" * 50])
def test_rows_of_something_else_are_refused(tmp_path, data):
    (tmp_path / "rows.jsonl").write_bytes(data)
    with pytest.raises(OutputError, match=r"rows\.jsonl"):
        Records(tmp_path)
    assert (tmp_path / "rows.jsonl").read_bytes() == data


def test_interruption_keeps_what_is_done(tmp_path):
    def stop(progress):
        raise KeyboardInterrupt

    stopped = sweep(SCENES, BOXES[:2], config=QUICK, batch=4, out=tmp_path, progress=stop)
    assert not stopped.complete
    assert len((tmp_path / "rows.jsonl").read_text().splitlines()) == 2  # of four


def test_thresholds_are_named_as_everywhere():
    given = [{"thresholds.matching.match": 1}, {"matching.match": 0.5}, {"match": 0.25}]
    named = [{"matching.match": value} for value in (1.0, 0.5, 0.25)]
    assert complete(given, CONFIG) == named


def test_a_profile_is_followed_where_features_come_from_the_backbone():
    config, backbone = load_config("remind"), get_backbone("patch-statistics")
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (2, 64, 96, 3), np.uint8)
    masks = np.zeros((2, 64, 96), np.int32)
    masks[:, 8:40, 8:40] = 1
    pairs = list(zip(images, masks, strict=True))
    described = load_scene(open_source(pairs), config, backbone)
    assert described.config == config.for_backbone("patch-statistics") != config
    given = load_scene(open_source(SCENES[0]), config, backbone)
    assert given.config == config


def test_bad_input_is_told_before_work_starts():
    with pytest.raises(ConfigError, match=r"'matching\.mtch' in a setting.*'match'"):
        sweep(SCENES, {"matching.mtch": [0.5]}, config=CONFIG)
    with pytest.raises(ConfigError, match=r"input\.open_px is no threshold"):
        sweep(SCENES, {"input.open_px": [0, 3]}, config=CONFIG)
    with pytest.raises(ConfigError, match=r"a threshold twice: matching\.match, match"):
        sweep(SCENES, {"matching.match": [0.5], "match": [0.6]}, config=CONFIG)
    with pytest.raises(ConfigError, match="must be true or false"):
        sweep(SCENES, {"influence.enabled": [0.5]}, config=CONFIG)
    unknown = [
        dataclasses.replace(frame, detections=Detections.create(frame.detections.masks))
        for frame in SCENES[0]
        if frame.detections is not None
    ]
    with pytest.raises(SourceError, match="no mask of a known object"):
        sweep([unknown], {"matching.match": [0.5]}, config=CONFIG)
    bare = [dataclasses.replace(frame, detections=None) for frame in unknown]
    with pytest.raises(SourceError, match="without masks; give masks that say which object"):
        sweep([bare], {"matching.match": [0.5]}, config=CONFIG)


def test_what_decide_returns_is_checked_as_by_a_run(monkeypatch):
    package = get_method("iou")
    wrong = dataclasses.replace(package, decide=lambda state, *given, **options: state)
    monkeypatch.setattr(methods, "_methods", {**methods._methods, "iou": wrong})
    with pytest.raises(ConfigError, match="'decide' of tracker 'iou' returns SceneMemory; return"):
        sweep(SCENES[:1], BOXES[:1], tracker="iou")


def test_ids_may_begin_anywhere(monkeypatch):
    given, labels = {"static": {"first_object_id": 500}, "tracker": "iou"}, []
    score = batches.compiled_score
    monkeypatch.setattr(
        batches,
        "compiled_score",
        lambda *args, **sizes: labels.append(sizes["num_labels"]) or score(*args, **sizes),
    )
    rows = [
        sweep(SCENES[:1], BOXES[:1], config=config).table()
        for config in ({"tracker": "iou"}, given)
    ]
    np.testing.assert_array_equal(*rows)
    assert len(set(labels)) == 1, "labels are counted, whatever the ids"


def test_scenes_of_one_name_are_numbered_apart():
    assert _distinct(["k", "k", "k (1)", "m"]) == ["k (1)", "k (2)", "k (1) (1)", "m"]
    assert _distinct(["k (1)", "k", "k"]) == ["k (1)", "k (2)", "k (3)"]


def test_a_scene_is_given_once(tmp_path):
    with pytest.raises(SweepError, match="rooms' is given twice"):
        sweep([tmp_path / "rooms", f"{tmp_path}/other/../rooms"], {"match": [0.5]}, config=CONFIG)


def test_frames_that_a_sweep_leaves_out_are_told(caplog):
    masks = np.zeros((1, 64, 64), bool)
    masks[0, 8:40, 8:40] = True
    shown = Detections.create(masks, labels=["cup"], instance_ids=[1])
    frames = [np.zeros((64, 64, 3), np.uint8), np.zeros((128, 128, 3), np.uint8)]
    source = open_source([(image, shown) for image in frames], name="odd")
    scene = load_scene(source, load_config(QUICK), get_backbone("patch-statistics"))
    assert scene.num_frames == 1
    assert "'odd': 1 frame left out" in caplog.text


def test_what_a_sweep_cannot_score_is_refused():
    with pytest.raises(ConfigError, match="announce_after is 5"):
        sweep(SCENES, BOXES[:1], config={**QUICK, "input.announce_after": 5})
