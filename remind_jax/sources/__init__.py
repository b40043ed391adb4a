"""Where frames come from: video, folders, DAVIS, ScanNet++, arrays, features, cameras, streams."""

from remind_jax.sources.detections import detections_from
from remind_jax.sources.live_source import LiveSource
from remind_jax.sources.opening import open_source, reopen_source
from remind_jax.sources.prefetch import prefetch
from remind_jax.sources.sampling import Sampling
from remind_jax.sources.source import Source

__all__ = [
    "LiveSource",
    "Sampling",
    "Source",
    "detections_from",
    "open_source",
    "prefetch",
    "reopen_source",
]
