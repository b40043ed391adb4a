"""REMIND plus under its name among the trackers (`remind_jax.methods`)."""

from remind_jax.image_motion import observe_motion
from remind_jax.methods import Method
from remind_jax.plus.revision import DelayedAnswers, report_merges
from remind_jax.plus.state import init
from remind_jax.plus.thresholds import PlusThresholds
from remind_jax.plus.tracker import step, step_traced

METHOD = Method(
    "plus",
    PlusThresholds,
    init,
    step,
    observe=observe_motion,
    report=report_merges,
    delayed=DelayedAnswers,
    step_traced=step_traced,
    archive_name="remind_jax.plus.archive:PlusArchive",
)
