"""Names of a network's class columns, from the metadata that exporters write into the file."""

from __future__ import annotations

import ast
import json
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool

from remind_jax.detectors.options import DetectorOptions
from remind_jax.errors import ConfigError, nearest_names


def read_class_names(metadata: Mapping[str, str]) -> dict[int, str]:
    """Class index to name; empty if the file says nothing usable.

    Ultralytics writes `names` as a Python dictionary in text, RF-DETR (from 2026) writes
    `rfdetr_inference`, JSON with `class_id_to_name`.
    """
    if "rfdetr_inference" in metadata:
        inference = _literal(metadata["rfdetr_inference"])
        named = inference.get("class_id_to_name") if isinstance(inference, dict) else None
    else:
        named = _literal(metadata.get("names", ""))
    if isinstance(named, (list, tuple)):
        named = dict(enumerate(named))
    if not isinstance(named, dict):
        return {}
    try:
        return {int(index): str(name) for index, name in named.items()}
    except (TypeError, ValueError):
        return {}


def _literal(text: str) -> object:
    """The value of a JSON text or Python literal; None if it is neither. Nothing is executed."""
    for parse in (json.loads, ast.literal_eval):
        try:
            return parse(text)
        except (ValueError, SyntaxError, TypeError, MemoryError, RecursionError):
            continue
    return None


def find_wanted_classes(
    names: Sequence[str | None], options: DetectorOptions
) -> Bool[np.ndarray, "C"]:
    """Which class columns can give detections; columns without a name (None) never do.

    Raises:
      ConfigError: If `options.classes` names a class that the network does not know.
    """
    known = {name.casefold() for name in names if name is not None}
    for name in options.classes or ():
        if name.casefold() not in known:
            raise ConfigError(
                f"the detector has no class {name!r}; "
                f"{nearest_names(name, [n for n in names if n is not None])}"
            )
    return np.array([name is not None and options.admits(name) for name in names], bool)
