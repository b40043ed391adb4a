"""Every choice a set can make, against sets built from scratch."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.remind.context.evidence import Links
from remind_jax.remind.context.growth import (
    choice_mask,
    count_links,
    grow_trees,
    join_chosen,
    members_by_choice,
)
from remind_jax.remind.context.member_sets import MemberSet, empty_set

from .scenes import thresholds
from .test_member_sets import weigh_plainly

pytestmark = pytest.mark.usefixtures("x64")
SLOTS, MEMBERS, MOST = 9, 6, 3  # object slots, most members, most newcomers
ROUNDING = 1e-12  # float64 sums of at most five links
STARTS = [[], [4], [8, 0], [2, 7, 5], [0, 1, 8]]  # sets before the choice, by order of entry
RANKED = np.array(  # objects to choose from
    [[3, 6, 1, 5], [6, 3, 0, 8], [1, 3, 6, 2], [6, 0, 1, NO_SLOT], [6, 3, NO_SLOT, NO_SLOT]],
    np.int32,
)


@functools.cache
def draw_links():
    generator = np.random.default_rng(3)
    strength = np.triu(generator.choice([0.0, 0.1, 0.25, 0.5, 0.9], (SLOTS, SLOTS)), 1)
    present = np.triu(generator.random((SLOTS, SLOTS)) < 0.6, 1) & (strength > 0)
    return Links(
        maturity=generator.random(SLOTS),
        strength=strength + strength.T,
        present=present | present.T,
    )


_join = jax.jit(join_chosen)


@functools.cache
def make_sets() -> MemberSet:
    """The starts, from the empty set."""
    num = len(STARTS)
    one = jax.device_get(empty_set(MEMBERS, SLOTS, jnp.dtype("float64")))
    empty = jax.tree.map(lambda leaf: np.broadcast_to(leaf, (num, *leaf.shape)), one)
    chosen = np.full((num, MOST), NO_SLOT, np.int32)
    for row, members in enumerate(STARTS):
        chosen[row, : len(members)] = members
    parent = np.zeros(num, np.int32)
    grown = _join(empty, parent, chosen, np.int32(MOST), np.int32(num), draw_links())
    return jax.device_get(grown)


def list_choices():
    """Every set after every choice: row, count, variant and the members."""
    for row, start in enumerate(STARTS):
        for count in range(MOST + 1):
            for variant in range(2 if count else 1):
                chosen = [*RANKED[row, : max(count - 1, 0)]]
                if count:
                    chosen.append(RANKED[row, count - 1 + variant])
                if NO_SLOT not in chosen:
                    yield row, count, variant, start + [int(one) for one in chosen]


def test_joined_sets_know_their_members():
    sets = make_sets()
    for row, members in enumerate(STARTS):
        assert sets.size[row] == len(members)
        assert sets.slot[row, : len(members)].tolist() == members
        np.testing.assert_array_equal(np.flatnonzero(sets.members[row]), sorted(members))


def test_sets_may_share_a_parent():
    """The first and the third new set grow from one parent, the second from another."""
    chosen = np.full((len(STARTS), MOST), NO_SLOT, np.int32)
    chosen[0, 0], chosen[1, :2], chosen[2, 0] = 3, [6, 3], 6
    parent = np.array([2, 1, 2, 0, 0], np.int32)
    grown = jax.device_get(
        _join(make_sets(), parent, chosen, np.int32(MOST), np.int32(3), draw_links())
    )
    members = [set(np.flatnonzero(row)) for row in grown.members[:3]]
    assert members == [{8, 0, 3}, {4, 6, 3}, {8, 0, 6}]
    assert grown.size[:3].tolist() == [3, 3, 3]


def test_choices_take_the_first_objects_or_move_the_last_one_on():
    taken = np.asarray(jax.jit(choice_mask, static_argnums=0)(4))
    assert not np.any(taken[0])
    assert np.flatnonzero(taken[1, 0]).tolist() == [0]
    assert np.flatnonzero(taken[1, 1]).tolist() == [1]
    assert np.flatnonzero(taken[3, 0]).tolist() == [0, 1, 2]
    assert np.flatnonzero(taken[3, 1]).tolist() == [0, 1, 3]


def test_members_after_every_choice():
    found = np.asarray(jax.jit(members_by_choice)(make_sets().members, RANKED))
    for row, count, variant, members in list_choices():
        assert np.flatnonzero(found[:, row, count, variant]).tolist() == sorted(members)


def test_trees_after_every_choice():
    trees = jax.device_get(jax.jit(grow_trees)(make_sets(), RANKED, np.int32(MOST), draw_links()))
    strength = np.asarray(draw_links().strength)
    for row, count, variant, members in list_choices():
        plain = weigh_plainly(strength[np.ix_(members, members)]) if len(members) > 1 else 0.0
        np.testing.assert_allclose(trees[row, count, variant], plain, rtol=0, atol=ROUNDING)


@pytest.mark.parametrize("least", [0, 1, 2])
def test_links_after_every_choice(least):
    links = draw_links()
    rules = thresholds(sets={"min_links": least}).sets
    counts = jax.device_get(jax.jit(count_links)(make_sets(), RANKED, links, rules))
    for row, count, variant, members in list_choices():
        degree = np.asarray(links.present)[np.ix_(members, members)].sum(1)
        at = row, count, variant
        assert counts.pairs[at] == degree.sum() / 2
        assert counts.linked[at] == np.sum(degree > 0)
        assert counts.isolated[at] == np.any(degree < least)
