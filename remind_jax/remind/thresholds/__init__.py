"""Every tunable number of the paper's tracker, by the part of the method that reads it."""

from remind_jax.remind.thresholds.thresholds import Thresholds as Thresholds
