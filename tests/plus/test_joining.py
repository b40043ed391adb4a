"""Two memories become one: what both know is found, what is not clear stays apart."""

import dataclasses
import itertools

import jax
import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

import remind_jax as rj
from benchmarks.building import PER_PLACE, STAY, Building
from remind_jax.errors import ConfigError, RemindError, SourceError
from remind_jax.method import Joining
from remind_jax.plus import memory_matching
from remind_jax.plus.joining import join
from remind_jax.plus.memory_matching import NOBODY
from remind_jax.plus.recall import ObjectsAtRest
from remind_jax.plus.state import init, no_tracklets
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.static import Static
from tests.plus.test_archive import by_id, restored, walk

DIM, SEEN = 32, 20
STATIC = Static(num_detections=4, num_objects=16, feature_dim=DIM)
CONFIG = {"static": {"num_detections": 16, "num_objects": 64}}  # as in test_archive
ONE_CLASS = np.zeros(1, int)
LOOKS = np.linalg.qr(np.random.default_rng(0).normal(size=(DIM, DIM)))[0].astype(np.float32)
LENGTHS = (1.0 + one / 4096 for one in itertools.count())  # no two looks are the same


def memory(*groups, next_id=40):
    """Objects by the numbers of their looks; those of a group were always seen together.

    A group is a mapping of ids to looks; its objects lie in a row, in this order.
    """
    state = jax.tree.map(np.array, jax.device_get(init(STATIC)))
    objects, pairs = state.objects, state.pairs
    slot = 0
    for group in groups:
        slots = np.arange(slot, slot + len(group))
        for one, look in group.items():
            objects.id[slot], objects.class_id[slot], objects.seen[slot] = one, 0, SEEN
            objects.last[slot], objects.visits[slot], objects.size[slot] = 30, 1, 1.0
            objects.bank[slot, 0] = next(LENGTHS) * LOOKS[look]
            objects.bank_count[slot, 0] = SEEN
            slot += 1
        square = np.ix_(slots, slots)
        pairs.covisible[square] = SEEN
        pairs.relation[square] = 2.0 * (slots[None, :, None] - slots[:, None, None])
        pairs.spread[square] = 0.1
    return dataclasses.replace(state, next_id=np.int32(next_id), frame=np.int32(33))


def leaving(state, ages=(2,), look=2):
    """The memory with open tracklets that look new, of these ages; `look` is that of the first."""
    num = len(ages)
    tracklets = jax.tree.map(np.array, no_tracklets(len(state.tracklets.alive), DIM))
    tracklets.alive[:num], tracklets.leans_new[:num], tracklets.age[:num] = True, True, ages
    tracklets.id[:num], tracklets.class_id[:num] = 6 + np.arange(num), 0
    tracklets.look[0] = LOOKS[look]
    return dataclasses.replace(state, tracklets=tracklets)


def joined(state, other, class_ids=ONE_CLASS):
    at_rest = ObjectsAtRest()
    sides = Joining(state, at_rest, {}), Joining(other, ObjectsAtRest(), {})
    return join(*sides, class_ids, PlusThresholds()), at_rest


def test_nothing_of_this_memory_changes_and_all_of_the_other_comes():
    state = memory({3: 0, 5: 1})
    other = dataclasses.replace(memory({0: 1, 2: 6}, next_id=9), frame=np.int32(133))
    (after, found), at_rest = joined(state, other)
    assert found.ids == {0: 40, 2: 41}
    assert (int(after.next_id), int(after.frame)) == (42, 33)
    for name, leaf in by_id(after).items():
        np.testing.assert_array_equal(leaf, by_id(state)[name], name)
    assert sorted(at_rest.ids()) == [40, 41]
    woken = at_rest.wake(after, [40, 41], np.zeros(2, np.float32))
    slots = [woken.objects.id.tolist().index(one) for one in (40, 41)]
    assert woken.objects.last[slots].tolist() == [-70, -70]  # 103 frames ago
    np.testing.assert_array_equal(woken.objects.bank[slots, 0], other.objects.bank[:2, 0])
    assert woken.pairs.covisible[slots[0], slots[1]] == SEEN
    np.testing.assert_array_equal(woken.pairs.relation[slots[0], slots[1]], [2.0, 2.0])
    assert not woken.pairs.covisible[slots, :2].any()


