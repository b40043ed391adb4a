"""Thresholds of the paper's tracker for the features of any backbone."""

from remind_jax.calibration.calibrate import Calibration as Calibration
from remind_jax.calibration.calibrate import calibrate as calibrate
