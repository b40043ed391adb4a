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
        items = values if isinstance(values, list | tuple) else [values]
        device = getattr(items[0], "device", "cpu")
        where = "" if device == "cpu" else f" of device '{device}'"
        kinds = [*dict.fromkeys(type(one).__name__ for one in items)]
        why = f"some are {' and '.join(kinds[:2])}" if len(kinds) > 1 else first_line(error)
        raise SourceError(
            f"{what}{where} make no array that NumPy can read ({why}); give one array of numbers "
            "on the host, in PyTorch by .cpu()"
        ) from error
