"""The examples in docstrings of the public names run, and there are some."""

import doctest
import importlib

import pytest

import remind_jax as rj

WITH_EXAMPLES = (rj.run, rj.Tracker, rj.load_config, rj.Detections.create)


@pytest.mark.parametrize("documented", WITH_EXAMPLES, ids=lambda one: one.__qualname__)
def test_examples_run(documented):
    module = importlib.import_module(documented.__module__)
    found = doctest.DocTestFinder(recurse=False).find(
        documented, documented.__qualname__, globs=vars(module).copy()
    )
    assert sum(len(test.examples) for test in found) > 1
    runner = doctest.DocTestRunner()
    for test in found:
        assert runner.run(test).failed == 0
