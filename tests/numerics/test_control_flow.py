"""Branches and loops give the same in a batch, and a batch skips what none of its members needs."""

import jax
import jax.numpy as jnp
import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from remind_jax.numerics.control_flow import branch, count_up, fill_blocks, in_turn, repeat


def _choose(pred, x, y):
    return branch(pred, lambda: {"value": jnp.sin(x) + y}, lambda: {"value": x})


_choose_nested = jax.jit(jax.vmap(jax.vmap(_choose, (0, 0, None)), (0, 0, None)))


def _double(times, x):
    """Doubles x so many times; done states stay as they are."""

    def turn(state):
        done, value = state
        return jnp.minimum(done + 1, times), jnp.where(done < times, value * 2, value)

    return repeat(lambda state: state[0] < times, turn, (jnp.int32(0), x))[1]


@given(st.lists(st.lists(st.booleans(), min_size=3, max_size=3), min_size=3, max_size=3))
def test_branch_in_batches_equals_a_loop(preds):
    pred = np.array(preds)
    x = np.arange(pred.size, dtype=np.float32).reshape(pred.shape)
    # sin is vectorized differently in a batch: one unit in the last place
    np.testing.assert_allclose(
        _choose_nested(pred, x, 3.0)["value"], np.where(pred, np.sin(x) + 3.0, x), rtol=3e-7
    )


_double_all = jax.jit(jax.vmap(_double, (0, None)))
_double_nested = jax.jit(jax.vmap(jax.vmap(_double, (0, None)), (None, 0)))


@given(st.lists(st.integers(0, 5), min_size=4, max_size=4))
def test_repeat_in_batches_equals_a_loop(times):
    times = np.array(times, np.int32)
    np.testing.assert_array_equal(_double_all(times, 1.5), 1.5 * 2.0**times)
    nested = _double_nested(times, np.float32([1.0, 3.0]))
    np.testing.assert_array_equal(nested, np.outer([1.0, 3.0], 2.0**times))


def test_a_batch_skips_a_branch_that_nobody_takes():
    """Under plain `vmap` the branch would be computed for all and thrown away."""

    def count(x):
        nonlocal num_calls
        num_calls += 1
        return x

    def run(pred, x):
        costly = lambda: jax.pure_callback(  # noqa: E731
            count, jax.ShapeDtypeStruct((), jnp.float32), x, vmap_method="sequential"
        )
        return branch(pred, costly, lambda: -x)

    batch = jax.jit(jax.vmap(run))
    num_calls = 0
    got = jax.block_until_ready(batch(jnp.zeros(4, bool), jnp.arange(4.0)))
    np.testing.assert_array_equal(got, -jnp.arange(4.0))
    assert num_calls == 0
    jax.block_until_ready(batch(jnp.array([False, True, False, False]), jnp.arange(4.0)))
    assert num_calls > 0


def _fill(stop):
    write = lambda number, row: jax.lax.dynamic_update_slice(row, number[None], (number,))  # noqa: E731
    return count_up(stop, write, jnp.full(6, -1, jnp.int32), first=1)


_fill_one, _fill_all = jax.jit(_fill), jax.jit(jax.vmap(_fill))


@given(st.lists(st.integers(0, 5), min_size=4, max_size=4))
def test_numbered_turns_in_batches_equal_a_loop(stops):
    stops = np.array(stops, np.int32)
    for stop, row in zip(stops, _fill_all(stops), strict=True):
        expected = np.where((np.arange(6) >= 1) & (np.arange(6) < stop), np.arange(6), -1)
        np.testing.assert_array_equal(row, expected)
        np.testing.assert_array_equal(_fill_one(stop), expected)


def test_the_number_of_a_turn_is_that_of_the_whole_batch():
    traced = jax.make_jaxpr(jax.vmap(_fill))(jnp.arange(4, dtype=jnp.int32))
    (loop,) = (one for one in traced.eqns if one.primitive.name == "while")
    shapes = [result.aval.shape for result in loop.outvars]
    assert shapes.count((4, 6)) == 1
    assert set(shapes) == {(), (4, 6)}


