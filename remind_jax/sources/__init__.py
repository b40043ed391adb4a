"""Where frames come from: video, folders, DAVIS, ScanNet++, arrays, cameras, streams."""

from remind_jax.sources.detections import detections_from as detections_from
from remind_jax.sources.live_source import LiveSource as LiveSource
from remind_jax.sources.opening import open_source as open_source
from remind_jax.sources.opening import reopen_source as reopen_source
from remind_jax.sources.sampling import Sampling as Sampling
from remind_jax.sources.source import Source as Source
