"""What a sweep has found so far, one line per setting and scene, written as it comes.

A row is known by a key of everything that it depends on. A sweep that is stopped, or repeated with
more settings, does again nothing that is there; a line cut off in writing counts as missing.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from remind_jax.errors import OutputError
from remind_jax.files import locked, writing
from remind_jax.sweeps.settings import Setting

FILE_NAME = "rows.jsonl"


@dataclasses.dataclass(frozen=True)
class Row:
    """How one setting did on one scene."""

    key: str
    scene: str
    setting: Setting
    scores: dict[str, float]


def row_key(scene: str, setting: Mapping[str, Any], origin: Mapping[str, Any]) -> str:
    """Names a row by its scene, its setting and what is common to the sweep."""
    text = json.dumps([scene, dict(sorted(setting.items())), origin], sort_keys=True, default=str)
    return hashlib.sha256(text.encode()).hexdigest()[:20]


class Records:
    """Rows of a folder, or of this run only if there is none."""

    def __init__(self, folder: str | Path | None) -> None:
        """Reads the rows that are there.

        Raises:
          OutputError: If the folder cannot be made or read.
        """
        self._file = None if folder is None else Path(folder) / FILE_NAME
        self._rows: dict[str, Row] = {}
        self._read()

    @contextlib.contextmanager
    def locked(self) -> Iterator[None]:
        """Keeps other processes from the folder; rows that they have written are known inside.

        Raises:
          OutputError: If another process has it.
        """
        if self._file is None:
            yield
            return
        with locked(self._file.parent):
            if not self._read():
                self._write("\n")  # a line that was cut off ends here
            yield

    def _read(self) -> bool:
        """Reads the rows that are there; False if the last line was cut off."""
        if self._file is None:
            return True
        try:
            self._file.parent.mkdir(parents=True, exist_ok=True)
            text = self._file.read_text(encoding="utf-8") if self._file.exists() else ""
        except OSError as error:
            raise OutputError(
                f"cannot use sweep folder '{self._file.parent}': {error.strerror}"
            ) from error
        for line in text.splitlines():
            if (row := _parse(line)) is not None:
                self._rows[row.key] = row
        return not text or text.endswith("\n")

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

    def add(self, rows: Iterable[Row]) -> None:
        """Keeps rows, on disk before anything else happens.

        Raises:
          OutputError: If they cannot be written.
        """
        rows = list(rows)
        lines = [json.dumps(dataclasses.asdict(row), separators=(",", ":")) for row in rows]
        self._write("".join(line + "\n" for line in lines))
        self._rows.update((row.key, row) for row in rows)

    def _write(self, text: str) -> None:
        if self._file is None:
            return
        with writing(self._file), self._file.open("a", encoding="utf-8") as stream:
            stream.write(text)


def _parse(line: str) -> Row | None:
    """A row, or None if the line was cut off or is none."""
    try:
        return Row(**json.loads(line))
    except (json.JSONDecodeError, TypeError):
        return None
