"""One step of a method as a function that can be jitted, scanned and vmapped."""

from collections.abc import Callable
from typing import Any

from remind_jax.compiled.frame_step import settle_types
from remind_jax.remind.method import METHOD


def step_once(
    state: Any,
    frame_feats: Any,
    masks: Any,
    observed: Any = None,
    *,
    static: Any,
    thresholds: Any,
    step: Callable[..., Any] = METHOD.step,
) -> Any:
    """The memory comes back in the types that it is given in."""
    return settle_types(
        step(state, frame_feats, masks, observed, static=static, thresholds=thresholds)
    )
