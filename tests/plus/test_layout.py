"""What the others in view say: an arrangement is known by its members together."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import numpy.typing as npt

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus import layout
from remind_jax.plus.layout import weigh_jointly
from remind_jax.plus.state import init
from remind_jax.plus.static import NUM_CANDIDATES
from remind_jax.plus.thresholds import PlusThresholds
from tests.plus.frames import T, detections, motion
from tests.plus.test_vacancy import SIZE, seen
from tests.plus.walls import NO_TRUTH, STATIC, Walk, follow

PLACES = np.array([[1.5, 1.5], [3, 1.2], [4.5, 1.6], [2.2, 3], [4, 3.2]], np.float32)
NUM = len(PLACES)
TICKS = jnp.int32(200)

EMPTY = jax.tree.map(np.array, init(STATIC))


def weigh_anew(looks, moved, rare, speed):
    """Log odds of five detections in two ways, see `weigh`."""
    five, rest = np.s_[:NUM, :NUM], np.s_[NUM : 4 * NUM]
    objects, pairs = jax.tree.map(np.copy, (EMPTY.objects, EMPTY.pairs))
    objects.seen[:NUM], objects.class_id[:NUM] = 20, 0
    # Others that are never in view, and of another class if these are of a rare one.
    objects.id[: 4 * NUM] = 1
    pairs.relation[five] = (PLACES[None] - PLACES[:, None]) / SIZE
    pairs.spread[five], pairs.covisible[five] = 0.1, 20
    objects, pairs = jax.tree.map(jnp.asarray, (objects, pairs))
    objects = dataclasses.replace(objects, class_id=objects.class_id.at[rest].set(rare))
    objects = dataclasses.replace(objects, speed=objects.speed.at[rest].set(speed))
    num = STATIC.num_detections
    row = jnp.arange(num)[:, None]
    first = (jnp.arange(NUM_CANDIDATES)[None] == 0) & (row < NUM)
    nothing, _ = layout.nothing_weighed(num)
    shortlist = dataclasses.replace(
        nothing,
        slot=jnp.where(first, row, 0),
        valid=first,
        base=jnp.where(first, looks, 0.0),
        evidence=dataclasses.replace(nothing.evidence, looks=nothing.base + looks),
    )
    nobody = jnp.full(num, NO_SLOT)
    sightings = seen(anchors=PLACES)
    sightings = dataclasses.replace(
        sightings, center=sightings.center + moved * sightings.valid[:, None]
    )
    weighed = weigh_jointly(
        shortlist, nobody, nobody != NO_SLOT, sightings, objects, pairs, TICKS, T
    )
    return weighed.odds[:NUM, 0], weighed.evidence.total()[:NUM, 0]


_weigh = jax.jit(weigh_anew)


def weigh(
    looks: float,
    moved: npt.ArrayLike = (0.0, 0.0),
    rare: bool = False,
    speed: float = 0.0,
) -> np.ndarray:
    """Log odds that each of five detections is the object that lay there.

    Args:
      looks: Log odds of looks of each.
      moved: Where they lie now, from where the objects lay; of all, or of each detection.
      rare: Three times as many other objects are of another class, instead of the same one.
      speed: With which these others move.
    """
    told, summed = _weigh(looks, np.array(moved, np.float32), rare, speed)
    np.testing.assert_allclose(told, summed, rtol=1e-5)  # order of sums
    return np.asarray(told)


def test_an_arrangement_is_recognized_by_its_members_together():
    new = PlusThresholds().decision.new
    assert np.all(weigh(looks=0.5) > new + 4)
    assert np.all(weigh(looks=0.5, moved=(0.7, -0.2)) > new + 4), "seen from elsewhere"


def test_members_that_look_wrong_cannot_talk_each_other_into_being_known():
    new = PlusThresholds().decision.new
    assert np.all(weigh(looks=-3.0) < new)


def test_where_others_of_the_class_move_it_tells_less_how_they_lie():
    still, among_movers = (weigh(looks=0.5, speed=speed) for speed in (0.0, 0.1))
    assert np.all(among_movers < still - 2)
    assert np.all(among_movers > 0.5), "it speaks for them nevertheless"
    apart = weigh(looks=0.5, rare=True, speed=0.1)
    np.testing.assert_array_equal(apart, weigh(looks=0.5, rare=True))
    one_lies_wrong = np.zeros((STATIC.num_detections, 2))
    one_lies_wrong[0] = 3.0, 0.5
    wrong, wrong_among_movers = (
        weigh(looks=2.0, moved=one_lies_wrong, speed=speed)[0] for speed in (0.0, 0.1)
    )
    assert wrong < 1.0, "less than its looks"
    # The others speak against it by how far they are believed, which is a little less.
    np.testing.assert_allclose(wrong, wrong_among_movers, atol=0.1)


def test_in_a_crowd_the_nearest_are_asked(monkeypatch):
    def ask(num: int) -> np.ndarray:
        monkeypatch.setattr(layout, "NUM_WITNESSES", num)
        still = np.zeros(2, np.float32)
        return np.asarray(jax.jit(lambda *given: weigh_anew(*given))(0.5, still, False, 0.0)[0])

    everyone = weigh(looks=0.5)
    np.testing.assert_allclose(ask(NUM - 1), everyone, rtol=1e-5)
    fewer = ask(1)
    assert np.all(fewer < everyone - 1), "one neighbor says less than four"
    assert np.all(fewer > 0.5), "but it is heard"


def test_a_batch_is_weighed_as_its_members_alone():
    looks, still = np.array([0.5, -1.0, 3.0], np.float32), np.zeros(2, np.float32)
    alone = [weigh(looks=one) for one in looks]
    in_batch = jax.jit(jax.vmap(lambda one: weigh_anew(one, still, False, 0.0)[0]))
    np.testing.assert_allclose(in_batch(looks), alone, rtol=1e-5)


def test_what_is_always_in_view_tells_nothing_however_fast_the_camera_is():
    """One stays, another one leaves after 2 s and is back after 6."""
    said = []
    for per_tick in (1, 3):
        frames = 65 * per_tick
        ticks = np.arange(frames) / per_tick
        both = detections([[1, 1], [4, 3]] + [[0, 0]] * 4, np.eye(6))
        each, move = jax.tree.map(
            lambda leaf, num=frames: np.repeat(np.asarray(leaf)[None], num, 0), (both, motion())
        )
        valid = np.zeros((frames, 6), bool)
        valid[:, 0], valid[:, 1] = True, (ticks < 20) | (ticks >= 60)
        walk = Walk(
            dataclasses.replace(each, valid=valid),
            dataclasses.replace(move, elapsed=np.full(frames, 1.0 / per_tick, np.float32)),
            np.full((frames, 6), NO_TRUTH),
        )
        verdicts = follow(walk)[1]
        back = 60 * per_tick
        assert verdicts.option_id[back, 1, 0] == verdicts.answer_id[0, 1]
        said.append(float(verdicts.evidence.companions[back, 1, 0]))
    np.testing.assert_allclose(said, 0.0, atol=0.05)
