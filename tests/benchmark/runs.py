"""Runs of a benchmark for tests."""

from remind_jax.benchmark.contenders import make_contenders
from remind_jax.benchmark.running import run_all

METHODS = ("bank", "iou")  # quick to compile


def run(setup, scenes, methods=METHODS):
    """Records, and the runs that were not there yet."""
    new = []

    def report(record, was_there):
        if not was_there:
            new.append((record.scene, record.contender))

    return run_all(setup, scenes, make_contenders(methods), report), new
