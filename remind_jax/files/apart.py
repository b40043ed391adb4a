"""Inputs that an output would lie on: refused before anything is written."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

from remind_jax.errors import OutputError


def refuse_folder(
    folder: Path, inputs: Iterable[Any], *, is_ours: bool = True, may_hold: bool = False
) -> None:
    """Makes sure that files of an output folder never come among the inputs.

    Args:
      is_ours: Whether the folder holds nothing, or what was written by us. Another one is refused
        below a folder that is read: it may be the one of the images.

    Raises:
      OutputError: If the folder is an input, or holds one.
    """
    out = _resolve(folder)
    for path in map(_resolve, _paths(inputs)):
        if out == path or (out in path.parents and not may_hold):
            what = "is" if out == path else "holds"
            raise OutputError(
                f"the output folder '{folder}' {what} the input '{path}', which would be mixed up "
                "with what is written; choose another folder"
            )
        if path in out.parents and not is_ours:
            raise OutputError(
                f"the output folder '{folder}' lies in the input '{path}' and holds other files; "
                "choose an empty or another folder"
            )


def refuse_file(
    file: Path, inputs: Iterable[Any], *, is_read: Callable[[str], bool] = lambda name: True
) -> None:
    """Makes sure that a file that is written replaces nothing that is read.

    Args:
      is_read: Which names of files in such a folder are read; all if left out.

    Raises:
      OutputError: If the file is an input, or one of the files of an input folder.
    """
    out = _resolve(file)
    for path in map(_resolve, _paths(inputs)):
        if out == path or (path in out.parents and out.exists() and is_read(out.name)):
            where = "is" if out == path else f"belongs to '{path}', which is"
            raise OutputError(f"the output '{file}' {where} an input; choose another name")


def _paths(values: Iterable[Any]) -> list[Path]:
    return [Path(value) for value in values if isinstance(value, (str, os.PathLike))]


def _resolve(path: Path) -> Path:
    """Where a path leads to, links followed. Raises OutputError if it leads nowhere."""
    try:
        return path.expanduser().resolve()
    except (OSError, RuntimeError, ValueError) as error:
        why = getattr(error, "strerror", None) or str(error)
        raise OutputError(f"'{str(path)[:200]}' cannot be used: {why}") from error
