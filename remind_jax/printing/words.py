"""Numbers, comparisons and lists as people write them."""

from __future__ import annotations

import operator
from collections.abc import Sequence

_DIGITS = (3, 4, 6, 9)  # tried in turn until a comparison can be read off
_HOLDS = {">=": operator.ge, ">": operator.gt, "<=": operator.le, "<": operator.lt}


def number(value: float) -> str:
    """Two decimals, three for what would look like nothing."""
    return f"{value:.3f}" if 0 < abs(value) < 0.01 else f"{value:.2f}"


def compare(value: float, sign: str, limit: float) -> str:
    """`0.71 >= 0.65`, with as many decimals as it takes to see that it holds."""
    shown = number(value)
    for digits in _DIGITS:
        if _HOLDS[sign](float(shown), limit):
            break
        shown = f"{value:.{digits}f}"
    return f"{shown} {sign} {threshold(limit)}"


def threshold(limit: float) -> str:
    """A threshold with the decimals that it was given in, two at least."""
    return max(f"{limit:.2f}", f"{limit:.9f}".rstrip("0"), key=len)


def change(value: float) -> str:
    """With its sign."""
    return f"{value:+.2f}"


def plural(count: int, one: str, many: str | None = None) -> str:
    """`1 mug`, `3 mugs`."""
    return f"{count} {one if count == 1 else many or one + 's'}"


def listing(items: Sequence[str], word: str = "and") -> str:
    """`a`, `a and b`, `a, b and c`."""
    if len(items) < 2:
        return "".join(items)
    return f"{', '.join(items[:-1])} {word} {items[-1]}"


def first_of(items: Sequence[str], most: int) -> str:
    """`a, b and 3 more`: so many at most."""
    rest = len(items) - most
    return ", ".join(items[:most]) + (f" and {rest} more" if rest > 0 else "")


def sentence(text: str) -> str:
    """With a capital and a full stop."""
    return f"{text[:1].upper()}{text[1:]}."
