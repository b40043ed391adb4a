"""A quick reader of comma-separated plain decimals, the bulk of every MOTChallenge file.

Reading is most of the time of an evaluation, and general number parsers most of the reading. Plain
decimals of at most 15 digits are an integer below 2^53 over a power of ten, so one division gives
the correctly rounded value for a whole column at once.
"""

from __future__ import annotations

import numpy as np
from jaxtyping import Float, UInt8

_NEWLINE, _COMMA, _MINUS, _DOT, _ZERO = (ord(char) for char in "\n,-.0")
_MAX_DIGITS = 15

# Text parsed in one go: temporaries of this size stay in the cache.
_BLOCK_BYTES = 1 << 17

_POWERS_OF_TEN = 10.0 ** np.arange(_MAX_DIGITS + 1)


def parse_decimal_table(
    text: bytes, max_columns: int | None = None
) -> Float[np.ndarray, "rows columns"] | None:
    """Reads a table of plain decimals such as `12`, `-3.50` with rows of one length.

    Args:
      text: Rows end with a newline, cells are separated by commas.
      max_columns: How many columns to return, if there are more.

    Returns:
      The table; nothing if the text is anything else (spaces, exponents, blank or ragged rows, more
      than 15 digits, ...), which is for a general parser to read or to complain about.
    """
    text = text.replace(b"\r\n", b"\n").rstrip(b"\n") + b"\n"
    if text.translate(None, b"0123456789.-,\n"):
        return None
    tables = []
    start = 0
    while start < len(text):
        stop = text.find(b"\n", start + _BLOCK_BYTES) + 1 or len(text)
        table = _parse_block(np.frombuffer(text, np.uint8, stop - start, start), max_columns)
        if table is None or (tables and table.shape[1] != tables[0].shape[1]):
            return None
        tables.append(table)
        start = stop
    return np.concatenate(tables)


def _parse_block(
    chars: UInt8[np.ndarray, "bytes"], max_columns: int | None
) -> Float[np.ndarray, "rows columns"] | None:
    stop = np.flatnonzero((chars == _NEWLINE) | (chars == _COMMA))
    row_stop = np.flatnonzero(chars[stop] == _NEWLINE) + 1
    num_columns = int(row_stop[0])
    if np.any(np.diff(row_stop) != num_columns):
        return None
    start = np.concatenate([[0], stop[:-1] + 1])
    is_negative = chars[start] == _MINUS
    is_dot = chars == _DOT
    num_dots = np.diff(np.cumsum(is_dot, dtype=np.int32)[stop], prepend=0)
    num_digits = stop - start - is_negative - num_dots
    if (
        num_digits.min() < 1
        or num_digits.max() > _MAX_DIGITS
        or num_dots.max() > 1
        or np.count_nonzero(is_negative) != np.count_nonzero(chars == _MINUS)
    ):
        return None
    num_decimals = np.zeros(len(stop), np.int64)
    has_dot = np.flatnonzero(num_dots)
    num_decimals[has_dot] = stop[has_dot] - np.flatnonzero(is_dot) - 1
    start, stop, num_decimals, is_negative = (
        cells.reshape(-1, num_columns)[:, :max_columns]
        for cells in (start, stop, num_decimals, is_negative)
    )
    value = _read_digits(chars, start, stop) / _POWERS_OF_TEN[num_decimals]
    return np.negative(value, out=value, where=is_negative)


def _read_digits(chars: np.ndarray, start: np.ndarray, stop: np.ndarray) -> np.ndarray:
    """The digits of every cell as one integer, signs and dots passed over."""
    columns = []
    for first, last in zip(start.T.copy(), stop.T.copy(), strict=True):
        value = np.zeros(len(first), np.int64)
        for place in range(int((last - first).max())):
            at = np.minimum(first + place, last)
            digit = chars[at] - np.uint8(_ZERO)  # wraps around to 10 or more for other characters
            value = np.where(digit < 10, value * 10 + digit, value)
        columns.append(value)
    return np.stack(columns, axis=1)
