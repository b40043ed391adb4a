"""Trackers by name, and that a run needs nothing else of them."""

import dataclasses
import functools
import pickle

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import remind_jax as rj
from remind_jax import method as methods
from remind_jax.backbone.registry import Backbone
from remind_jax.config import load_config
from remind_jax.decision import NO_ID, Decisions, Outcome, Overflow, no_decisions
from remind_jax.errors import ConfigError, RemindError, SourceError
from remind_jax.frame import Frame
from remind_jax.masks.reduction import reduce_masks
from remind_jax.method import Method, Needs, get_method, list_methods, register_method
from remind_jax.observation import FrameFeats
from remind_jax.session import live
from remind_jax.static import Static

SIDE = 64


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Numbers:
    first_id: int = 0


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Slots:
    id: jax.Array


@jax.tree_util.register_dataclass
@dataclasses.dataclass(frozen=True)
class Counter:
    """Gives every detection a new id; shift is the last thing observed."""

    objects: Slots
    next_id: jax.Array
    frame: jax.Array
    decisions: Decisions
    overflow: Overflow
    shift: jax.Array


def empty(static: Static) -> Counter:
    return Counter(
        Slots(jnp.full(static.num_objects, NO_ID)),
        jnp.int32(0),
        jnp.int32(0),
        no_decisions(static),
        Overflow(jnp.int32(0), jnp.int32(0)),
        jnp.zeros(2),
    )


def count(state, seen, *, static, thresholds):
    masks, observed = seen.masks, seen.observed
    used = jnp.sum(state.objects.id != NO_ID)
    rank = jnp.cumsum(masks.valid) - 1
    ids = jnp.where(masks.valid, thresholds.first_id + used + rank, NO_ID)
    needed = used + jnp.sum(masks.valid)
    fits = needed <= static.num_objects
    slot = jnp.where(masks.valid, used + rank, static.num_objects)
    decisions = dataclasses.replace(
        no_decisions(static),
        outcome=jnp.where(masks.valid, int(Outcome.NEW), int(Outcome.EMPTY)),
        object_id=ids,
    )
    after = Counter(
        Slots(state.objects.id.at[slot].set(ids, mode="drop")),
        jnp.maximum(state.next_id, jnp.max(ids) + 1).astype(jnp.int32),
        state.frame + 1,
        decisions,
        state.overflow,
        observed["shift"],
    )
    kept = jax.tree.map(lambda new, old: jnp.where(fits, new, old), after, state)
    short = Overflow(jnp.where(fits, 0, needed), jnp.int32(0))
    return dataclasses.replace(kept, overflow=short), None


def observe(previous, image, elapsed_s):
    del elapsed_s
    moved = 0.0 if previous is None else float(image.mean()) - float(previous.mean())
    return {"shift": np.full(2, moved, np.float32)}


@pytest.fixture
def counter(monkeypatch):
    monkeypatch.setattr(methods, "_methods", dict(methods._methods))
    method = Method("counter", Numbers, empty, count, needs=Needs(observe=observe))
    register_method(method)
    return method


def picture(level: int) -> np.ndarray:
    return np.full((SIDE, SIDE, 3), level, np.uint8)


def two_masks() -> np.ndarray:
    masks = np.zeros((2, SIDE, SIDE), bool)
    masks[0, 8:24, 8:24] = masks[1, 32:56, 32:56] = True
    return masks


def test_a_method_runs_observes_grows_and_comes_back(counter, tmp_path):
    config = load_config({"tracker": "counter", "static": {"num_objects": 2}})
    tracker = live.Tracker(config.updated({"thresholds": {"first_id": 10}}))
    ids = [tracker.update(picture(level), two_masks()).object_id.tolist() for level in (50, 53, 53)]
    assert ids == [[10, 11], [12, 13], [14, 15]]
    assert tracker.static.num_objects == 8
    assert tracker.num_objects == 6
    np.testing.assert_array_equal(tracker.state.shift, [0, 0])
    tracker.update(picture(60), two_masks())
    np.testing.assert_array_equal(tracker.state.shift, [7, 7])

    tracker.save(tmp_path / "memory")
    again = live.Tracker(config)
    again.load(tmp_path / "memory")
    assert again.num_objects == 8
    np.testing.assert_array_equal(again.state.objects.id, tracker.state.objects.id)
    with pytest.raises(RemindError, match="memory of tracker 'counter', not 'plus'"):
        live.Tracker().load(tmp_path / "memory")


