"""Golden networks as converted files, made once per test run."""

import functools
import tempfile
from pathlib import Path

from safetensors.numpy import save_file

from remind_jax.backbone.vit_weights import Weights, load_weights
from tests.golden.vit import load as golden
from weights_convert.conversion import convert
from weights_convert.variant_detection import Wishes

_FOLDER = tempfile.TemporaryDirectory(prefix="remind-jax-networks-")


def converted_file(stem: str, rounded_periods: bool = False) -> Path:
    """A golden network from its official tensors."""
    network = golden.load(stem)
    folder = Path(_FOLDER.name) / f"{stem}-{rounded_periods}"
    out = folder / "converted.safetensors"
    if out.exists():
        return out
    folder.mkdir()
    save_file(network.official(rounded_periods), folder / "official.safetensors")
    wishes = Wishes(heads=network.config["heads"], custom=True)
    convert(folder / "official.safetensors", out, wishes=wishes)
    return out


@functools.cache
def converted(stem: str, rounded_periods: bool = False) -> Weights:
    """The same, loaded."""
    return load_weights(converted_file(stem, rounded_periods))
