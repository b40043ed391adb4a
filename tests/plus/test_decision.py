"""Known or new: the decision about one open tracklet with one candidate."""

import dataclasses

import jax
import jax.numpy as jnp
import pytest

from remind_jax.numerics.absent import NO_SLOT
from remind_jax.plus.decision import CLEAR_LEAD, HESITATION, Choice, decide, learn_newness
from remind_jax.plus.evidence import Shortlist
from remind_jax.plus.layout import nothing_weighed
from remind_jax.plus.state import init, no_tracklets
from remind_jax.plus.static import NUM_CANDIDATES
from remind_jax.plus.thresholds import Decision
from remind_jax.static import Static

STATIC = Static(num_detections=1, num_objects=4, feature_dim=3)
SLOT = 2
NEW = Decision().new


def only_candidate(valid: bool = True, **evidence: float) -> Shortlist:
    """One object; of its evidence what is not given is 0."""
    nothing = nothing_weighed(1)[0]
    is_first = jnp.arange(NUM_CANDIDATES)[None] == 0
    own = {kind: jnp.full((1, NUM_CANDIDATES), odds) for kind, odds in evidence.items()}
    return dataclasses.replace(
        nothing,
        slot=jnp.full((1, NUM_CANDIDATES), SLOT),
        valid=is_first & valid,
        evidence=dataclasses.replace(nothing.evidence, **own),
    )


@jax.jit
def decide_alone(
    age: int, odds: float, tentative: float, familiarity: float = 0.0, stays: float = 1.0
) -> Choice:
    """One open tracklet; by itself, how familiar the scene is counts for nothing."""
    here = dataclasses.replace(
        no_tracklets(1, 3),
        age=jnp.array([age]),
        duration=jnp.array([1.0 * age]),
        class_id=jnp.array([0]),
    )
    candidate, evidence = only_candidate(), jnp.full((1, NUM_CANDIDATES), odds)
    is_open = jnp.array([True])
    t = Decision(familiarity=familiarity, tentative=tentative)
    scene, each = init(STATIC).scene, jnp.full(1, stays)
    return decide(candidate, evidence, is_open, here, each, scene, STATIC.num_objects, t)


def test_in_doubt_an_early_answer_is_a_known_object():
    for age in (1, Decision().commit_age - 1):
        assert decide_alone(age, NEW - 0.3, tentative=0.5).slot == SLOT
        assert decide_alone(age, NEW - 0.3, tentative=0.0).slot == NO_SLOT
        assert decide_alone(age, NEW - 0.7, tentative=0.5).slot == NO_SLOT


def test_the_last_answer_is_not_biased():
    choice = decide_alone(int(HESITATION * Decision().commit_age), NEW - 0.3, tentative=0.5)
    assert choice.slot == NO_SLOT
    assert choice.born


def test_what_came_last_says_nothing_of_things_that_move():
    """At first much is new, which is told of a tracklet that hardly looks known as well."""

    def new_odds(stays: float) -> float:
        choice = decide_alone(Decision().commit_age, -2.0, 0.0, familiarity=1.0, stays=stays)
        return float(choice.private[0])

    assert new_odds(1.0) > new_odds(0.5) > new_odds(0.0) == pytest.approx(NEW)


@pytest.mark.parametrize("side", [-1, 1])
def test_what_hardly_leads_waits_for_more_views(side):
    age = Decision().commit_age
    long = int(HESITATION * age)

    def is_decided(age: int, lead: float) -> bool:
        choice = decide_alone(age, NEW + side * lead, tentative=0.0)
        return bool(choice.recognized | choice.born)

    assert is_decided(age, CLEAR_LEAD + 0.1)
    assert not is_decided(age - 1, CLEAR_LEAD + 0.1)
    assert not is_decided(long - 1, CLEAR_LEAD - 0.1)
    assert is_decided(long, CLEAR_LEAD - 0.1)


def newness_after_birth(class_odds: float, valid: bool) -> float:
    """Running share of new things after one more of them that one object might have been."""
    state = init(STATIC)
    candidate = only_candidate(valid, class_name=class_odds)
    zero, yes, no = jnp.zeros(1), jnp.array([True]), jnp.array([False])
    choice = Choice(jnp.array([NO_SLOT]), zero, zero, zero, recognized=no, born=yes)
    scene, _ = learn_newness(state.scene, state.objects, choice, jnp.array([0]), candidate)
    return float(scene.newness[0])


def test_a_new_object_tells_of_newness_only_where_it_could_have_been_a_known_one():
    usual = float(init(STATIC).scene.newness[0])
    assert newness_after_birth(0.0, valid=False) == usual
    assert newness_after_birth(0.0, valid=True) > newness_after_birth(-3.0, valid=True) > usual
