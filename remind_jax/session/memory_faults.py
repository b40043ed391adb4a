"""What is wrong with a memory that was read: what no run leaves, in arrays of the right shapes."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from remind_jax.decision import CODES, Decisions
from remind_jax.errors import ConfigError
from remind_jax.files.limits import MAX_LABEL
from remind_jax.method import Method, named_leaves
from remind_jax.numerics.absent import NO_ID
from remind_jax.numerics.array_faults import not_finite, outside, repeated
from remind_jax.session.announcement import Announcements


def check_first(state: Any, method: Method) -> None:
    """Refuses an empty memory that could not be read again from a file.

    Raises:
      ConfigError: If leaves share a name, or one is of another type than whole numbers, floats and
        flags, or not finite.
    """
    names = [name for name, _ in named_leaves(state)]
    for name, leaf in named_leaves(state):
        dtype = getattr(leaf, "dtype", type(leaf).__name__)
        if names.count(name) > 1:
            wrong = "has the name of another one"
        elif not isinstance(dtype, np.dtype) or dtype.kind not in "biuf":
            wrong = f"is of type {dtype}"
        elif not np.isfinite(leaf).all():
            wrong = "holds values that are not finite"
        else:
            continue
        raise ConfigError(
            f"leaf '{name}' of the memory of tracker '{method.name}' {wrong}; memories are finite "
            "numbers and flags under different names"
        )


def find_faults(
    state: Any,
    method: Method,
    class_names: tuple[str, ...],
    announced: Announcements,
    first_id: int,
) -> Iterator[str]:
    """What is wrong, as phrases."""
    for name, leaf in named_leaves(state):
        yield from not_finite(name, leaf)
    yield from outside("frame", state.frame, 0)
    yield from outside("next_id", state.next_id, first_id)
    ids = np.asarray(state.objects.id)
    used = ids != NO_ID
    yield from outside("objects.id", ids, first_id, int(state.next_id) - 1, used)
    yield from repeated("objects.id", ids[used])
    for name in class_names:
        if not isinstance(name, str) or len(name) > MAX_LABEL:
            yield f"a class is named {str(name)[:40]!r}; allowed: up to {MAX_LABEL} characters"
    yield from repeated("class_names", np.array(class_names, object))
    if hasattr(state.objects, "class_id"):
        last_class = len(class_names) - 1
        yield from outside("objects.class_id", state.objects.class_id, 0, last_class, used)
    yield from _of_decisions(state.decisions, int(state.next_id))
    yield from outside("overflow.objects", state.overflow.objects, 0)
    yield from outside("overflow.pending", state.overflow.pending, 0)
    yield from _of_announcements(announced, int(state.next_id))
    if method.host.find_faults is not None:
        yield from method.host.find_faults(state)


def _of_decisions(decisions: Decisions, next_id: int) -> Iterator[str]:
    """Of the last frame; they are shown, and ids among them."""
    for name, kind in CODES.items():
        codes = [int(code) for code in kind]
        yield from outside(f"decisions.{name}", getattr(decisions, name), min(codes), max(codes))
    for name in ("object_id", "candidate_id", "option_id"):
        values = getattr(decisions, name)
        yield from outside(f"decisions.{name}", values, NO_ID, max(next_id - 1, NO_ID))


def _of_announcements(announced: Announcements, next_id: int) -> Iterator[str]:
    if announced.known_below < 0 or announced.next_id < 0:
        yield "what was announced counts from below 0"
    for object_id, number in announced.ids.items():
        if not (0 <= object_id < next_id and 0 <= number < announced.next_id):
            yield f"object {object_id} was announced as {number}, which cannot be"
    for object_id, count in announced.counts.items():
        if not (0 <= object_id < next_id and count >= 0):
            yield f"object {object_id} was detected {count} times, which cannot be"
