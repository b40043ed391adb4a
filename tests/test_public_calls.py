"""Every public call refuses what is of another kind, shape or range in one sentence."""

from __future__ import annotations

import copy
import dataclasses
import functools
import pickle
import threading

import numpy as np
import pytest

import remind_jax as rj
from remind_jax.calibration import calibrate
from remind_jax.errors import RemindError
from tests.sources.published import Tensor, sam_masks, ultralytics_results

NAN = float("nan")
HEIGHT_PX, WIDTH_PX = 64, 96
IMAGE = np.random.default_rng(0).integers(0, 255, (HEIGHT_PX, WIDTH_PX, 3), np.uint8)
SIZE = (HEIGHT_PX, WIDTH_PX)
MASKS = np.zeros((2, HEIGHT_PX, WIDTH_PX), bool)
MASKS[0, 10:40, 10:40] = MASKS[1, 10:40, 50:90] = True
create = rj.Detections.create
FRAME = rj.Frame(0, 0, 0.0, "x", IMAGE, create(MASKS))
MAPS = np.stack([MASKS[0] * 1 + MASKS[1] * 2] * 3).astype(np.uint8)

pytestmark = pytest.mark.usefixtures("unchecked_shapes")


@functools.cache
def tracker():
    live = rj.Tracker()
    live.update(IMAGE, MASKS)
    return live


@functools.cache
def result():
    return rj.run(np.stack([IMAGE] * 3), masks=MAPS, progress=False)


def given(frame, detections=MASKS):
    return lambda: tracker().update(frame, detections)


def given_frame(**changes):
    return lambda: tracker().update(dataclasses.replace(FRAME, **changes))


def given_raw(**changes):
    return lambda: tracker().update(IMAGE, dataclasses.replace(create(MASKS), **changes))


def run(**changes):
    options = {"masks": np.zeros((2, 64, 96), int), "progress": False, **changes}
    return lambda: rj.run(np.stack([IMAGE] * 2), **options)


