"""Where the parser of another version tells things otherwise, its own box is shown."""

from __future__ import annotations

import sys

import pytest

from remind_jax.cli import usage
from remind_jax.cli.flags import UsageError


def test_without_the_hook_nothing_is_explained(monkeypatch):
    monkeypatch.setitem(sys.modules, "tyro._errors", None)
    with usage.explained(None):
        done = True
    assert done
    empty = type(sys)("tyro._errors")
    monkeypatch.setitem(sys.modules, "tyro._errors", empty)
    with usage.explained(None):
        pass


class UnrecognizedArgs:
    """An event of the parser."""

    def __init__(self, tokens, prog="remind run"):
        self.tokens, self.prog = tokens, prog


@pytest.mark.parametrize("event", [UnrecognizedArgs([]), UnrecognizedArgs(None), object()])
def test_an_event_that_is_otherwise_is_left_to_the_parser(event, monkeypatch):
    hooks = []

    class Hooked:
        def __init__(self, hook):
            hooks.append(hook)

        def __enter__(self):
            return self

        def __exit__(self, *_):
            return False

    import tyro._errors

    monkeypatch.setattr(tyro._errors, "on_parse_error", Hooked)
    with usage.explained(None):
        hooks[0](event)
        with pytest.raises(UsageError, match="'word' is a word too many"):
            hooks[0](UnrecognizedArgs(["word"]))
