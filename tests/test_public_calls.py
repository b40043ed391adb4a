"""Every public call refuses what is of another kind, shape or range in one sentence."""

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


def update(frame, detections=MASKS):
    return tracker().update(frame, detections)


def update_frame(changes):
    return tracker().update(dataclasses.replace(FRAME, **changes))


def update_raw(changes):
    return tracker().update(IMAGE, dataclasses.replace(create(MASKS), **changes))


def run(options):
    given = {"masks": np.zeros((2, 64, 96), int), "progress": False, **options}
    return rj.run(np.stack([IMAGE] * 2), **given)


# What a call is given instead of what it takes.
WRONG = {
    update: [
        *(None, "a", [1, 2], [[1, 2], [3]], object(), rj.Frame(0, 0, 0.0, "x")),
        *(IMAGE[..., 0], IMAGE.astype(float), np.zeros((64, 96, 4), np.uint8)),
        Tensor(IMAGE, "cuda:0"),
    ],
    lambda masks: update(IMAGE, masks): [
        *(None, 5, {1, 2}, "mask", {}),
        *(np.full((1, 64, 96), NAN), np.zeros((1, 32, 32), bool), np.zeros(5, bool)),
        *(np.zeros((1, 1, 64, 96), bool), np.full((64, 96), -1), np.full((64, 96), NAN)),
        *(np.full((64, 96), np.inf), np.zeros((64, 96), complex), np.full((64, 96), "a")),
        *({"mask": MASKS}, {"masks": MASKS, "scores": [1]}, {"masks": MASKS, "labels": ["a"]}),
        *({"masks": MASKS, "scores": [NAN, 1]}, {"masks": MASKS, "class_ids": ["a", "b"]}),
        *({"boxes": [[0, 0, NAN, 1]]}, {"boxes": [0, 1, 2]}, np.zeros((2, 4))),
        {"boxes": Tensor(np.zeros((2, 4)), "cuda:0")},
        ultralytics_results((10, 20), [[0, 0, 4, 4]]),  # of another picture
        [ultralytics_results(SIZE, [[0, 0, 4, 4]])] * 2,  # of two pictures
        ultralytics_results(SIZE, [[0, 0, 4, 4]], np.zeros((4, 4))),
        ultralytics_results(SIZE, [[0, 0, 4, 4]], MASKS),
        *(sam_masks(MASKS, ["a", "b"]), [{"segmentation": None}]),
    ],
    update_raw: [
        {"labels": ("a",)},
        {"scores": np.array([NAN, 1], np.float32)},
        {"masks": np.full((2, 64, 96), NAN)},
    ],
    update_frame: [
        *({"index": "a"}, {"image": "a"}, {"image": IMAGE.astype(float)}, {"detections": "a"}),
        *({"features": np.zeros(3)}, {"features": np.zeros((2, 2, 64), np.float32)}),
        *({"features": "a"}, {"name": 5}, {"time_s": NAN}, {"time_s": "a"}),
    ],
    create: [
        *(None, MASKS[0], "abc", np.full((1, 4, 4), NAN), [[[1, 2], [3]]]),
    ],
    lambda labels: create(MASKS, labels): [
        *("ab", ["a"], 5, [None, None], ["a" * 300, "b"], {"cup", "mug"}, {"cup": 1, "mug": 2}),
    ],
    lambda scores: create(MASKS, scores=scores): [
        *([NAN, 1], [2, 1], [-1, 1], ["a", "b"], [[1, 1]]),
    ],
    lambda ids: create(MASKS, instance_ids=ids): [[0.5, 1], [NAN, 1], "ab", [1], [2**40, 1]],
    lambda rows: create(MASKS).select(rows): [[5], "a", [True], [0.5], [-3]],
    rj.Tracker: [None, 5, [1], "nope", "/tmp", {"a": {"b": {"c": 1}}}],
    lambda backbone: rj.Tracker(backbone=backbone): [None, 5, "zzz"],
    lambda after: rj.Tracker(announce_after=after): [-1, 1.5, "a", NAN],
    lambda size: tracker().warm_up(size): [
        *("a", None, (5,), (-1, 5), (0, 0), (64.5, 96), (99999999, 1), (10**5, 10**5)),
    ],
    lambda num: tracker().warm_up((64, 96), num_objects=num): [-1, "a", 10**12],
    lambda path: tracker().save(path): [None, 5.5],
    lambda path: tracker().load(path): [None, 5.5, "/nope", "/tmp"],
    lambda frame: tracker().prepare(frame): [None, IMAGE],
    lambda prepared: tracker().advance(prepared): [None],
    rj.load_config: [
        *(None, 5, "", {1: 2}, {"decision.new": NAN}, {"base": 5}, {"tracker": ["a"]}),
    ],
    lambda changes: rj.load_config("default").updated(changes): [None, [1]],
    lambda name: rj.load_config("default").with_tracker(name): [5],
    lambda name: rj.load_config("default").for_backbone(name): [5],
    lambda other: rj.load_config("default").difference(other): [5],
    rj.Config.from_reference: [
        *(None, 5, [1], "nope.yaml"),
        {"association": {"scores": {"neighbor_sets": {"context": {"k": NAN}}}}},
        {"memory": {"neighbors": {"force_episode_every_frames": "a"}}},
    ],
    rj.run: [None, 5, "/nope.mp4", [], np.zeros(5)],
    run: [
        *({"masks": None}, {"masks": 5}, {"masks": np.zeros((1, 64, 96), int)}),
        *({"masks": np.full((2, 64, 96), NAN)}, {"masks": np.full((2, 64, 96), -3)}),
        *({"delay": -1}, {"delay": "a"}, {"sampling": 5}, {"sampling": {"fpz": 1}}),
        {"masks": None, "detector": 5},
        {"masks": None, "detector": lambda f: 5},
        {"masks": None, "detector": lambda f: None, "detector_options": 5},
        *({"out": 5}, {"memory": 5}, {"progress": 5}, {"progress": "yes"}, {"overlay": "x"}),
        *({"overlay": 1}, {"trace": "yes"}, {"overwrite": None}, {"resume": 0}, {"on_live": 5}),
        *({"image_fps": NAN}, {"config": 5}, {"metadata": 5}, {"weights": 5}, {"feature_cache": 5}),
        {"foo": 1},
    ],
    rj.open_source: [None, 5, ""],
    lambda fps: rj.Sampling(fps=fps): ["a", 0, NAN],
    lambda stride: rj.Sampling(stride=stride): [0.5],
    lambda settings: rj.sweep("x", settings): [None, "a", [{"decision.new": NAN}]],
    lambda scenes: rj.sweep(scenes, [{}]): [None, [], "/nope"],
    lambda truth: rj.evaluate(truth, truth): [None, 5, "/nope"],
    lambda other: rj.evaluate(result(), other): [5],
    lambda given: rj.compare(given, given): [5, []],
    lambda frame: result().to_supervision(frame): [99, "a"],
    lambda path: result().save(path): [None, 5, "", "a\0b", b"a", []],
    rj.Result.load: ["/nope", None],
    lambda row: result().tracks[0].display_name(row): [99],
    lambda num: rj.Static(num_objects=num): [1.5, None],
    lambda precision: rj.Static(precision=precision): [None],
    rj.get_method: [None],
    rj.stack_scene: ["/nope"],
    lambda setting: rj.sweeps.stack(rj.Config().thresholds, [setting]): [{"matching.mach": 1.0}],
}
MORE = [
    lambda: update(np.zeros((0, 0, 3), np.uint8), None),
    lambda: update(np.zeros((3, 3, 3), np.uint8), np.zeros((0, 3, 3), bool)),
    lambda: rj.Detections.empty(-1, 5),
    lambda: rj.Detections.empty("a", 5),
    lambda: rj.Detections.empty(10**9, 10**9),
    lambda: rj.Tracker(tracker=5),
    lambda: rj.Tracker(trace=1),
    lambda: rj.Tracker(foo=1),
    lambda: calibrate("/nope", nope=1),
    lambda: rj.sweep("/nope", [{}], nope=1),
    lambda: result().explain(0, 0),
    lambda: rj.stack_scene([], num_objects=0),
    lambda: rj.stack_scene([], tracker="bank"),
]


