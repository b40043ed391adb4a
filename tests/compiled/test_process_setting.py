"""A setting is another one while any thread needs that, and comes back as it was."""

import gc
import threading

import pytest

from remind_jax.compiled.process_setting import ProcessSetting
from remind_jax.compiled.programs import Recipe, get_program


class Light:
    """Something that a process has one of."""

    def __init__(self, color):
        self.color = color
        self.setting = ProcessSetting(lambda: self.color, self.turn, "red")

    def turn(self, color):
        self.color = color


@pytest.mark.parametrize("color", ["green", "red"])
def test_it_comes_back_when_the_last_one_has_left(color):
    light = Light(color)
    with light.setting.changed():
        with light.setting.changed():
            assert light.color == "red"
        assert light.color == "red"
    assert light.color == color


def test_it_comes_back_after_an_error():
    light = Light("green")
    with pytest.raises(ValueError, match="no"), light.setting.changed():
        raise ValueError("no")
    assert light.color == "green"


def test_threads_may_leave_in_any_order():
    light = Light("green")
    entered, leave = threading.Event(), threading.Event()

    def other():
        with light.setting.changed():
            entered.set()
            leave.wait(10)

    thread = threading.Thread(target=other)
    with light.setting.changed():
        thread.start()
        assert entered.wait(10)
    assert light.color == "red"
    leave.set()
    thread.join()
    assert light.color == "green"


@pytest.mark.parametrize("runs", [True, False])
def test_nothing_is_collected_while_a_program_is_traced(runs):
    seen = []

    def trace():
        seen.append(gc.isenabled())
        return []

    was = gc.isenabled()
    try:
        gc.enable() if runs else gc.disable()
        get_program(Recipe("nothing", trace, (), ("test_process_setting", runs), is_kept=False))
        assert gc.isenabled() == runs
    finally:
        gc.enable() if was else gc.disable()
    assert seen == [False]