def test_choosing_a_tracker_chooses_its_thresholds(counter):
    config = load_config("default").with_tracker("counter")
    assert config.thresholds == Numbers()
    assert config.input == load_config("default").input
    assert config.with_tracker("remind").thresholds == load_config("remind").thresholds
    assert live.Tracker(tracker="counter").config == config
    with pytest.raises(ConfigError, match=r"thresholds\.matching"):
        config.updated({"thresholds": {"matching": {"match": 0.5}}})
    assert ("tracker", "counter", "plus") in config.difference(load_config("default"))


def test_a_method_without_explanations_cannot_be_traced(counter):
    with pytest.raises(ConfigError, match="'counter' does not explain"):
        live.Tracker(tracker="counter", trace=True)


def register_like(counter, **changed) -> live.Tracker:
    register_method(dataclasses.replace(counter, **changed))
    return live.Tracker(tracker="counter")


def test_what_no_program_can_be_kept_for_is_no_function_of_a_method(counter):
    @dataclasses.dataclass
    class Rule:
        def __call__(self, *given, **options):
            return count(*given, **options)

    for rule in (Rule(), "count"):
        with pytest.raises(
            ConfigError, match=r"'decide' of tracker 'counter' is .*give a function"
        ):
            register_like(counter, decide=rule)


def test_settings_may_hold_what_is_no_threshold(counter):
    @jax.tree_util.register_dataclass
    @dataclasses.dataclass(frozen=True)
    class Moded(Numbers):
        mode: str = dataclasses.field(default="x", metadata={"static": True})

    register_like(counter, settings=Moded)
    config = load_config({"tracker": "counter", "thresholds": {"first_id": 3}})
    assert live.Tracker(config).config.thresholds == Moded(first_id=3)


def test_a_memory_that_comes_back_in_another_shape_is_refused(counter):
    def turn(state, seen, **options):
        after, trace = count(state, seen, **options)
        return dataclasses.replace(after, shift=after.shift[None]), trace

    register_method(dataclasses.replace(counter, name="turned", decide=turn))
    with pytest.raises(ConfigError, match=r"another structure or shapes.*'shift' is not \[2\]"):
        live.Tracker(tracker="turned").update(picture(50), two_masks())
    alone = dataclasses.replace(counter, name="alone", decide=lambda state, *_, **__: state)
    register_method(alone)
    with pytest.raises(ConfigError, match="return a pair: the memory"):
        live.Tracker(tracker="alone").update(picture(50), two_masks())


@pytest.mark.parametrize(
    ("shift", "said"),
    [(np.full(2, np.inf, np.float32), "not finite"), (jnp.zeros(2, jnp.bfloat16), "type bfloat16")],
)
def test_an_empty_memory_that_no_file_could_hold_is_refused(counter, shift, said):
    def start(static):
        return dataclasses.replace(empty(static), shift=shift)

    tracker = register_like(counter, init=start)
    for _ in range(2):
        with pytest.raises(ConfigError, match=rf"leaf 'shift'.*counter.*{said}"):
            tracker.update(picture(50), two_masks())


def test_where_own_code_fails_the_memory_before_stays(counter):
    fails = []

    def check(level):
        if fails:
            raise RuntimeError("lost its way")
        return level

    def decide(state, seen, **options):
        after, trace = count(state, seen, **options)
        frame = jax.pure_callback(check, jax.ShapeDtypeStruct((), jnp.int32), after.frame)
        return dataclasses.replace(after, frame=frame), trace

    decide.__qualname__ = count.__qualname__
    tracker = register_like(counter, decide=decide)
    tracker.update(picture(50), two_masks())
    fails.append(True)
    with pytest.raises(Exception, match="lost its way"):
        tracker.update(picture(50), two_masks())
    fails.clear()
    assert tracker.update(picture(50), two_masks()).object_id.tolist() == [2, 3]


def test_a_frame_that_cannot_be_read_back_leaves_the_memory_before(counter, monkeypatch):
    tracker = live.Tracker(tracker="counter")
    tracker.update(picture(50), two_masks())

    def fail(tree):
        raise jax.errors.JaxRuntimeError("lost")

    with monkeypatch.context() as lost:
        lost.setattr(jax, "device_get", fail)
        with pytest.raises(jax.errors.JaxRuntimeError, match="lost"):
            tracker.update(picture(50), two_masks())
    assert tracker.update(picture(50), two_masks()).object_id.tolist() == [2, 3]


