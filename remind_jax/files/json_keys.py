"""Keys that stand twice in a mapping of JSON.

`msgspec` keeps the last of them without a word. The standard library hands over the pairs of every
mapping as it reads them, which takes about ten nanoseconds a byte; where the key stands is found
out only once there is one.
"""

from __future__ import annotations

import json
import re
from typing import Any

from remind_jax.files.wording import place_in_words, show

MOST_BYTES = 64 << 20  # larger text is not looked through: half a second
_TOKEN = re.compile(r'"(?:[^"\\]|\\.)*"|[{}\[\]:,]', re.DOTALL)


def say_twice(data: bytes, *, is_shallow: bool = False) -> str:
    """The rest of a sentence on the first key that stands twice; nothing if none does.

    Args:
      data: JSON that is sound otherwise.
      is_shallow: Look at mappings outside of lists only.
    """
    if data.count(b":") < 2 or len(data) > MOST_BYTES:
        return ""
    found: list[bool] = []

    def look(pairs: list[tuple[str, Any]]) -> None:
        if len({key for key, _ in pairs}) < len(pairs):
            found[:] = [True]

    try:
        json.loads(data, object_pairs_hook=look)
    except (ValueError, RecursionError):
        return ""
    is_list = data.lstrip()[:1] == b"["
    if not found or (is_shallow and is_list):
        return ""
    located = _locate(data.decode("utf-8"), is_shallow)
    if located is None:
        return ""
    place, key = located
    return f"{place_in_words(place)}: the key {show(key)} stands twice; remove one"


def _locate(text: str, is_shallow: bool) -> tuple[str, str] | None:
    """Path of the first mapping with a key that stands twice, and that key; see `say_twice`."""
    keys: list[set[str] | None] = []  # of the open mappings; None for lists
    path: list[str] = []
    last = ""
    for match in _TOKEN.finditer(text):
        token = match[0]
        if token in "{[":
            keys.append(set() if token == "{" else None)
            path.append("" if token == "{" else "[0]")
        elif token in "}]":
            keys.pop()
            path.pop()
        elif token == ":":
            known, key = keys[-1], json.loads(last)
            if known is not None and key in known and not (is_shallow and None in keys):
                return "$" + "".join(path[:-1]), key
            if known is not None:
                known.add(key)
            path[-1] = f".{key}"
        elif token == "," and keys and keys[-1] is None:
            path[-1] = f"[{int(path[-1][1:-1]) + 1}]"
        else:
            last = token
    return None
