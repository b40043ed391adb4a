import jax
import jax.numpy as jnp
import numpy as np

from remind_jax.remind.memory.bank import (
    Channel,
    Permit,
    Refresh,
    Room,
    observe_whole,
    side_by_side,
)
from tests.remind.memory.small_banks import NOW, bank_of, unit, vectors_of, with_records


def test_only_full_banks_that_take_something_make_room():
    """One channel, four objects: full work, full stable, not full, nothing arrives."""
    full, half = bank_of(unit(0), unit(50), slots=2), bank_of(unit(0), slots=2)
    proven = with_records(bank_of(unit(0), unit(90), slots=2), hits=9)
    side = lambda *banks: jax.tree.map(lambda *leaves: jnp.stack(leaves)[None], *banks)  # noqa: E731
    work, stable = side(full, proven, half, full), side(full, full, full, full)
    banks = jax.tree.map(lambda *sides: jnp.stack(sides), work, stable)
    channel = Channel(
        refresh=Refresh((0.99, 0.99), *[(0.0, 0.0)] * 3),
        room=Room(capacity=(2, 2), merge=(2.0, 2.0), redundant=(False, False)),
        cap=1,
        promote_hits=5,
    )
    shown = jax.jit(observe_whole)(
        banks,
        jnp.broadcast_to(unit(90), (1, 4, 2)),
        jnp.array([[True, True, True, False]]),
        jnp.ones((1, 4)),
        Permit(jnp.ones(4, bool), jnp.ones(4)),
        NOW,
        side_by_side(channel),
    )
    expected = {  # degrees of the prototypes: work, stable
        0: ((50, 90), (0, 50)),
        1: ((0,), (50, 90)),
        2: ((0, 90), (0, 50)),
        3: ((0, 50), (0, 50)),
    }
    for n, sides in expected.items():
        for bank, degrees in zip((shown.work, shown.stable), sides, strict=True):
            found = jax.tree.map(lambda leaf: leaf[0, n], bank)  # noqa: B023
            np.testing.assert_allclose(vectors_of(found), [unit(d) for d in degrees], atol=1e-6)
