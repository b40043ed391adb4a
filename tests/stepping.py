"""One step of a method as a function that can be jitted, scanned and vmapped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from remind_jax.compiled.frame_step import settle_types
from remind_jax.remind.tracker import step


def step_once(
    state: Any,
    frame_feats: Any,
    masks: Any,
    observed: Any = None,
    *,
    static: Any,
    thresholds: Any,
    step: Callable[..., Any] = step,
) -> Any:
    """The memory comes back in the types that it is given in."""
    more = {} if observed is None else {"observed": observed}
    return settle_types(
        step(state, frame_feats, masks, static=static, thresholds=thresholds, **more)
    )
