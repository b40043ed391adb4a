"""Time, counted in ticks of a tenth of a second, whatever the camera (method_plus.md#clock).

Of a fast camera many frames are one tick: what they show is followed frame by frame, but counts
once. Of a slow camera every frame is a tick, for nothing was seen in between.
"""

from __future__ import annotations

import jax.numpy as jnp
from jaxtyping import Array, Float

TICK_S = 0.1  # seconds
SLACK = 0.01  # ticks; times of frames are rounded
LEAST_TICK = 0.01  # between two frames
MISSED_TICKS = 8.0 - SLACK  # a tracklet survives this long without a detection
SLOW_TICKS = 2.0  # from here on, frames are so far apart that few of them have to suffice ...
MOST_SHARE = 7 / 3  # ... to decide: four at least, of `decision.commit_age` = 8 ticks


def tick_of(elapsed: Float[Array, ""]) -> Float[Array, ""]:
    """Time since the last frame as far as it counts, in ticks, one at most."""
    return jnp.clip(elapsed, LEAST_TICK, 1.0)


def share_in_deciding(elapsed: Float[Array, ""]) -> Float[Array, ""]:
    """By how much the wait for a decision is shortened by a frame, in ticks."""
    return jnp.maximum(tick_of(elapsed), jnp.minimum(elapsed / SLOW_TICKS, MOST_SHARE))
