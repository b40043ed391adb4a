"""Arrays of any library as NumPy reads them, where they lie if that is possible."""

from __future__ import annotations

from typing import Any

import numpy as np

from remind_jax.errors import SourceError, first_line


def host_array(values: Any, what: str) -> np.ndarray:
    """The values as a NumPy array; those of another library on the host are not copied.

    Libraries are asked by `__array__`, else by DLPack. A tensor of PyTorch that gradients flow
    through is taken without them.

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
        device = getattr(values[0] if isinstance(values, list | tuple) else values, "device", "")
        where = f" of device '{device}'" if device else ""
        raise SourceError(
            f"{what}{where} make no array that NumPy can read ({first_line(error)}); give one "
            "array of numbers on the host, in PyTorch by .cpu()"
        ) from error
