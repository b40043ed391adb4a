"""Which pairs are ruled out, against method.md#veto in plain Python."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.remind.context.influence import Influence, no_influence
from remind_jax.remind.context.veto import Veto, expect_neighbors, plausibly_in_view, veto_pairs
from remind_jax.remind.thresholds.context import Veto as Rules
from tests.statics import make_static

from .scenes import thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
SHORT = make_static(precision="float64", expected_neighbours=4, context_hypotheses=2)
LEAST = 0.05  # conditional probability of an expected neighbor
GATE = 0.75  # visual score of a plausible candidate
_expect = jax.jit(expect_neighbors, static_argnames="static")
_plausible = jax.jit(plausibly_in_view)
_veto = jax.jit(veto_pairs, static_argnames="static")


def expect_plainly(told, keys, count, static, mass):
    """method.md#expected-neighbors of one object; `keys`: weight, time and order of its edges."""
    listed = sorted(
        np.flatnonzero(count), key=lambda one: (-keys[0][one], -keys[1][one], keys[2][one])
    )
    expected, total = [], 0.0
    for one in listed[: static.switches.max_neighbours]:
        if told[one] < LEAST:
            continue
        expected.append(one)
        total += told[one]
        enough = len(expected) >= static.switches.context_hypotheses and total >= mass
        if enough or len(expected) >= static.switches.expected_neighbours:
            break
    return expected


def test_expected_neighbours():
    generator, slots = np.random.default_rng(0), 30
    count = generator.integers(0, 3, (slots, slots)).astype(np.int32)
    weight = generator.choice([0.5, 1.0, 2.0], (slots, slots))
    time = generator.integers(0, 3, (slots, slots)).astype(np.int32)
    order = generator.permuted(np.tile(np.arange(slots, dtype=np.int32), (slots, 1)), axis=1)
    told = generator.choice([0.02, 0.05, 0.2, 0.3, 0.6], (slots, slots))
    view = view_of(told, count=count, weight=weight, edge_time=time, edge_order=order)
    found = np.asarray(_expect(view, LEAST, static=SHORT, t=thresholds().veto))
    lengths = set()
    for row in range(slots):
        keys = weight[row], time[row], order[row]
        plain = expect_plainly(told[row], keys, count[row], SHORT, 0.75)
        assert set(np.flatnonzero(found[row])) == set(plain)
        lengths.add(len(plain))
    assert lengths >= {2, 3, 4}


def test_only_the_first_edges_count():
    """Edges beyond the length of a neighbor list are not looked at."""
    static = make_static(precision="float64", max_neighbours=2)
    told, count = np.full((6, 6), 0.3), np.ones((6, 6), np.int32)
    order = np.tile(np.arange(6, dtype=np.int32), (6, 1))
    view = view_of(told, count=count, edge_order=order)
    found = np.asarray(_expect(view, LEAST, static=static, t=thresholds().veto))
    np.testing.assert_array_equal(found, np.tile(np.arange(6) < 2, (6, 1)))


def test_plausibly_in_view():
    """Up to three of each other detection, late objects first among equals."""
    generator, num, slots = np.random.default_rng(0), 5, 8
    for _ in range(30):
        score = generator.choice([0.5, np.nextafter(GATE, 0), GATE, 0.8, 0.9], (num, slots))
        candidate = generator.random((num, slots)) < 0.7
        found = np.asarray(_plausible(candidate, score, np.float64(GATE)))
        named = []
        for row in range(num):
            able = [one for one in range(slots) if candidate[row, one] and score[row, one] >= GATE]
            able.sort(key=lambda one, row=row: (score[row, one], one), reverse=True)
            named.append(set(able[:3]))
        for row in range(num):
            others = set().union(*named[:row], *named[row + 1 :])
            assert set(np.flatnonzero(found[row])) == others


# ------------------------------------------------------------------ outside the context

OBJECTS = 250


def draw_influence(quality: float, global_ok: bool = True) -> Influence:
    generator = np.random.default_rng(1)

    def draw(*values):
        return generator.choice(values, OBJECTS)

    return dataclasses.replace(
        no_influence(OBJECTS, np.dtype("float64")),
        score_sets=draw(-0.5, 0.05, np.nextafter(0.05, 1), 0.4),
        compat_rel=draw(0.0, 0.1, np.nextafter(0.1, 1)),
        compat_band=draw(False, False, False, True),
        soft_supported=draw(False, False, False, True),
        shortlist=draw(False, False, False, True),
        kept_count=draw(0, 1, 3, 4).astype(np.int32),
        pruning=draw(np.nextafter(0.35, 0), 0.35, 0.9),
        strength=draw(np.nextafter(0.5, 0), 0.5, 0.9),
        has_pack=draw(True, True, True, False),
        quality=np.float64(quality),
        global_ok=np.bool_(global_ok),
        enabled=np.bool_(True),
    )


def is_outside_plainly(felt: Influence, one: int, t: Rules) -> bool:
    if not (t.enabled and felt.enabled and felt.has_pack[one]):
        return False
    if felt.soft_supported[one] or felt.shortlist[one] or felt.compat_band[one]:
        return False
    if felt.compat_rel[one] > t.max_support or felt.score_sets[one] > t.max_score:
        return False
    if not felt.global_ok or felt.quality < t.min_quality:
        return False
    if not 0 < felt.kept_count[one] <= t.max_supported:
        return False
    return bool(felt.pruning[one] >= t.min_pruning and felt.strength[one] >= t.min_strength)