CALLS = {
    "update none": given(None),
    "update text": given("a"),
    "update list": given([1, 2]),
    "update gray": given(IMAGE[..., 0]),
    "update float": given(IMAGE.astype(float)),
    "update rgba": given(np.zeros((64, 96, 4), np.uint8)),
    "update empty": given(np.zeros((0, 0, 3), np.uint8), None),
    "update tiny": given(np.zeros((3, 3, 3), np.uint8), np.zeros((0, 3, 3), bool)),
    "update ragged": given([[1, 2], [3]]),
    "update object": given(object()),
    "masks nan": given(IMAGE, np.full((1, 64, 96), NAN)),
    "masks shape": given(IMAGE, np.zeros((1, 32, 32), bool)),
    "masks 1d": given(IMAGE, np.zeros(5, bool)),
    "masks text": given(IMAGE, "mask"),
    "masks 4d": given(IMAGE, np.zeros((1, 1, 64, 96), bool)),
    "map negative": given(IMAGE, np.full((64, 96), -1)),
    "map NAN": given(IMAGE, np.full((64, 96), NAN)),
    "map inf": given(IMAGE, np.full((64, 96), np.inf)),
    "map complex": given(IMAGE, np.zeros((64, 96), complex)),
    "map strings": given(IMAGE, np.full((64, 96), "a")),
    "dict empty": given(IMAGE, {}),
    "dict unknown": given(IMAGE, {"mask": MASKS}),
    "dict scores": given(IMAGE, {"masks": MASKS, "scores": [1]}),
    "dict labels": given(IMAGE, {"masks": MASKS, "labels": ["a"]}),
    "dict NAN score": given(IMAGE, {"masks": MASKS, "scores": [NAN, 1]}),
    "boxes NAN": given(IMAGE, {"boxes": [[0, 0, NAN, 1]]}),
    "boxes shape": given(IMAGE, {"boxes": [0, 1, 2]}),
    "class ids": given(IMAGE, {"masks": MASKS, "class_ids": ["a", "b"]}),
    "boxes bare": given(IMAGE, np.zeros((2, 4))),
    "boxes on a gpu": given(IMAGE, {"boxes": Tensor(np.zeros((2, 4)), "cuda:0")}),
    "image on a gpu": given(Tensor(IMAGE, "cuda:0")),
    "results of another picture": given(IMAGE, ultralytics_results((10, 20), [[0, 0, 4, 4]])),
    "results of two pictures": given(IMAGE, [ultralytics_results(SIZE, [[0, 0, 4, 4]])] * 2),
    "results planes": given(IMAGE, ultralytics_results(SIZE, [[0, 0, 4, 4]], np.zeros((4, 4)))),
    "results counts": given(IMAGE, ultralytics_results(SIZE, [[0, 0, 4, 4]], MASKS)),
    "sam text": given(IMAGE, sam_masks(MASKS, ["a", "b"])),
    "sam none": given(IMAGE, [{"segmentation": None}]),
    "det no image": lambda: tracker().update(rj.Frame(0, 0, 0.0, "x")),
    "det none": lambda: tracker().update(IMAGE),
    "det int": given(IMAGE, 5),
    "det set": given(IMAGE, {1, 2}),
    "create none": lambda: create(None),
    "create 2d": lambda: create(MASKS[0]),
    "create text": lambda: create("abc"),
    "create NAN": lambda: create(np.full((1, 4, 4), NAN)),
    "create labels text": lambda: create(MASKS, "ab"),
    "create labels set": lambda: create(MASKS, {"cup", "mug"}),
    "create labels dict": lambda: create(MASKS, {"cup": 1, "mug": 2}),
    "create labels len": lambda: create(MASKS, ["a"]),
    "create labels int": lambda: create(MASKS, 5),
    "create labels none": lambda: create(MASKS, [None, None]),
    "create labels long": lambda: create(MASKS, ["a" * 300, "b"]),
    "create scores NAN": lambda: create(MASKS, scores=[NAN, 1]),
    "create scores 2": lambda: create(MASKS, scores=[2, 1]),
    "create scores neg": lambda: create(MASKS, scores=[-1, 1]),
    "create scores text": lambda: create(MASKS, scores=["a", "b"]),
    "create scores 2d": lambda: create(MASKS, scores=[[1, 1]]),
    "create ids float": lambda: create(MASKS, instance_ids=[0.5, 1]),
    "create ids NAN": lambda: create(MASKS, instance_ids=[NAN, 1]),
    "create ids text": lambda: create(MASKS, instance_ids="ab"),
    "create ids len": lambda: create(MASKS, instance_ids=[1]),
    "create ids huge": lambda: create(MASKS, instance_ids=[2**40, 1]),
    "create ragged": lambda: create([[[1, 2], [3]]]),
    "empty neg": lambda: rj.Detections.empty(-1, 5),
    "empty text": lambda: rj.Detections.empty("a", 5),
    "empty huge": lambda: rj.Detections.empty(10**9, 10**9),
    "select out": lambda: create(MASKS).select([5]),
    "select text": lambda: create(MASKS).select("a"),
    "select mask len": lambda: create(MASKS).select([True]),
    "select float": lambda: create(MASKS).select([0.5]),
    "select neg": lambda: create(MASKS).select([-3]),
    "raw unequal": given_raw(labels=("a",)),
    "raw scores NAN": given_raw(scores=np.array([NAN, 1], np.float32)),
    "raw masks float": given_raw(masks=np.full((2, 64, 96), NAN)),
    "frame index": given_frame(index="a"),
    "frame image": given_frame(image="a"),
    "frame image f": given_frame(image=IMAGE.astype(float)),
    "frame det": given_frame(detections="a"),
    "frame feat": given_frame(features=np.zeros(3)),
    "frame feat grid": given_frame(features=np.zeros((2, 2, 64), np.float32)),
    "frame feat text": given_frame(features="a"),
    "frame name": given_frame(name=5),
    "frame time": given_frame(time_s=NAN),
    "frame time text": given_frame(time_s="a"),
    "tracker cfg none": lambda: rj.Tracker(None),
    "tracker cfg int": lambda: rj.Tracker(5),
    "tracker cfg list": lambda: rj.Tracker([1]),
    "tracker cfg unknown": lambda: rj.Tracker("nope"),
    "tracker cfg folder": lambda: rj.Tracker("/tmp"),
    "tracker backbone none": lambda: rj.Tracker(backbone=None),
    "tracker backbone int": lambda: rj.Tracker(backbone=5),
    "tracker backbone ?": lambda: rj.Tracker(backbone="zzz"),
    "tracker tracker": lambda: rj.Tracker(tracker=5),
    "tracker announce": lambda: rj.Tracker(announce_after=-1),
    "tracker announce f": lambda: rj.Tracker(announce_after=1.5),
    "tracker announce t": lambda: rj.Tracker(announce_after="a"),
    "tracker announce NAN": lambda: rj.Tracker(announce_after=NAN),
    "tracker option": lambda: rj.Tracker(foo=1),
    "tracker cfg deep": lambda: rj.Tracker({"a": {"b": {"c": 1}}}),
    "warm text": lambda: tracker().warm_up("a"),
    "warm 1": lambda: tracker().warm_up((5,)),
    "warm neg": lambda: tracker().warm_up((-1, 5)),
    "warm zero": lambda: tracker().warm_up((0, 0)),
    "warm float": lambda: tracker().warm_up((64.5, 96)),
    "warm huge": lambda: tracker().warm_up((99999999, 1)),
    "warm huge2": lambda: tracker().warm_up((10**5, 10**5)),
    "warm none": lambda: tracker().warm_up(None),
    "warm objects": lambda: tracker().warm_up((64, 96), num_objects=-1),
    "warm objects t": lambda: tracker().warm_up((64, 96), num_objects="a"),
    "warm objects huge": lambda: tracker().warm_up((64, 96), num_objects=10**12),
    "save none": lambda: tracker().save(None),
    "save int": lambda: tracker().save(5.5),
    "load none": lambda: tracker().load(None),
    "load int": lambda: tracker().load(5.5),
    "load missing": lambda: tracker().load("/nope"),
    "load folder": lambda: tracker().load("/tmp"),
    "prepare none": lambda: tracker().prepare(None),
    "prepare image": lambda: tracker().prepare(IMAGE),
    "advance none": lambda: tracker().advance(None),
    "load_config none": lambda: rj.load_config(None),
    "load_config int": lambda: rj.load_config(5),
    "load_config empty": lambda: rj.load_config(""),
    "load_config key int": lambda: rj.load_config({1: 2}),
    "load_config NAN": lambda: rj.load_config({"decision.new": NAN}),
    "load_config base": lambda: rj.load_config({"base": 5}),
    "load_config tracker": lambda: rj.load_config({"tracker": ["a"]}),
    "updated none": lambda: rj.load_config("default").updated(None),
    "updated list": lambda: rj.load_config("default").updated([1]),
    "with_tracker": lambda: rj.load_config("default").with_tracker(5),
    "for_backbone": lambda: rj.load_config("default").for_backbone(5),
    "from_ref": lambda: rj.Config.from_reference(5),
    "from_ref none": lambda: rj.Config.from_reference(None),
    "from_ref list": lambda: rj.Config.from_reference([1]),
    "from_ref text": lambda: rj.Config.from_reference("nope.yaml"),
    "from_ref k": lambda: rj.Config.from_reference(
        {"association": {"scores": {"neighbor_sets": {"context": {"k": NAN}}}}}
    ),
    "from_ref every": lambda: rj.Config.from_reference(
        {"memory": {"neighbors": {"force_episode_every_frames": "a"}}}
    ),
    "difference": lambda: rj.load_config("default").difference(5),
    "run none": lambda: rj.run(None),
    "run int": lambda: rj.run(5),
    "run missing": lambda: rj.run("/nope.mp4"),
    "run empty": lambda: rj.run([]),
    "run arr": lambda: rj.run(np.zeros(5)),
    "run nomask": run(masks=None),
    "run masks": run(masks=5),
    "run masks n": run(masks=np.zeros((1, 64, 96), int)),
    "run masks f": run(masks=np.full((2, 64, 96), NAN)),
    "run masks neg": run(masks=np.full((2, 64, 96), -3)),
    "run opt": lambda: rj.run("x", foo=1),
    "run delay": run(delay=-1),
    "run delay t": run(delay="a"),
    "run sampling": run(sampling=5),
    "run sampling k": run(sampling={"fpz": 1}),
    "run detector": run(masks=None, detector=5),
    "run det ret": run(masks=None, detector=lambda f: 5),
    "run det opts": run(masks=None, detector=lambda f: None, detector_options=5),
    "run out": run(out=5),
    "run memory": run(memory=5),
    "run progress": run(progress=5),
    **{
        f"run {name}={value!r}": run(**{name: value})
        for name, value in (
            *(("overlay", "x"), ("overlay", 1), ("trace", "yes"), ("overwrite", None)),
            *(("resume", 0), ("on_live", 5), ("progress", "yes")),
        )
    },
    "live trace": lambda: rj.Tracker(trace=1),
    "run fps": run(image_fps=NAN),
    "run config": run(config=5),
    "run metadata": run(metadata=5),
    "run weights": run(weights=5),
    "run fcache": run(feature_cache=5),
    "open none": lambda: rj.open_source(None),
    "open int": lambda: rj.open_source(5),
    "open empty": lambda: rj.open_source(""),
    "sampling": lambda: rj.Sampling(fps="a"),
    "sampling0": lambda: rj.Sampling(fps=0),
    "sampling s": lambda: rj.Sampling(stride=0.5),
    "sweep none": lambda: rj.sweep(None, [{}]),
    "sweep settings": lambda: rj.sweep("x", None),
    "sweep str": lambda: rj.sweep("x", "a"),
    "sweep empty": lambda: rj.sweep([], [{}]),
    "sweep NAN": lambda: rj.sweep("x", [{"decision.new": NAN}]),
    "sweep missing": lambda: rj.sweep("/nope", [{}]),
    "evaluate none": lambda: rj.evaluate(None, None),
    "evaluate int": lambda: rj.evaluate(5, 5),
    "evaluate missing": lambda: rj.evaluate("/nope", "/nope2"),
    "evaluate res": lambda: rj.evaluate(result(), 5),
    "compare int": lambda: rj.compare(5, 5),
    "compare empty": lambda: rj.compare([], []),
    "res frame": lambda: result().to_supervision(99),
    "res frame t": lambda: result().to_supervision("a"),
    **{
        f"res save {path!r}"[:40]: lambda path=path: result().save(path)
        for path in (None, 5, "", "a\0b", b"a", [])
    },
    "calibrate option": lambda: calibrate("/nope", nope=1),
    "sweep option": lambda: rj.sweep("/nope", [{}], nope=1),
    "res load": lambda: rj.Result.load("/nope"),
    "res load none": lambda: rj.Result.load(None),
    "res explain": lambda: result().explain(0, 0),
    "res tracks display": lambda: result().tracks[0].display_name(99),
    "static float": lambda: rj.Static(num_objects=1.5),
    "static none": lambda: rj.Static(num_objects=None),
    "static none2": lambda: rj.Static(precision=None),
    "method none": lambda: rj.get_method(None),
    "stack nothing": lambda: rj.stack_scene("/nope"),
    "stack none": lambda: rj.stack_scene([], num_objects=0),
    "settings": lambda: rj.sweeps.stack(rj.Config().thresholds, [{"matching.mach": 1.0}]),
}