def test_a_bad_call_is_refused_in_one_sentence():
    calls = [(call, (value,)) for call, values in WRONG.items() for value in values]
    wrong = []
    for call, values in [*calls, *((call, ()) for call in MORE)]:
        name = f"line {call.__code__.co_firstlineno}" if hasattr(call, "__code__") else call
        name = f"{name} of {values!r:.60}"
        try:
            call(*values)
            wrong.append(f"{name}: goes through")
        except RemindError as error:
            said = str(error)
            if not said or "\n" in said or len(said) >= 700:
                wrong.append(f"{name}: {said}")
        except Exception as error:
            wrong.append(f"{name}: {error!r}")
    assert not wrong, "\n".join(wrong)


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
def test_a_second_thread_is_refused_and_nothing_is_damaged(part, tmp_path):
    live, alone = rj.Tracker(), rj.Tracker()
    seen, path = create(MASKS, ["a", "b"]), tmp_path / "memory.safetensors"
    live.update(IMAGE, seen)
    live.save(path)
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
    calls = [lambda: live.update(IMAGE, seen), live.reset, lambda: live.load(path)]
    if part == "advance":
        calls += [lambda: live.save(path), lambda: live.checkpoint(path), live.objects]
        calls += [lambda: live.rename(0, "mug"), lambda: live.num_objects]
    for call in calls:
        with pytest.raises(RemindError, match="two threads at once"):
            call()
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