def test_what_was_not_decided_yet_comes_as_after_its_last_frame():
    other = leaving(memory({0: 1}, next_id=9), ages=(2, 1, 2))
    other.tracklets.leans_new[2] = False
    (_, found), at_rest = joined(memory({3: 2}), other)
    assert found.ids == {0: 40, 6: 41}
    assert found.matched == ((3, 41),)
    assert 41 in at_rest
    assert set(at_rest.snapshot().resting[41].values) == set(at_rest.snapshot().resting[40].values)


def test_a_memory_that_took_in_what_has_no_partners_is_written_and_read():
    (state, _), at_rest = joined(memory({3: 1}), leaving(memory(next_id=9)))
    again = restored(at_rest.tensors(), state, 1)
    assert again.ids() == [40]


@pytest.mark.parametrize("num", [2, 3])
def test_what_looks_like_several_stays_apart_and_is_told(num):
    alike = [{one: 0} for one in range(num)]
    (_, found), _ = joined(memory(*alike), memory({0: 0}))
    assert not found.matched
    assert {one: sorted(known) for one, known in found.ambiguous.items()} == {40: [*range(num)]}
    (_, other_way), _ = joined(memory({0: 0}), memory(*alike))
    assert not other_way.matched
    assert set(other_way.ambiguous) == {*range(40, 40 + num)}


def test_what_stands_beside_them_tells_twins_apart():
    here = memory({0: 0, 1: 1, 2: 2, 3: 3}, {4: 0, 5: 5, 6: 6, 7: 7})
    (_, found), _ = joined(here, memory({0: 0, 1: 5, 2: 6, 3: 7}, {9: 0, 8: 3, 7: 2, 6: 1}))
    known = {4: 0, 5: 1, 6: 2, 7: 3, 0: 9, 3: 8, 2: 7, 1: 6}
    assert dict(found.matched) == {one: found.ids[other] for one, other in known.items()}
    assert not found.ambiguous


def test_a_twin_of_what_stands_elsewhere_is_new():
    here = memory({0: 0, 1: 1, 2: 2, 3: 3, 4: 4}, {5: 8, 6: 9})
    (_, found), _ = joined(here, memory({0: 0, 1: 11, 2: 12, 3: 13, 4: 14}, {5: 8, 6: 9}))
    assert sorted(found.matched) == [(5, 45), (6, 46)]


def test_how_they_lie_tells_twins_of_one_place_apart():
    here = memory({0: 0, 1: 1, 2: 2, 3: 0, 4: 4})
    (_, found), _ = joined(here, memory({0: 0, 1: 1, 2: 2, 3: 0, 4: 4}))
    assert sorted(found.matched) == [(one, 40 + one) for one in range(5)]


def test_what_rests_in_either_memory_is_matched_like_the_others():
    states, at_rest = [memory({0: 0, 1: 1, 2: 2, 3: 0, 4: 4}) for _ in range(2)], []
    for number, slots in enumerate(([0, 1, 3], [1, 2])):
        at_rest.append(ObjectsAtRest())
        empty = memory()
        states[number] = at_rest[-1].rest_slots(states[number], empty, slots)
    this, that = (Joining(one, rest, {}) for one, rest in zip(states, at_rest, strict=True))
    state, found = join(this, that, ONE_CLASS, PlusThresholds())
    assert sorted(found.matched) == [(one, found.ids[one]) for one in range(5)]
    assert sorted(at_rest[0].ids()) == [0, 1, 3, *range(40, 45)]
    assert by_id(state)["id"].tolist() == [2, 4]


