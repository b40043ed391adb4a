"""Objects at rest: copied both ways without loss, and found again by their looks."""

import dataclasses
import types

import chex
import jax
import numpy as np
import pytest
from safetensors.numpy import load_file

import remind_jax as rj
from benchmarks.building import PER_PLACE, STAY, Building
from remind_jax.errors import ConfigError
from remind_jax.plus.archive import MAX_PARTNERS, Archive
from remind_jax.plus.look_index import LookIndex, Owner, Whitener
from remind_jax.plus.recall import ObjectsAtRest, _names_of
from remind_jax.plus.state import UNRELATED, init
from remind_jax.plus.whitening import class_offset, whiten
from remind_jax.static import Static
from tests.plus.frames import detections

STATIC = Static(num_detections=4, num_objects=32, feature_dim=6)
EMPTY = jax.device_get(init(STATIC))
CENTER = np.array([2.0, 1.5], np.float32)
SMALL = {"static": {"num_detections": 16, "num_objects": 64}}


def remembered(num=30):
    """A memory of host arrays in which every object is another one and all are related."""
    rng = np.random.default_rng(0)
    state = jax.tree.map(np.array, EMPTY)
    objects, pairs = state.objects, state.pairs
    objects.id[:num], objects.class_id[:num] = 3 * np.arange(num), np.arange(num) % 3
    for name in ("seen", "last", "visits", "ring_count"):
        getattr(objects, name)[:num] = rng.integers(1, 90, num)
    for name in ("size", "speed", "ring", "position"):
        leaf = getattr(objects, name)
        leaf[:num] = rng.random(leaf[:num].shape)
    slots = objects.bank_count.shape[1]
    count = rng.integers(1, slots + 1, num)
    objects.bank_count[:num] = np.arange(slots) < count[:, None]
    objects.bank[:num] = rng.normal(size=objects.bank[:num].shape) * (
        objects.bank_count[:num, :, None] > 0
    )
    together = rng.integers(1, 50, (num, num)).astype(np.float32)
    pairs.covisible[:num, :num] = np.triu(together, 1) + np.triu(together, 1).T
    pairs.covisible[range(num), range(num)] = objects.seen[:num]
    offset, ratio = rng.normal(size=(num, num, 2)), rng.normal(size=(num, num))
    pairs.relation[:num, :num] = offset - offset.swapaxes(0, 1)
    pairs.log_ratio[:num, :num] = ratio - ratio.T
    spread = rng.random((num, num))
    pairs.spread[:num, :num] = spread + spread.T
    pairs.spread[range(num), range(num)] = UNRELATED
    scene = dataclasses.replace(
        state.scene, within_weight=np.float32(50), white_mean=rng.normal(size=6).astype("f4")
    )
    next_id = np.int32(3 * num)
    return dataclasses.replace(state, objects=objects, pairs=pairs, scene=scene, next_id=next_id)


def by_id(state):
    """What is known of each object but its place, and of each pair, whatever slots they lie in."""
    objects, pairs = state.objects, state.pairs
    rows = np.flatnonzero(objects.id >= 0)
    rows = rows[np.argsort(objects.id[rows])]
    own = {
        field.name: getattr(objects, field.name)[rows]
        for field in dataclasses.fields(objects)
        if field.name not in ("position", "white_bank")
    }
    of_pairs = {
        field.name: getattr(pairs, field.name)[np.ix_(rows, rows)]
        for field in dataclasses.fields(pairs)
        if field.name != "covariance"
    }
    return own | of_pairs


def restored(tensors, state, num_classes=3):
    archive = Archive()
    archive.restore([tensors], state, num_classes)
    return archive


def test_rest_and_return_lose_nothing_but_the_place():
    num = MAX_PARTNERS + 1  # all others are partners of each
    state = remembered(num)
    archive = Archive()
    rested = archive.rest_slots(state, EMPTY, range(3, 20))
    assert (rested.objects.id >= 0).sum() == num - 17
    assert sorted(archive.ids()) == state.objects.id[3:20].tolist()
    np.testing.assert_array_equal(rested.pairs.covisible[3:20], 0)
    for order in (sorted(archive.ids()), sorted(archive.ids(), reverse=True)):
        woken = archive.wake(rested, order, CENTER)
        assert sorted(archive.ids()) == sorted(order)
        archive.drop_present(woken)
        assert not len(archive)
        for name, leaf in by_id(woken).items():
            np.testing.assert_array_equal(leaf, by_id(state)[name], name)
        slots = [woken.objects.id.tolist().index(one) for one in order]
        rested = archive.rest_slots(woken, EMPTY, slots)


