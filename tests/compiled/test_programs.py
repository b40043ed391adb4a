"""Programs: compiled once, found again only where nothing changed."""

import functools
import gc
import threading

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.core import Tracer

from remind_jax.compiled.programs import (
    Recipe,
    get_program,
    is_of_this_package,
    keep_function,
    shapes_of,
    waited_s,
)
from remind_jax.remind.tracker import decide

from .counting import PAIR, Counted, files, run


def test_a_program_is_compiled_once_for_all_processes(folder):
    function = Counted()
    first, second = run(function), run(function)
    assert function.num_traces == len(files(folder)) == 1
    for is_less, total in (first, second):
        np.testing.assert_array_equal(total, [2, 2, 2])
        np.testing.assert_array_equal(is_less, [True, False, False])


def test_a_program_is_compiled_once_for_all_threads(folder):
    function = Counted()
    recipe = Recipe("sum", function, shapes_of(PAIR), "threads", is_kept=False)
    threads = [threading.Thread(target=get_program, args=(recipe,)) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert function.num_traces == 1


def test_seconds_of_waiting_are_counted(folder):
    before = waited_s()
    run(Counted())
    assert waited_s() > before


@pytest.mark.parametrize("runs", [True, False])
def test_nothing_is_collected_while_programs_are_traced(runs):
    """And the collector comes back as it was, when the last of several threads is done."""
    seen, entered, leave = [], threading.Event(), threading.Event()

    def trace():
        seen.append(gc.isenabled())
        entered.set()
        leave.wait(10)
        return []

    def make(name, function):
        get_program(Recipe(name, function, (), ("collector", runs), is_kept=False))

    was = gc.isenabled()
    try:
        gc.enable() if runs else gc.disable()
        thread = threading.Thread(target=make, args=("first", trace))
        thread.start()
        assert entered.wait(10)
        make("second", lambda: [])
        assert not gc.isenabled()
        leave.set()
        thread.join()
        assert gc.isenabled() == runs
    finally:
        gc.enable() if was else gc.disable()
    assert seen == [False]


def test_a_failure_is_raised_and_not_kept(folder):
    def fail(a, b):
        raise ValueError("no such thing")

    with pytest.raises(ValueError, match="no such thing"):
        run(fail)
    assert run(Counted())


def test_another_key_or_shape_or_type_is_another_program(folder):
    function = Counted()
    run(function)
    run(function, key="other")
    run(function, tuple(leaf[:2] for leaf in PAIR))
    run(function, tuple(leaf.astype(np.int32) for leaf in PAIR))
    assert function.num_traces == len(files(folder)) == 4


def test_nothing_is_compiled_where_jit_is_off(folder):
    seen = []

    def double(x):
        seen.append(x)
        return 2 * x

    with jax.disable_jit():
        assert keep_function("double", double, ())(jnp.ones(2)).tolist() == [2, 2]
        run = get_program(Recipe("double-off", double, shapes_of(jnp.ones(2)), ()))
        assert run(jnp.ones(2))[0].tolist() == [2, 2]
    assert not isinstance(seen[0], Tracer)
    assert not isinstance(seen[-1], Tracer)


def test_a_kept_function_is_itself_under_jit(folder):
    double = keep_function("double", lambda x: 2 * x, None)
    np.testing.assert_array_equal(double(PAIR[0]), [0, 2, 4])
    np.testing.assert_array_equal(jax.jit(lambda x: double(x) + 1)(PAIR[0]), [1, 3, 5])
    assert len(files(folder)) == 1


def test_only_functions_that_the_text_of_the_package_defines_are_kept():
    assert is_of_this_package(decide)
    assert not is_of_this_package(np.add)
    assert not is_of_this_package(lambda state: state)
    assert not is_of_this_package(functools.partial(decide))
    wrapper = functools.wraps(decide)(lambda state, seen, **options: decide(state, seen, **options))
    assert not is_of_this_package(wrapper), "under the name of what it wraps"