def test_wrong_names_are_refused(counter):
    with pytest.raises(ConfigError, match=r"no tracker 'remnd'.*'remind'"):
        get_method("remnd")
    for taken in (
        dataclasses.replace(counter, decide=get_method("iou").decide),
        dataclasses.replace(counter, name="default"),
        dataclasses.replace(get_method("iou"), describe=empty),
    ):
        with pytest.raises(ConfigError, match="registered already"):
            register_method(taken)
    with pytest.raises(ConfigError, match="has a name"):
        register_method(dataclasses.replace(counter, name=""))
    with pytest.raises(ConfigError, match="'zz' are of type dict; give a dataclass"):
        register_method(dataclasses.replace(counter, name="zz", settings=dict))
    no_pytree = dataclasses.make_dataclass("NoPytree", ["first_id"], frozen=True)
    with pytest.raises(ConfigError, match=r"of type NoPytree; give a dataclass that is a pytree"):
        register_method(dataclasses.replace(counter, name="zz", settings=lambda: no_pytree(0)))
    again = dataclasses.replace(counter)
    register_method(again)  # a notebook cell that is run twice
    assert get_method("counter") is again
    assert list_methods()[0] == load_config().tracker == "plus"


@pytest.fixture(
    params=[
        "iou",  # quick to compile
        pytest.param("plus", marks=pytest.mark.slow),
        pytest.param("remind", marks=pytest.mark.slow),
    ]
)
def counted(request, monkeypatch):
    """A method with something around each half of its step, and how often that was called."""
    monkeypatch.setattr(methods, "_methods", dict(methods._methods))
    inner, calls = get_method(request.param), {"describe": 0, "decide": 0}

    def around(half):
        def count():
            calls[half] += 1

        def call(*args, **options):
            jax.debug.callback(count)
            return getattr(inner, half)(*args, **options)

        return call

    halves = {half: around(half) for half in calls}
    register_method(dataclasses.replace(inner, name="counted", **halves))
    return calls


def called(calls):
    jax.effects_barrier()
    return calls["describe"], calls["decide"]


def scene_of_squares():
    """Two squares of different colors that stand still."""
    image = picture(90)
    for mask, color in zip(two_masks(), ((220, 40, 20), (20, 60, 220)), strict=True):
        image[mask] = color
    return [(image, rj.Detections.create(two_masks(), instance_ids=[1, 2])) for _ in range(3)]


def test_what_is_around_a_method_is_called_once_a_frame_live(counted):
    tracker = live.Tracker(tracker="counted")
    for image, detections in scene_of_squares():
        tracker.update(image, detections)
    assert called(counted) == (3, 3)


@pytest.mark.parametrize(
    "counted", ["iou", pytest.param("plus", marks=pytest.mark.heavy)], indirect=True
)
def test_what_is_around_a_method_is_called_once_a_frame_in_a_run(counted):
    assert rj.run(scene_of_squares(), tracker="counted").complete
    assert called(counted) == (3, 3)


def test_what_is_around_a_method_is_called_once_a_frame_and_setting_in_a_sweep(counted):
    found = rj.sweep([scene_of_squares()], [{}], config={"tracker": "counted"})
    assert len(found.rows) == 1
    describes, decides = called(counted)
    assert describes == 3
    # Frames are filled up to a round number with such as hold nothing.
    assert decides >= 3


def test_what_is_around_a_method_is_called_once_a_frame_alone(counted, request):
    method = get_method("counted")
    scene = rj.stack_scene(scene_of_squares(), {"tracker": "counted"}, num_objects=16)

    @jax.jit
    def follow(settings):
        def advance(state, frame):
            state = method.step(state, *frame, static=scene.static, thresholds=settings)
            return state, state.decisions.object_id

        return jax.lax.scan(advance, method.init(scene.static), scene.frames)[1]

    found = np.sort(follow(scene.settings)).tolist()
    # With published thresholds two such squares are too alike to be known again.
    num_known = 1 if request.node.callspec.params["counted"] == "remind" else 3
    assert found[:num_known] == [[0, 1]] * num_known
    assert called(counted) == (3, 3)