def test_bytes_are_those_of_rows_partners_and_looks():
    archive = Archive()
    assert archive.num_bytes() == 0
    archive.rest_slots(remembered(20), EMPTY, range(12))
    tensors = archive.tensors()
    not_counted = ("num_", "partners_of", "whitener.")
    kept = sum(one.nbytes for name, one in tensors.items() if not name.startswith(not_counted))
    looks, white = len(tensors["bank"]), EMPTY.scene.whitener.shape[0]
    assert archive.num_bytes() == kept + looks * 4 * (white + 1)


def test_relations_outlast_a_rest_of_either_object():
    state = remembered(6)
    archive = Archive()
    state_without = archive.rest_slots(archive.rest_slots(state, EMPTY, [0]), EMPTY, [1])
    tensors = archive.tensors()
    for order in ((3, 0), (0, 3)):
        archive = restored(tensors, state_without)
        both = state_without
        for one in order:
            both = archive.wake(both, [one], CENTER)
            archive.drop_present(both)
        for name, leaf in by_id(both).items():
            np.testing.assert_array_equal(leaf, by_id(state)[name], name)
        # What both learned of each other since then is what both know after another rest.
        slots = [both.objects.id.tolist().index(one) for one in order]
        for at, sign in ((slots, 1), (slots[::-1], -1)):
            both.pairs.covisible[*at] += 9
            both.pairs.relation[*at] = sign
        later = both
        for slot in slots:
            later = archive.rest_slots(later, EMPTY, [slot])
        for name, leaf in by_id(archive.wake(later, order, CENTER)).items():
            np.testing.assert_array_equal(leaf, by_id(both)[name], name)


def holding(slots_of_rows):
    """The memory with tracklets in these rows, each of an object."""
    state = remembered()
    rows = [*slots_of_rows]
    state.tracklets.alive[rows] = True
    state.tracklets.slot[rows] = [*slots_of_rows.values()]
    state.tracklets.age[rows] = rows
    return state


def test_a_memory_shrinks_to_what_is_in_use_and_others_rest():
    state, at_rest = holding({0: 20, 1: 3, 9: 29}), ObjectsAtRest()
    smaller = dataclasses.replace(STATIC, num_detections=2, num_objects=16)
    shrunk = at_rest.shrink(state, STATIC, smaller)
    chex.assert_trees_all_equal_shapes_and_dtypes(shrunk, init(smaller))
    assert [*np.flatnonzero(shrunk.tracklets.alive)] == [0, 1, 2]
    assert shrunk.tracklets.age[:3].tolist() == [0, 1, 9]
    assert shrunk.objects.id[shrunk.tracklets.slot[:3]].tolist() == [60, 9, 87]
    present = sorted(shrunk.objects.id[shrunk.objects.exists])
    assert len(present) == 14  # and room for others
    assert sorted([*present, *at_rest.ids()]) == state.objects.id[:30].tolist()
    stays = np.isin(state.objects.id[:30], present)
    for name, leaf in by_id(shrunk).items():
        before = by_id(state)[name]
        is_of_pairs = name not in {field.name for field in dataclasses.fields(state.objects)}
        expected = before[np.ix_(stays, stays)] if is_of_pairs else before[stays]
        np.testing.assert_array_equal(leaf, expected, name)


@pytest.mark.parametrize(
    ("num_waiting", "capacities"),
    [(7, {"num_detections": 2}), (6, {"num_detections": 2, "num_objects": 4})],
    ids=["tracklets", "objects"],
)
def test_a_memory_whose_tracklets_or_objects_have_no_room_does_not_shrink(num_waiting, capacities):
    state, at_rest = holding({4 + row: row for row in range(num_waiting)}), ObjectsAtRest()
    assert at_rest.shrink(state, STATIC, dataclasses.replace(STATIC, **capacities)) is None
    assert not at_rest.ids()


