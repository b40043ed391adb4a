"""Rows of CSV files, in which no spreadsheet takes text for a formula."""

from __future__ import annotations

import csv
import io
import re
from collections.abc import Iterable
from typing import Any

GUARD = "'"
_NUMBER = re.compile(r"[+-]?([0-9]+\.?[0-9]*|\.[0-9]+)(e[+-]?[0-9]+)?", re.ASCII | re.IGNORECASE)
_GUARDED = ("=", "+", "-", "@", "\t", "\r", "\n", GUARD)


def guard_cell(value: Any) -> Any:
    """The cell to write for a value."""
    if not isinstance(value, str) or not value.startswith(_GUARDED) or _NUMBER.fullmatch(value):
        return value
    return GUARD + value


def csv_text(rows: Iterable[Iterable[Any]]) -> str:
    """Rows as they stand in a file, with their text guarded."""
    file = io.StringIO()
    for cells in rows:
        guarded = [guard_cell(cell) for cell in cells]
        # A lone carriage return is quoted with everything only, and ends a row without quotes.
        is_broken = any(isinstance(cell, str) and "\r" in cell for cell in guarded)
        quoting = csv.QUOTE_ALL if is_broken else csv.QUOTE_MINIMAL
        csv.writer(file, lineterminator="\n", quoting=quoting).writerow(guarded)
    return file.getvalue()


def unguard_cell(text: str) -> str:
    """The text that a cell was written for."""
    return text.removeprefix(GUARD)
