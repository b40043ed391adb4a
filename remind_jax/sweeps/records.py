"""What a sweep has found so far, one line per setting and scene, written as it comes.

A row is known by a key of everything that it depends on. A sweep that is stopped, or repeated with
more settings, does again nothing that is there; a line cut off in writing, or damaged since, counts
as missing.
"""

from __future__ import annotations

import contextlib
import dataclasses
import hashlib
import json
import math
from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Any

import msgspec
from msgspec import Meta

from remind_jax.errors import OutputError
from remind_jax.files import locked, records, writing
from remind_jax.metrics.evaluation import without_nan
from remind_jax.sweeps.program import SCORES
from remind_jax.sweeps.settings import Setting

FILE_NAME = "rows.jsonl"
_START = b'{"key":"'  # of every line, cut off or not


_Share = Annotated[float, Meta(ge=0, le=1)]
_FiledScores = msgspec.defstruct(
    "_FiledScores",
    [(name, int if name == "Identities" else _Share | None) for name in SCORES],
    frozen=True,
    forbid_unknown_fields=True,
)


class _FiledRow(msgspec.Struct, frozen=True):
    """A line of the file; a score that a scene has none of is null."""

    key: Annotated[str, Meta(min_length=1, max_length=64)]
    scene: records.Text
    setting: dict[records.Text, bool | int | float]
    scores: _FiledScores  # pyright: ignore[reportInvalidTypeForm]


_DECODER = msgspec.json.Decoder(_FiledRow)


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
            if not self._file.exists():
                return True
            is_whole = True
            for number, line in records.read_lines(self._file, refused=OutputError):
                if number == 1 and not _START.startswith(line[: len(_START)]):
                    raise OutputError(
                        f"'{self._file}' holds no rows of a sweep; choose another output folder, "
                        "or remove it"
                    )
                # One that was cut off or damaged is left out, to be made again.
                with contextlib.suppress(msgspec.DecodeError, RecursionError, UnicodeDecodeError):
                    row = _decode(line)
                    self._rows[row.key] = row
                is_whole = line.endswith(b"\n")
            return is_whole
        except OSError as error:
            raise OutputError(
                f"cannot use sweep folder '{self._file.parent}': {error.strerror}"
            ) from error

    def __contains__(self, key: str) -> bool:
        return key in self._rows

    def __getitem__(self, key: str) -> Row:
        return self._rows[key]

    def add(self, rows: Iterable[Row]) -> None:
        """Keeps rows, on disk before anything else happens."""
        rows = list(rows)
        self._write("".join(_line(row) + "\n" for row in rows))
        self._rows.update((row.key, row) for row in rows)

    def _write(self, text: str) -> None:
        if self._file is None:
            return
        with writing(self._file), self._file.open("a", encoding="utf-8") as stream:
            stream.write(text)


def _line(row: Row) -> str:
    content = {**vars(row), "scores": without_nan(row.scores)}
    return json.dumps(content, separators=(",", ":"))


def _decode(line: bytes) -> Row:
    filed = _DECODER.decode(line)
    scores = {
        name: math.nan if score is None else score
        for name, score in msgspec.structs.asdict(filed.scores).items()
    }
    return Row(filed.key, filed.scene, filed.setting, scores)