def test_what_an_open_tracklet_is_answered_as_does_not_rest():
    state = remembered(6)
    state.answers.answer_id[1] = state.objects.id[2]
    rested = ObjectsAtRest().rest(state, STATIC, 6)
    assert rested.objects.id[rested.objects.id >= 0].tolist() == [state.objects.id[2]]


def full_memory():
    """A memory without a free slot, all alike and far away but one, which rests first; its slot."""
    state = dataclasses.replace(remembered(STATIC.num_objects), frame=np.int32(100))
    state.scene.white_mean[:], state.objects.position[:] = 0.0, 100.0
    state.objects.bank[..., :] = np.eye(6)[0]
    longest = int(np.argmin(state.objects.last))
    state.objects.bank[longest] = np.eye(6)[1]
    state.objects.white_bank[:] = state.objects.bank
    return state, longest


def frame_with(looks, class_ids):
    return types.SimpleNamespace(
        sightings=detections(np.zeros((len(looks), 2)), looks, class_id=np.array(class_ids)),
        motion=types.SimpleNamespace(matrix=np.eye(2, 3)),
    )


@pytest.mark.parametrize("class_id", [0, 1], ids=["", "of a class that none at rest has"])
def test_what_looks_like_a_detection_makes_no_room_for_others(class_id):
    (state, longest), others, at_rest = full_memory(), remembered(3), ObjectsAtRest()
    state = dataclasses.replace(state, next_id=np.int32(9 * STATIC.num_objects))
    others.objects.id[:3] += 3 * STATIC.num_objects
    for objects in (state.objects, others.objects):
        objects.class_id[objects.id >= 0] = 0
    state.objects.class_id[longest] = class_id
    others.objects.bank[..., :], others.objects.bank[1] = np.eye(6)[0], np.eye(6)[2]
    at_rest.rest_slots(dataclasses.replace(others, scene=state.scene), EMPTY, range(3))
    recalled = at_rest.recall(state, frame_with(np.eye(6)[1:3], [class_id, 0]), STATIC)
    assert recalled is not None
    now = recalled.objects.id.tolist()
    assert others.objects.id[1] in now
    assert state.objects.id[longest] in now


def test_what_a_frame_shows_rests_last_when_it_needs_room():
    (state, longest), at_rest, num = full_memory(), ObjectsAtRest(), STATIC.num_objects
    seen = frame_with(np.eye(6)[1:2], [state.objects.class_id[longest]])
    rested = at_rest.make_room(state, seen, STATIC, num + 2)
    assert rested is not None
    assert state.objects.id[longest] in rested.objects.id
    assert len(at_rest.ids()) == 2 + num // 8
    assert at_rest.make_room(state, seen, STATIC, 2 * num + 1) is None


def test_search_is_exact_however_looks_came_and_went():
    rng = np.random.default_rng(1)
    leaves = (rng.normal(size=size).astype("f4") for size in ((4, 6), 6, (8, 6)))
    whitener = Whitener(*leaves)
    index, owners = LookIndex(whitener, ticks=0), {}
    for number in range(400):
        looks = rng.normal(size=(rng.integers(1, 9), 6)).astype(np.float32)
        owners[number] = Owner(number, int(rng.integers(0, 3)), looks)
        index.add([owners[number]])
        if number % 3 == 2:
            index.remove(owners.pop(number - int(rng.integers(0, 2))))
    asked = rng.normal(size=(5, 6)).astype(np.float32)
    found, cosine = index.search(asked, np.array([0, 1, 2, 0, 7]), 3)
    for row, one_class in enumerate([0, 1, 2, 0]):
        white = whitener.whiten(asked[row], one_class)
        best = {
            owner.id: float(np.max(whitener.whiten(owner.looks, one_class) @ white))
            for owner in owners.values()
            if owner.class_id == one_class
        }
        expected = sorted(best, key=best.__getitem__, reverse=True)[:3]
        assert found[row].tolist() == expected
        # Sums of another order.
        np.testing.assert_allclose(cosine[row], [best[one] for one in expected], atol=1e-5)
    assert found[4].tolist() == [-1] * 3


def test_an_object_without_looks_rests_as_well():
    state = remembered(3)
    state.objects.bank_count[1] = 0
    archive = Archive()
    rested = archive.rest_slots(state, EMPTY, [1])
    assert archive.wake(rested, archive.ids(), CENTER).objects.bank_count[1].sum() == 0
    archive.rest_slots(state, EMPTY, [1])
    archive.forget([3])
    assert not len(archive)