def test_a_scene_without_a_finite_feature_is_refused():
    def overflow(images):
        return np.full((len(images), *(side // 16 for side in images.shape[1:3]), 4), np.nan)

    overflowing = Backbone("overflowing", patch_px=16, dim=4, apply=overflow)
    with pytest.raises(SourceError, match=r"not one feature of .* is a finite number"):
        rj.stack_scene(scene_of_squares(), backbone=overflowing)


def test_a_memory_or_frame_of_other_capacities_is_refused_in_a_step():
    method, scene = get_method("iou"), rj.stack_scene(scene_of_squares(), {"tracker": "iou"})
    frame = jax.tree.map(lambda leaf: leaf[0], scene.frames)

    def step(state, **other):
        return method.step(state, *frame, static=dataclasses.replace(scene.static, **other))

    state = method.init(scene.static)
    for num in (32, 128):
        with pytest.raises(ConfigError, match=rf"'objects.id' is not \[{num}\]; .*enlarge"):
            step(state, num_objects=num)
    small = dataclasses.replace(scene.static, num_objects=8)
    with pytest.raises(ConfigError, match=r"'objects.id' is \[64\], .* room for \[8\]"):
        method.enlarge(state, small)
    with pytest.raises(ConfigError, match=r"2 detection slots, static\.num_detections is 4"):
        step(state, num_detections=4)
    step(state, feature_dim=8)  # keeps none
    bank = get_method("bank")
    for dim in (0, 8):
        static = bank.static(num_detections=2, feature_dim=dim)
        with pytest.raises(ConfigError, match=rf"\d+ numbers, static\.feature_dim is {dim}"):
            bank.step(bank.init(static), *frame, static=static)
    with pytest.raises(ConfigError, match="not made by tracker 'iou'"):
        step(bank.init(scene.static))


def test_a_step_without_what_is_observed_is_one_of_a_frame_without_an_image():
    method = get_method("plus")
    static = method.static(num_detections=2, num_objects=4, num_pending=2, feature_dim=8)
    feats = FrameFeats(np.zeros((3, 4, 8), np.float32), np.array([48, 64], np.int32))
    masks = reduce_masks(
        np.zeros((0, 48, 64), bool), np.zeros(0, np.int32), np.zeros(0), num_slots=2, patch_px=16
    )
    state = method.init(static)
    shape = jax.eval_shape(functools.partial(method.step, static=static), state, feats, masks)
    assert jax.tree.structure(shape) == jax.tree.structure(state)


def test_a_scene_whose_features_change_their_shape_is_refused():
    frames = [
        Frame(i, i, 0.0, f"{i}", image, features=np.ones((4, 4, 3 + i), np.float32))
        for i, (image, _) in enumerate(scene_of_squares()[:2])
    ]
    frames = [
        dataclasses.replace(frame, detections=rj.Detections.create(two_masks())) for frame in frames
    ]
    with pytest.raises(SourceError, match=r"frame '1' .* are \[4, 4, 4\], .* first \[4, 4, 3\]"):
        rj.stack_scene(frames)


def test_capacities_may_be_counted_by_numpy():
    static = Static(num_objects=np.int64(8))  # pyright: ignore[reportArgumentType]
    assert repr(static) == repr(Static(num_objects=8))


@pytest.mark.parametrize("name", list_methods())
def test_a_method_can_be_sent_to_another_process(name):
    assert pickle.loads(pickle.dumps(get_method(name))).decide is get_method(name).decide


def test_a_method_is_what_a_configuration_of_its_name_runs():
    assert get_method("default") is get_method("plus")
    assert get_method("published") is get_method("remind")
    assert load_config("default").thresholds == get_method("default").settings()
    assert load_config("published").thresholds == get_method("published").settings()


@pytest.mark.parametrize("name", list_methods())
def test_a_frame_waits_for_no_program_when_memory_grows_or_its_ids_are_read(name, caplog):
    method = get_method(name)
    # Capacities that no other test uses: nothing is compiled for them yet.
    small = method.static(num_objects=19, num_pending=11, num_detections=7, feature_dim=5)
    large = dataclasses.replace(small, num_objects=23)
    state = method.init(small)
    method.init(large)  # as whoever prepares the programs does
    with jax.log_compiles():
        assert method.known_ids(state) == set()
        assert method.known_ids(method.enlarge(state, large)) == set()
        assert not caplog.records
        jax.jit(lambda ids: ids + 17)(state.next_id)  # what would be seen
    assert caplog.records
