"""Small products of the host on one thread.

Threads of BLAS wait for each other, computing all the while: where another process holds a core, a
product of a tenth of a millisecond takes twenty.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

import numpy as np  # noqa: F401  (loads the library whose threads are counted)
import threadpoolctl

_Function = TypeVar("_Function", bound=Callable)

_controller = threadpoolctl.ThreadpoolController()


def on_one_thread(function: _Function) -> _Function:
    """The same function, within which NumPy's products take one thread."""
    return _controller.wrap(limits=1, user_api="blas")(function)