def test_looks_are_whitened_anew_as_time_goes_on():
    state = remembered(9)
    archive = Archive()
    archive.rest_slots(state, EMPTY, range(5))
    renewed = []
    for ticks in range(0, 4000, 10):
        state.scene.white_mean[:] = ticks  # whatever was learned meanwhile
        index = archive.looks(dataclasses.replace(state, ticks=np.int32(ticks)))
        if index.whitener.mean[0] == ticks:
            renewed.append(ticks)
            assert index.search(state.objects.bank[:5, 0], state.objects.class_id[:5], 9)[0].any()
    waited = np.diff(renewed)
    assert np.all(waited[2:] > np.minimum(renewed[2:-1], 2000) / 2)
    assert np.all(waited <= np.minimum(renewed[:-1], 2000) / 2 + 10)


def test_looks_are_asked_for_under_names_that_change():
    names = np.zeros((8, 8), np.float32)
    names[2, 2], names[3, 3], names[3, 2], names[2, 5] = 100, 100, 9, 1
    asked = _names_of(np.array([2, 3, 7, 5]), {2, 3, 5, 10}, names)
    under = [set(asked[1][asked[0] == look].tolist()) for look in range(4)]
    assert under == [{2, 3}, {2, 3, 10}, set(), {5}]


def test_looks_are_whitened_on_the_host_as_in_the_step():
    rng = np.random.default_rng(2)
    matrix = rng.normal(size=EMPTY.scene.whitener.shape).astype(np.float32)
    mean = rng.normal(size=6).astype(np.float32)
    offset = rng.normal(size=EMPTY.scene.class_offset.shape).astype(np.float32)
    scene = dataclasses.replace(EMPTY.scene, whitener=matrix, white_mean=mean, class_offset=offset)
    looks = rng.normal(size=(5, 6)).astype(np.float32)
    class_id = np.array([0, 3, 3, len(offset) + 1, 95])
    on_host = Whitener.of(scene).whiten(looks, class_id)
    # Sums of another order.
    expected = whiten(scene, looks - class_offset(scene, class_id))
    np.testing.assert_allclose(on_host, expected, atol=1e-5)


@pytest.mark.slow
def test_a_bound_below_the_working_set_holds_out_of_view(building):
    tracker = rj.Tracker(config={"input": {"max_objects": 20}})
    told = walk(tracker, building, range(4))
    assert tracker.num_objects <= 20
    assert walk(tracker, building, (3,), start=60) == [told[3]]


@pytest.fixture(scope="module")
def building():
    return Building(11 * PER_PLACE, noise=0.05, one_class=False, seed=3)


def walk(tracker, building, places, start=0):
    """Visits places one after the other; the answers at the end of each visit, by true object."""
    told = []
    frames = [place for place in places for _ in range(STAY)]
    for number, place in enumerate(frames):
        frame = building.frame(start + number, place)
        tracks = tracker.update(frame)
        if number % STAY == STAY - 1:
            truth = frame.detections.instance_ids.tolist()
            told.append(dict(zip(truth, tracks.object_id.tolist(), strict=True)))
    return told


def test_what_rested_is_known_again_and_no_program_grows(building, tmp_path):
    tracker = rj.Tracker(config=SMALL)
    first = walk(tracker, building, range(8))
    assert tracker.static.num_objects == 64
    assert tracker.num_objects == 8 * PER_PLACE == len(tracker.objects())
    use = tracker.memory_use
    assert (use.objects, use.objects - use.working_set) == (8 * PER_PLACE, use.at_rest)
    assert 0 < use.working_set <= 64
    again = walk(tracker, building, (2, 6), start=80)
    assert again == [first[2], first[6]]
    tracker.save(tmp_path / "memory.safetensors")
    other = rj.Tracker(config=SMALL)
    other.load(tmp_path / "memory.safetensors")
    assert {one.object_id for one in other.objects()} == {
        one.object_id for one in tracker.objects()
    }
    frames = [building.frame(100 + n, place) for n, place in enumerate((0,) * STAY + (7,) * STAY)]
    for frame in frames:
        assert tracker.update(frame).object_id.tolist() == other.update(frame).object_id.tolist()
    # A run that was resumed knows what one that was never stopped knows, wherever it lies.
    for one, name in ((tracker, "through"), (other, "resumed")):
        one.save(tmp_path / name)
    kept = [load_file(tmp_path / name) for name in ("through", "resumed")]
    for name, leaf in kept[0].items():
        np.testing.assert_array_equal(leaf, kept[1][name], name)
    gone = first[3][3 * PER_PLACE]
    other.forget(gone)
    assert gone not in {one.object_id for one in other.objects()}
    (now,) = walk(other, building, (3,), start=100)
    assert now[3 * PER_PLACE] not in {one for visit in first for one in visit.values()}


