"""Arrays of any library as NumPy reads them, where they lie if that is possible."""

from __future__ import annotations

from typing import Any

import numpy as np

from remind_jax.errors import SourceError, first_line


def host_array(values: Any, what: str) -> np.ndarray:
    """The values as a NumPy array; those of another library on the host are not copied.

    Libraries are asked by `__array__`, else by DLPack. A tensor of PyTorch that gradients flow
    through is taken without them.

    Args:
      values: An array of any library, or nested sequences of numbers.
      what: Their name in a sentence, a plural.

    Raises:
      SourceError: If they lie where NumPy cannot read them, or make no array.
    """
    if isinstance(values, np.ma.MaskedArray):
        raise SourceError(
            f"{what} are a masked array, parts of which are no values; fill them, by .filled(0)"
        )
    if isinstance(values, np.ndarray):
        return values
    if getattr(values, "requires_grad", False) is True:
        values = values.detach()
    try:
        if hasattr(values, "__dlpack__") and not hasattr(values, "__array__"):
            return np.from_dlpack(values)
        return np.asarray(values)
    except MemoryError:
        raise
    except Exception as error:  # of somebody else's code
        if (place := _other_memory(values)) is not None:
            raise SourceError(
                f"{what} lie in the memory of device '{place}', where NumPy cannot read them; give "
                "them on the host, in PyTorch by .cpu()"
            ) from error
        raise SourceError(
            f"{what} make no array: they differ in shape or kind ({first_line(error)}); give one "
            "array of numbers"
        ) from error


def _other_memory(values: Any) -> str | None:
    """The device that holds an array, or the first of several; None for the host."""
    first: Any = values[0] if isinstance(values, list | tuple) and values else values
    device = getattr(first, "device", None)
    if device is not None:
        return None if str(device) == "cpu" else str(device)
    if hasattr(first, "__dlpack_device__"):
        try:
            kind = int(first.__dlpack_device__()[0])
        except Exception:  # of somebody else's code
            return None
        return None if kind == _HOST else _DEVICES.get(kind, f"kind {kind}")
    return None


# By the numbers of DLPack.
_HOST = 1
_DEVICES = {2: "cuda", 8: "metal", 10: "rocm", 14: "oneapi"}
