"""Programs: compiled once, found again only where nothing changed."""

from __future__ import annotations

import functools
import threading

import jax
import numpy as np
import pytest

from remind_jax.compiled import programs
from remind_jax.compiled.programs import (
    KeptFunction,
    Recipe,
    get_program,
    is_of_this_package,
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


@pytest.mark.parametrize(("much_s", "num_returns"), [(0.0, 1), (1e9, 0)])
def test_memory_goes_back_after_programs_that_take_long_to_make(monkeypatch, much_s, num_returns):
    returns: list[None] = []
    monkeypatch.setattr(programs, "_MUCH_S", much_s)
    monkeypatch.setattr(programs, "return_freed_memory", lambda: returns.append(None))
    recipe = Recipe("sum", Counted(), shapes_of(PAIR), f"memory {much_s}", is_kept=False)
    get_program(recipe)
    get_program(recipe)
    assert len(returns) == num_returns


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


def test_a_kept_function_is_itself_under_jit(folder):
    double = KeptFunction("double", lambda x: 2 * x, None)
    np.testing.assert_array_equal(double(PAIR[0]), [0, 2, 4])
    np.testing.assert_array_equal(jax.jit(lambda x: double(x) + 1)(PAIR[0]), [1, 3, 5])
    assert len(files(folder)) == 1


def test_only_functions_that_the_text_of_the_package_defines_are_kept():
    assert is_of_this_package(decide)
    assert not is_of_this_package(np.add)
    assert not is_of_this_package(lambda state: state)
    assert not is_of_this_package(functools.partial(decide))