def test_a_file_whose_objects_at_rest_do_not_belong_together_is_refused(tmp_path):
    archive = Archive()
    state = archive.rest_slots(remembered(9), EMPTY, range(5))
    tensors = archive.tensors()
    earlier = {name: tensor for name, tensor in tensors.items() if name != "class_lead"}
    snapshot = restored(earlier, state).snapshot()
    leads = [int(one.values["class_lead"]) for one in snapshot.resting.values()]
    assert leads == tensors["seen"].tolist()
    for name, tensor in earlier.items():
        with pytest.raises((ValueError, KeyError)):
            restored({**tensors, name: tensor[1:]}, state)
        lacking = {key: one for key, one in tensors.items() if key != name}
        with pytest.raises(KeyError):
            restored(lacking, state)
    assert len(restored(tensors, state)) == 5


def test_what_is_seen_least_is_forgotten_beyond_a_bound(building):
    bound = {"static": {"num_detections": 16, "num_objects": 64}, "input": {"max_objects": 100}}
    tracker = rj.Tracker(config=bound)
    told, events = walk(tracker, building, range(10)), []
    assert tracker.num_objects <= 100
    frame = building.frame(100, 10)
    while not events:
        tracker.update(frame)
        events = tracker.events
        frame = dataclasses.replace(frame, index=frame.index + 1)
    assert {one.kind for one in events} == {"forgotten"}
    assert "more than 100 were known" in events[0].message
    assert events[0].message.startswith(f"{len(events[0].objects)} objects forgotten")
    assert walk(tracker, building, (9,), start=150) == [told[9]]
    # What is in view is not forgotten, and nothing is told where nothing goes.
    few = rj.Tracker(config={**bound, "input": {"max_objects": PER_PLACE - 2}})
    for number in range(STAY):
        few.update(building.frame(number, 0))
        assert not few.events
    assert few.num_objects == PER_PLACE
    with pytest.raises(ConfigError, match="forgets no objects"):
        rj.Tracker(config={"input": {"max_objects": 3}}, tracker="bank")


@pytest.mark.parametrize("name", ["wake", "rest_slots"])
def test_ctrl_c_while_objects_wake_or_rest_loses_none(name, monkeypatch, tmp_path):
    building = Building(10 * PER_PLACE, noise=0.05, one_class=False, seed=3)
    tracker = rj.Tracker(config=SMALL)
    told = [one for visit in walk(tracker, building, range(10)) for one in visit.values()]
    change = getattr(Archive, name)

    def stop(*given):
        change(*given)
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(Archive, name, stop)
        with pytest.raises(KeyboardInterrupt):
            walk(tracker, building, [0], start=200)
    tracker.save(tmp_path / "kept")
    again = rj.Tracker(config=SMALL)
    again.load(tmp_path / "kept")
    assert {one.object_id for one in again.objects()} == {*told}
    assert walk(again, building, [0], start=200) == walk(tracker, building, [0], start=200)


def test_ctrl_c_while_objects_go_leaves_no_looks_without_an_object(monkeypatch):
    building = Building(10 * PER_PLACE, noise=0.05, one_class=False, seed=3)
    tracker = rj.Tracker(config=SMALL)
    walk(tracker, building, range(10))

    def stop(*_):
        raise KeyboardInterrupt

    with monkeypatch.context() as patched:
        patched.setattr(LookIndex, "remove", stop)
        with pytest.raises(KeyboardInterrupt):
            walk(tracker, building, range(10), start=200)
    walk(tracker, building, range(10), start=300)
