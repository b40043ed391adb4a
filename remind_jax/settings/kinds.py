"""Kinds of thresholds: plain numbers in files and flags, traced arrays inside the tracker."""

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    Real = Any  # what may be done with it depends on the place, so it is not checked
    Whole = Any
    Gate = Any
else:
    Real, Whole, Gate = float, int, bool