def test_what_suits_all_is_taken_by_all():
    def halve(pred, x):
        return branch(pred, lambda: jnp.where(pred, x / 2, x), lambda: x, suits_all=True)

    x = np.arange(4, dtype=np.float32)
    pred = np.array([True, False, True, False])
    np.testing.assert_array_equal(jax.vmap(halve)(pred, x), np.where(pred, x / 2, x))
    np.testing.assert_array_equal(jax.vmap(halve)(np.zeros(4, bool), x), x)

    def negate(pred, x):
        return branch(pred, lambda: -x, lambda: x, suits_all=True)

    # Nothing chooses between both any more.
    assert "select_n" in str(jax.make_jaxpr(jax.vmap(_choose, (0, 0, None)))(pred, x, 1.0))
    assert "select_n" not in str(jax.make_jaxpr(jax.vmap(negate))(pred, x))


def test_turns_that_suit_all_are_taken_by_all():
    def double(stop):
        return count_up(stop, lambda _, x: x * 2, jnp.float32(1), suits_all=True)

    stops = jnp.array([0, 3, 1], jnp.int32)
    assert jax.vmap(double)(stops).tolist() == [8, 8, 8]
    assert [float(double(stop)) for stop in stops] == [1, 8, 2]


def _root_in_turn(needed, x, shared):
    """Halves x until it is below a shared number, where needed."""

    def halve(x, shared):
        return {"value": jax.lax.while_loop(lambda y: y >= shared, lambda y: y / 2, x)}

    return in_turn(needed, halve, x, shared)


_roots_in_turn = jax.jit(jax.vmap(_root_in_turn, (0, 0, None)))


@given(st.lists(st.booleans(), min_size=5, max_size=5))
def test_members_in_turn_equal_single_ones(needed):
    x = np.array([1, 3, 50, 7, 9], np.float32)
    got = _roots_in_turn(np.array(needed), x, np.float32(2))["value"]
    assert _root_in_turn(np.True_, x[2], np.float32(2))["value"] == 1.5625
    np.testing.assert_array_equal(got, np.where(needed, [1, 1.5, 1.5625, 1.75, 1.125], 0))


def test_on_other_devices_members_take_their_turns_together(monkeypatch):
    x, needed = np.array([1, 3, 50], np.float32), np.array([True, False, True])
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    got = jax.vmap(_root_in_turn, (0, 0, None))(needed, x, np.float32(2))["value"]
    np.testing.assert_array_equal(got[needed], [1, 1.5625])


def _square_used(used, values):
    """Squares up to the last one in use, three at a time, and their running number."""
    before = jnp.full(len(values), -1.0), jnp.full((len(values), 2), -1.0)

    def make(rows_of):
        block = rows_of(values)
        return block**2, jnp.stack([block, rows_of(jnp.arange(1.0, 1.0 + len(values)))], axis=1)

    return fill_blocks(make, used, before, 3)


_square_all = jax.jit(jax.vmap(_square_used, (0, None)))


@given(st.lists(st.lists(st.booleans(), min_size=7, max_size=7), min_size=2, max_size=2))
def test_blocks_up_to_the_last_row_in_use_are_made(used):
    used, values = np.array(used), np.arange(7, dtype=np.float32)
    squares, pairs = _square_all(used, values)
    for own, square, pair in zip(used, squares, pairs, strict=True):
        stop = np.flatnonzero(own)[-1] + 1 if own.any() else 0
        np.testing.assert_array_equal(square[:stop], values[:stop] ** 2)
        np.testing.assert_array_equal(pair[:stop], np.stack([values, values + 1], 1)[:stop])
    beyond = -(-(np.flatnonzero(used.any(axis=0))[-1] + 1) // 3) * 3 if used.any() else 0
    np.testing.assert_array_equal(squares[:, beyond:], -1.0)