def test_a_bad_call_is_refused_in_one_sentence():
    wrong = []
    for name, call in CALLS.items():
        try:
            call()
            wrong.append(f"{name}: goes through")
        except RemindError as error:
            said = str(error)
            if not said or "\n" in said or len(said) >= 700:
                wrong.append(f"{name}: {said}")
        except Exception as error:
            wrong.append(f"{name}: {error!r}")
    assert not wrong


def test_a_tracker_that_refused_goes_on():
    live = rj.Tracker()
    first = live.update(IMAGE, create(MASKS, ["a", "b"]))
    with pytest.raises(RemindError):
        live.update(IMAGE, np.full((1, HEIGHT_PX, WIDTH_PX), NAN))
    with pytest.raises(RemindError):
        live.update(IMAGE[:, :, 0], MASKS)
    again = live.update(IMAGE, create(MASKS, ["a", "b"]))
    np.testing.assert_array_equal(first.object_id, again.object_id)
    assert again.frame_index == 1


@pytest.mark.parametrize("part", ["prepare", "advance"])
def test_a_second_thread_is_refused_and_nothing_is_damaged(part):
    live, alone = rj.Tracker(), rj.Tracker()
    seen = create(MASKS, ["a", "b"])
    live.update(IMAGE, seen)
    alone.update(IMAGE, seen)
    held = live._alone(part)
    inside, done = threading.Event(), threading.Event()

    def hold():
        with held:
            inside.set()
            done.wait(60)

    thread = threading.Thread(target=hold)
    thread.start()
    assert inside.wait(60)
    with pytest.raises(RemindError, match="two threads at once"):
        live.update(IMAGE, seen)
    done.set()
    thread.join()
    np.testing.assert_array_equal(
        live.update(IMAGE, seen).object_id, alone.update(IMAGE, seen).object_id
    )