@pytest.mark.parametrize("flips", [0, 10])
def test_another_name_counts_as_the_detector_was_seen_to_change_it(flips):
    group = {0: 0, 1: 1, 2: 2, 3: 3}
    state, other = memory(group), memory(group)
    state.scene.names[:2, :2] = [[SEEN, flips], [0, SEEN]]
    (_, found), _ = joined(state, other, class_ids=np.ones(1, int))
    assert len(found.matched) == (len(group) if flips else 0)


def test_nothing_is_known_where_nothing_is_shared():
    first, second = ({one: base + one for one in range(8)} for base in (0, 8))
    (_, found), _ = joined(memory(first), memory(second))
    assert not found.matched
    assert not found.ambiguous
    (_, empty), at_rest = joined(memory(), memory(second))
    assert not empty.matched
    assert len(at_rest.ids()) == len(empty.ids) == 8
    assert not joined(memory(first), memory())[0][1].ids


def test_the_assignment_is_the_best_of_all():
    rng = np.random.default_rng(4)
    for _ in range(30):
        num_m, num_here = rng.integers(1, 9, 2)
        width = int(min(num_here, 4))
        row = np.stack([rng.permutation(num_here)[:width] for _ in range(num_m)])
        odds, new = rng.normal(size=row.shape) * 3, 0.5
        place = memory_matching._assign(odds, row, num_here, new)
        gain = np.full((num_m, num_here + num_m), -1e6)
        np.put_along_axis(gain, row, odds, 1)
        gain[range(num_m), num_here + np.arange(num_m)] = new
        best = gain[linear_sum_assignment(gain, maximize=True)].sum()
        held = place != NOBODY
        assert len(set(row[held, place[held]])) == held.sum()
        assert odds[held, place[held]].sum() + new * (~held).sum() == pytest.approx(best)


def test_two_walks_through_overlapping_places_become_one_memory(tmp_path):
    building = Building(10 * PER_PLACE, noise=0.05, one_class=False, seed=3)
    tracker, second = rj.Tracker(config=CONFIG), rj.Tracker(config=CONFIG)
    places, others = [0, 1, 2, 3, 4, 5, 6], [9, 8, 6, 4, 5]
    told = {one: i for visit in walk(tracker, building, places) for one, i in visit.items()}
    there = {one: i for visit in walk(second, building, others) for one, i in visit.items()}
    with pytest.raises(SourceError, match="before the first frame"):
        rj.Tracker(config=CONFIG).join(tmp_path / "b.safetensors")
    second.rename(there[9 * PER_PLACE], "far")
    tracker.rename(told[6 * PER_PLACE], "shared")
    tracker.save(tmp_path / "a.safetensors")
    second.save(tmp_path / "b.safetensors")
    found = tracker.join(tmp_path / "b.safetensors")
    shared = told.keys() & there.keys()
    assert {(told[one], found.ids[there[one]]) for one in shared} == set(found.matched)
    assert len(shared) == 3 * PER_PLACE
    assert not found.ambiguous
    assert found.num_added == len(others) * PER_PLACE
    assert tracker.num_objects == (len(places) + len(others)) * PER_PLACE
    assert len(tracker.objects()) == 9 * PER_PLACE
    # What only the other saw is known, what both saw has the id that it had here.
    start = STAY * len(places)
    far, near = walk(tracker, building, (9, 4), start=start)
    assert far == {9 * PER_PLACE + k: found.ids[there[9 * PER_PLACE + k]] for k in range(PER_PLACE)}
    assert near == {4 * PER_PLACE + k: told[4 * PER_PLACE + k] for k in range(PER_PLACE)}
    titles = {one.object_id: one.name for one in tracker.objects() if one.name}
    assert titles == {found.ids[there[9 * PER_PLACE]]: "far", told[6 * PER_PLACE]: "shared"}
    tracker.save(tmp_path / "c.safetensors")
    again = rj.Tracker(config=CONFIG)
    again.load(tmp_path / "c.safetensors")
    assert [dataclasses.replace(one, pictures=()) for one in again.objects()] == [
        dataclasses.replace(one, pictures=()) for one in tracker.objects()
    ]
    assert walk(again, building, (8,), start=200) == [
        {8 * PER_PLACE + k: found.ids[there[8 * PER_PLACE + k]] for k in range(PER_PLACE)}
    ]
    kept, gone = found.matched[0]
    assert again.split(kept) == (gone,)
    assert len(again.objects()) == 9 * PER_PLACE + 1


