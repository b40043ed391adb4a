"""Tables that programs write into pages, between `<!-- MARK -->` and `<!-- end -->`."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

_BETWEEN = re.compile(r"(<!-- (\S+) -->\n).*?(<!-- end -->)", re.DOTALL)


def fill(page: str, tables: Mapping[str, str]) -> str:
    """The page with the tables at their marks; it may lack a mark, and other marks stay."""

    def put(found: re.Match[str]) -> str:
        mark = found[2]
        return f"{found[1]}\n{tables[mark].strip()}\n\n{found[3]}" if mark in tables else found[0]

    return _BETWEEN.sub(put, page)


def fill_file(page: Path, tables: Mapping[str, str]) -> None:
    """Fills a page in its file."""
    page.write_text(fill(page.read_text(encoding="utf-8"), tables), encoding="utf-8")


def marks(page: str) -> list[str]:
    """The marks of a page."""
    return [found[2] for found in _BETWEEN.finditer(page)]


def without_tables(page: str) -> str:
    """What was written by hand."""
    return _BETWEEN.sub("", page)
