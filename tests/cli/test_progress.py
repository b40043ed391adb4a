"""Progress bar and Ctrl-C."""

import os
import signal

import pytest

from remind_jax.cli.progress import RunDisplay
from remind_jax.session.progress import Progress


def progress(num_done: int, num_frames: int | None = 10) -> Progress:
    return Progress(num_done, num_frames, 12.3, 4, 0.25)


def test_first_interrupt_ends_the_run_after_the_frame():
    with RunDisplay("rooms", 10, is_shown=False) as display:
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            display(progress(1))


def test_second_interrupt_ends_it_at_once():
    with RunDisplay("rooms", 10, is_shown=False):
        os.kill(os.getpid(), signal.SIGINT)
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)


def test_interrupt_during_the_last_frame_changes_nothing():
    with RunDisplay("rooms", 10, is_shown=False) as display:
        os.kill(os.getpid(), signal.SIGINT)
        display(progress(10))


def test_handler_is_put_back():
    before = signal.getsignal(signal.SIGINT)
    with RunDisplay("rooms", 10, is_shown=False):
        assert signal.getsignal(signal.SIGINT) != before
    assert signal.getsignal(signal.SIGINT) == before