def test_memories_that_are_joined_every_night_do_not_grow_by_copies(tmp_path):
    building = Building(4 * PER_PLACE, noise=0.05, one_class=False, seed=3)
    trackers = [rj.Tracker(config=CONFIG), rj.Tracker(config=CONFIG)]
    for tracker, places in zip(trackers, ([0, 1, 2], [3, 2, 1]), strict=True):
        walk(tracker, building, places)
    sizes = []
    for _ in range(3):
        for tracker in trackers:
            tracker.save(tmp_path / "given")
            other = trackers[1 - trackers.index(tracker)]
            found = other.join(tmp_path / "given")
            assert not found.ambiguous
            assert len(other.objects()) == 4 * PER_PLACE
        sizes.append(
            [
                (one.num_objects, int(one.state.next_id), one.identities.records.session)
                for one in trackers
            ]
        )
    assert sizes[0] == sizes[1] == sizes[2]
    assert max(sizes[0])[0] == 6 * PER_PLACE


def test_what_was_seen_since_comes_again_though_its_looks_are_the_same():
    state = memory({3: 2}, {5: 4})
    later = jax.tree.map(np.array, state)
    later.objects.seen[1] += 3
    (_, found), at_rest = joined(state, later)
    assert found.ids == {5: 40}
    assert found.matched == ((5, 40),)
    assert at_rest.ids() == [40]


def test_open_tracklets_that_come_back_are_known():
    both = memory({3: 2}), memory({0: 1}, next_id=9)
    (_, found), at_rest = joined(*(leaving(state, look=5) for state in both))
    assert found.ids == {0: 40}
    assert at_rest.ids() == [40]


@pytest.mark.parametrize("merged_here", [False, True])
def test_what_was_declared_one_is_known_by_any_of_its_looks(merged_here):
    front_and_back, back = memory({0: 0, 1: 1, 5: 5}), memory({2: 5, 3: 1})
    sides = [(front_and_back, {5: 0}), (back, {})]
    this, that = (
        Joining(state, ObjectsAtRest(), merged_into)
        for state, merged_into in (sides if merged_here else reversed(sides))
    )
    _, found = join(this, that, ONE_CLASS, PlusThresholds())
    assert {*found.matched} == ({(0, 40), (1, 41)} if merged_here else {(2, 40), (3, 41)})
    assert not found.ambiguous


@pytest.mark.slow
def test_memories_of_other_features_or_trackers_are_refused(tmp_path):
    building = Building(PER_PLACE, noise=0.05, one_class=False, seed=3)
    tracker = rj.Tracker(config=CONFIG)
    tracker.update(building.frame(0, 0))
    image = np.random.default_rng(0).integers(0, 255, (96, 128, 3), np.uint8)
    mask = np.zeros((1, 96, 128), bool)
    mask[0, 16:80, 32:96] = True
    statistics, bank = rj.Tracker(config=CONFIG), rj.Tracker(tracker="bank")
    for one, name in ((statistics, "other"), (bank, "bank")):
        one.update(image, mask)
        one.save(tmp_path / name)
    narrow = building.frame(0, 0)
    narrow = dataclasses.replace(narrow, features=np.asarray(narrow.features)[..., :64])
    small = rj.Tracker(config=CONFIG)
    small.update(narrow)
    small.save(tmp_path / "narrow")
    before = tracker.num_objects, len(tracker.objects())
    for name, said in (
        ("bank", "is the memory of tracker 'bank'"),
        ("other", "was made with backbone 'patch-statistics"),
        ("narrow", "features of 64 numbers, not 384"),
    ):
        with pytest.raises(RemindError, match=said):
            tracker.join(tmp_path / name)
    assert (tracker.num_objects, len(tracker.objects())) == before
    with pytest.raises(ConfigError, match="'bank' cannot join memories"):
        bank.join(tmp_path / "bank")
