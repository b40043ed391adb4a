"""Signals end a verb whatever Python is doing; what keeps JAX from starting is told."""

import importlib
import os
import signal
import sys
import time

import pytest

from remind_jax.cli import process


def drop(number):
    """Sends a signal where Python drops what is raised, and waits."""

    class Dropped:
        def __del__(self):
            os.kill(os.getpid(), number)
            time.sleep(0)  # the signal is heard between two steps of Python

    Dropped()
    time.sleep(30)


def import_slowly():
    assert importlib.import_module("slow_to_import").is_read
    time.sleep(30)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_signal_within_a_callback_is_not_lost(number):
    former = signal.signal(number, signal.default_int_handler)  # a background job ignores Ctrl-C
    began = time.monotonic()
    try:
        with pytest.raises(KeyboardInterrupt), process.ending_well() as signals:
            drop(number)
        assert set(signals) == {number}
        assert time.monotonic() - began < 20  # whatever waits is woken
    finally:
        signal.signal(number, former)


def test_a_signal_within_an_import_waits_for_its_end(tmp_path, monkeypatch):
    lines = ("import os, signal", "os.kill(os.getpid(), signal.SIGTERM)", "is_read = True")
    (tmp_path / "slow_to_import.py").write_text("\n".join(lines))
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), process.ending_well():
        import_slowly()
    assert "slow_to_import" in sys.modules


def test_the_hook_of_others_hears_what_is_no_signal(monkeypatch):
    heard = []
    monkeypatch.setattr(sys, "unraisablehook", heard.append)

    class Broken:
        def __del__(self):
            raise ValueError("broken")

    with process.ending_well():
        Broken()
    assert [type(one.exc_value) for one in heard] == [ValueError]


def test_platforms_that_jax_does_not_have_are_told(monkeypatch):
    import jax

    def devices():
        raise AssertionError

    monkeypatch.setattr(jax, "devices", devices)
    monkeypatch.setenv("JAX_PLATFORMS", "cuda")
    assert "JAX_PLATFORMS=cuda: it finds no such device" in process.find_jax_fault()
    monkeypatch.undo()
    assert process.find_jax_fault() == ""


def test_an_import_that_never_ends_is_ended(tmp_path, monkeypatch):
    monkeypatch.setattr(process, "_MOST_TIMES", 3)
    lines = "import os, signal, time\nos.kill(os.getpid(), signal.SIGTERM)\ntime.sleep(30)\n"
    (tmp_path / "endless_to_import.py").write_text(lines)
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(KeyboardInterrupt), process.ending_well():
        importlib.import_module("endless_to_import")
