"""The collector rests while somebody traces, and is left as it was found."""

import gc
import threading

import pytest

from remind_jax.compiled.paused_collection import paused_collection


@pytest.fixture(autouse=True)
def _running():
    gc.enable()
    yield
    gc.enable()


def test_it_goes_on_when_the_last_one_has_left():
    with paused_collection():
        with paused_collection():
            assert not gc.isenabled()
        assert not gc.isenabled()
    assert gc.isenabled()


def test_it_goes_on_after_an_error():
    with pytest.raises(ValueError, match="no"), paused_collection():
        raise ValueError("no")
    assert gc.isenabled()


def test_who_had_turned_it_off_finds_it_off():
    gc.disable()
    with paused_collection():
        pass
    assert not gc.isenabled()


def test_threads_may_leave_in_any_order():
    entered, leave = threading.Event(), threading.Event()

    def other():
        with paused_collection():
            entered.set()
            leave.wait(10)

    thread = threading.Thread(target=other)
    with paused_collection():
        thread.start()
        assert entered.wait(10)
    assert not gc.isenabled()
    leave.set()
    thread.join()
    assert gc.isenabled()
