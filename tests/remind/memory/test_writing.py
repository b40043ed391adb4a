import jax
import jax.numpy as jnp
import numpy as np
import pytest

from remind_jax.remind.memory.writing import find_writers, write_column, write_rows

ROWS = 4
# Row per detection: none, one twice, beyond the end, before the start.
CHOICES = [(4, 4, 4), (2, 0, 4), (1, 1, 3), (9, 3, 4), (-1, 2, -5)]


def written(memory, row, values):
    """As a scatter that drops what is out of range; of several the last one counts."""
    memory = np.array(memory)
    for detection, at in enumerate(row):
        if 0 <= at < ROWS:
            memory[at] = values[detection]
    return memory


@pytest.mark.parametrize("row", CHOICES)
def test_short_columns_choose_who_writes_them(row):
    memory, values = np.arange(8.0).reshape(4, 2), -1 - np.arange(6.0).reshape(3, 2)
    writers = find_writers(jnp.array(row), ROWS)
    chosen = write_column(jnp.array(memory), writers, jnp.array(values))
    np.testing.assert_array_equal(chosen, written(memory, row, values))
    marked = write_column(jnp.zeros(4, jnp.int32), writers, 7)
    np.testing.assert_array_equal(marked, written(np.zeros(4), row, [7, 7, 7]))


@pytest.mark.parametrize("row", CHOICES)
@pytest.mark.parametrize("axis", [0, 1])
def test_large_rows_are_written_in_place(row, axis):
    memory, values = np.arange(24.0).reshape(4, 3, 2), -np.arange(18.0).reshape(3, 3, 2)
    turned = [jnp.swapaxes(jnp.array(leaf), 0, axis) for leaf in (memory, values)]
    both = {"floats": turned[0], "flags": turned[0] < 0}
    found = write_rows(both, jnp.array(row), {"floats": turned[1], "flags": turned[1] < 0}, axis)
    expected = written(memory, row, values)
    np.testing.assert_array_equal(jnp.swapaxes(found["floats"], 0, axis), expected)
    np.testing.assert_array_equal(jnp.swapaxes(found["flags"], 0, axis), expected < 0)


@pytest.mark.parametrize("axis", [0, 1])
def test_memories_of_a_batch_are_written_each_by_its_own_rows(axis):
    rows = jnp.array(CHOICES)
    shape = (len(CHOICES), 4, 3, 2)
    memory = np.arange(np.prod(shape), dtype=np.float32).reshape(shape)
    values = -np.arange(18.0, dtype=np.float32).reshape(3, 3, 2)
    turn = lambda leaf: jnp.swapaxes(jnp.array(leaf), -3, -3 + axis)  # noqa: E731
    write = jax.jit(jax.vmap(lambda one, row: write_rows(one, row, turn(values), axis)))
    found = write(turn(memory), rows)
    for row, one, got in zip(CHOICES, memory, found, strict=True):
        np.testing.assert_array_equal(turn(got), written(one, row, values))
    assert "scatter" not in write.lower(turn(memory), rows).as_text()