@pytest.mark.parametrize("take", [pickle.dumps, copy.copy, copy.deepcopy])
def test_a_tracker_is_not_pickled_or_copied(take):
    with pytest.raises(RemindError, match="cannot be pickled or copied; write its memory"):
        take(tracker())


def pickled(one):
    return pickle.loads(pickle.dumps(one))


@pytest.mark.parametrize("take", [pickled, copy.copy, copy.deepcopy])
def test_what_holds_data_is_pickled_and_copied(take):
    config = rj.load_config({"base": "remind", "matching.match": 0.6})
    assert take(config) == config
    assert take(config).chosen == config.chosen
    assert take(config.static) == config.static
    seen = create(MASKS, ["a", "b"], [0.5, 1.0], [3, 4])
    again = take(seen)
    assert again.labels == seen.labels
    for name in ("masks", "scores", "instance_ids"):
        np.testing.assert_array_equal(getattr(again, name), getattr(seen, name))
    np.testing.assert_array_equal(take(FRAME).image, FRAME.image)
    found = take(result())
    assert len(found.tracks) == len(result().tracks) == 3
    for ours, theirs in zip(found.tracks, result().tracks, strict=True):
        np.testing.assert_array_equal(ours.object_id, theirs.object_id)
        np.testing.assert_array_equal(ours.masks, theirs.masks)
    assert pickle.loads(pickle.dumps(RemindError("a sentence"))).args == ("a sentence",)