@pytest.mark.parametrize(
    ("quality", "changed", "vetoes"),
    [
        (0.6, {}, True),
        (np.nextafter(0.6, 0), {}, False),
        (0.6, {"enabled": False}, False),
        (0.5, {"min_quality": 0.5, "max_supported": 4, "min_pruning": 0.5}, True),
        (0.9, {"max_support": 0.05, "max_score": 0.3, "min_strength": 0.7}, True),
    ],
)
def test_objects_outside_the_context(quality, changed, vetoes):
    felt = draw_influence(quality)
    view = view_of(np.zeros((OBJECTS, OBJECTS)))
    candidate = np.stack([np.ones(OBJECTS, bool), np.arange(OBJECTS) % 2 == 0])
    found = np.asarray(
        _veto(
            felt, view, candidate, np.zeros(candidate.shape), GATE, LEAST,
            static=make_static(precision="float64", max_neighbours=1),
            t=thresholds(veto=changed).veto,
        )
    )  # fmt: skip
    rules = dataclasses.replace(Rules(), **changed)
    plain = np.array([is_outside_plainly(felt, one, rules) for one in range(OBJECTS)])
    np.testing.assert_array_equal(found[0], np.where(plain, Veto.OUTSIDE_CTX, Veto.NONE))
    np.testing.assert_array_equal(found[1], np.where(candidate[1], found[0], Veto.NONE))
    assert bool(np.any(plain)) == vetoes


# ------------------------------------------------------------------ the object's own neighbors

MANY = 20
MASS = {"local_mass": 99.0}  # the list of expected neighbors ends by its length only


def meet(expected: int, hits: int, *, episodes=4, seen=3, quality=0.45, felt=(), **changed) -> Veto:
    """What becomes of object 0, which expects some neighbors of which some are in view.

    Detection 0 is the one in question; the others each name one object that is in view.
    """
    told = np.zeros((MANY, MANY))
    told[0, 1 : expected + 1] = 0.5
    count = (told > 0).astype(np.int32)
    view = view_of(
        told,
        count=count,
        episodes=np.full(MANY, episodes, np.int32),
        edge_order=np.cumsum(count, axis=1),
    )
    influence = dataclasses.replace(
        no_influence(MANY, np.dtype("float64")),
        has_pack=np.ones(MANY, bool),
        quality=np.float64(quality),
        enabled=np.bool_(True),
        **{name: np.ones(MANY, bool) for name in felt},
    )
    strangers = np.arange(13, 13 + seen - hits)
    in_view = [*range(1, hits + 1), *strangers]
    score = np.zeros((MANY, MANY))
    score[np.arange(1, len(in_view) + 1), in_view] = 0.9
    score[0, :] = 0.95  # its own candidates do not count
    rules = thresholds(veto={**MASS, **changed}).veto
    found = _veto(
        influence, view, np.ones((MANY, MANY), bool), score, GATE, LEAST,
        static=make_static(precision="float64"), t=rules,
    )  # fmt: skip
    return Veto(int(np.asarray(found)[0, 0]))


CONTRADICTED = Veto.LOCAL_CTX_CONTRADICTION


@pytest.mark.parametrize(
    ("met", "expected"),
    [
        ({"expected": 3, "hits": 0}, CONTRADICTED),
        ({"expected": 2, "hits": 0}, Veto.NONE),
        ({"expected": 9, "hits": 1}, Veto.NONE),
        ({"expected": 10, "hits": 1}, Veto.NONE),  # a tenth is not below a tenth
        ({"expected": 11, "hits": 1}, CONTRADICTED),
        ({"expected": 12, "hits": 1}, CONTRADICTED),
        ({"expected": 12, "hits": 2}, Veto.NONE),
        ({"expected": 10, "hits": 0, "quality": np.nextafter(0.45, 0)}, Veto.NONE),
        ({"expected": 10, "hits": 0, "episodes": 3}, Veto.NONE),
        ({"expected": 10, "hits": 0, "seen": 2}, Veto.NONE),
        ({"expected": 10, "hits": 0, "local": False}, Veto.NONE),
        ({"expected": 10, "hits": 0, "enabled": False}, Veto.NONE),
        ({"expected": 10, "hits": 0, "felt": ("soft_supported",)}, Veto.NONE),
        ({"expected": 10, "hits": 0, "felt": ("shortlist",)}, Veto.NONE),
        ({"expected": 10, "hits": 0, "felt": ("compat_band",)}, Veto.NONE),
        # mature enough is an object from three episodes on, whatever is asked for
        ({"expected": 3, "hits": 0, "episodes": 2, "local_min_episodes": 0}, Veto.NONE),
        ({"expected": 3, "hits": 0, "episodes": 3, "local_min_episodes": 0}, CONTRADICTED),
    ],
)
def test_neighbors_that_are_not_in_view(met, expected):
    """method.md#veto, row 3; the context need not be good enough for a bonus."""
    assert meet(**met) == expected


def test_own_neighbors_speak_before_the_context():
    """A pair that both rules reject is named after the first."""
    everything = {
        "min_quality": 0.0, "max_support": 1.0, "max_score": 1.0, "min_pruning": 0.0,
        "min_strength": 0.0, "max_supported": 9,
    }  # fmt: skip
    assert meet(3, 0, felt=("global_ok", "kept_count"), **everything) == CONTRADICTED
    assert meet(3, 1, felt=("global_ok", "kept_count"), **everything) == Veto.OUTSIDE_CTX
