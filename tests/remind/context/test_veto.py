"""Which pairs are ruled out, against method.md#veto in plain Python."""

import dataclasses

import jax
import numpy as np
import pytest

from remind_jax.remind.context.influence import no_influence
from remind_jax.remind.context.veto import Veto, veto_pairs
from tests.statics import make_static

from .scenes import thresholds, view_of

pytestmark = pytest.mark.usefixtures("x64")
_veto = jax.jit(veto_pairs, static_argnames="static")


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
    found = _veto(
        influence, view, np.ones((MANY, MANY), bool), score,
        static=make_static(precision="float64"), thresholds=thresholds(veto={**MASS, **changed}),
    )  # fmt: skip
    return Veto(int(np.asarray(found)[0, 0]))


CONTRADICTED = Veto.LOCAL_CTX_CONTRADICTION


@pytest.mark.parametrize(
    ("met", "expected"),
    [
        ({"expected": 3, "hits": 0}, CONTRADICTED),
        ({"expected": 2, "hits": 0}, Veto.NONE),
        ({"expected": 10, "hits": 1}, Veto.NONE),  # a tenth is not below a tenth
        ({"expected": 11, "hits": 1}, CONTRADICTED),
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
