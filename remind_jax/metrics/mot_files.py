"""Rows of MOTChallenge text (boxes) and MOTS / KITTI-MOTS text (masks).

MOTChallenge row: `frame,id,left,top,width,height,flag or score,class,visibility`; MOTS row:
`frame id class height width rle`. Rows come back ordered by frame, otherwise as in the file.
"""

from __future__ import annotations

import dataclasses
import io
from pathlib import Path
from typing import Literal

import numpy as np
from jaxtyping import Bool, Float, Int

from remind_jax.errors import SourceError
from remind_jax.metrics.decimal_text import parse_decimal_table
from remind_jax.metrics.run_lengths import find_malformed
from remind_jax.tracks import Rle

FileFormat = Literal["mot", "mots", "kitti-mots"]

MOTS_CLASSES = {1: "car", 2: "pedestrian"}
MOTS_IGNORE_CLASS = 10

# A larger number is a time stamp or a damaged row; memory is taken by the number of frames.
MAX_FRAMES = 10_000_000

# Of frame,id,left,top,width,height,flag,class,...
_MOT_COLUMNS = 8

# Whole numbers up to here are exact as floats.
_MAX_WHOLE = 2.0**53


@dataclasses.dataclass(frozen=True)
class BoxRows:
    """Rows of a MOTChallenge file."""

    frame: Int[np.ndarray, "N"]  # as in the file, counted from 1
    track_id: Int[np.ndarray, "N"]
    boxes: Float[np.ndarray, "N 4"]  # left, top, right, bottom in pixels
    flag: Float[np.ndarray, "N"]  # ground truth: 0 is to be ignored; predictions: score
    class_id: Int[np.ndarray, "N"]  # -1 where the file has none

    def select(self, keep: Bool[np.ndarray, "N"]) -> BoxRows:
        """The rows at `keep`, in that order."""
        columns = (getattr(self, field.name)[keep] for field in dataclasses.fields(self))
        return BoxRows(*columns)


@dataclasses.dataclass(frozen=True)
class MaskRows:
    """Rows of a MOTS file."""

    frame: Int[np.ndarray, "N"]  # as in the file, counted from 1 (MOTS) or 0 (KITTI-MOTS)
    track_id: Int[np.ndarray, "N"]
    class_id: Int[np.ndarray, "N"]
    rles: tuple[Rle, ...]

    def select(self, keep: Bool[np.ndarray, "N"]) -> MaskRows:
        """The rows at `keep`, in that order."""
        rles = tuple(self.rles[row] for row in np.flatnonzero(keep))
        return MaskRows(self.frame[keep], self.track_id[keep], self.class_id[keep], rles)


def recognise_format(*paths: str | Path) -> FileFormat:
    """Tells MOTChallenge text from MOTS text by the first row of the first file that has one.

    Raises:
      SourceError: If a first row fits neither.
    """
    found: FileFormat = "mot"
    for path in paths:
        lines = _read_text(path).splitlines()
        first = next((line for line in lines if line.strip()), None)
        if first is None:
            continue
        if "," not in first and len(first.split()) == 6:
            starts_at_zero = any(line.split(" ", 1)[0] == "0" for line in lines)
            return "kitti-mots" if starts_at_zero else "mots"
        if len(_split_row(first)) < 6:
            raise SourceError(
                f"{path} is neither MOTChallenge text (frame,id,left,top,width,height,...) "
                f"nor MOTS text (frame id class height width rle); its first row is '{first[:60]}'"
            )
        return found
    return found


def read_mot_rows(path: str | Path) -> BoxRows:
    """Reads a MOTChallenge file; it may be empty.

    Raises:
      SourceError: If the file is missing, or a row is not numeric or has fewer than 6 columns.
    """
    table = _parse_numbers(path)
    table = _order_by_frame(table)
    boxes = table[:, 2:6].copy()
    boxes[:, 2:] += boxes[:, :2]
    flag = table[:, 6] if table.shape[1] > 6 else np.ones(len(table))
    class_id = table[:, 7].astype(np.int64) if table.shape[1] > 7 else np.full(len(table), -1)
    return BoxRows(
        table[:, 0].astype(np.int64), table[:, 1].astype(np.int64), boxes, flag, class_id
    )


def read_mots_rows(path: str | Path) -> MaskRows:
    """Reads a MOTS or KITTI-MOTS file; it may be empty.

    Raises:
      SourceError: If the file is missing, or a row does not have its six columns.
    """
    numbers: list[tuple[int, int, int]] = []
    rles: list[Rle] = []
    for line_number, line in enumerate(_read_text(path).splitlines(), 1):
        if not line.strip():
            continue
        try:
            frame, track_id, class_id, height, width, counts = line.split()
            numbers.append((int(frame), int(track_id), int(class_id)))
            rles.append({"size": [int(height), int(width)], "counts": counts.encode()})
        except ValueError:
            raise SourceError(
                f"{path}, line {line_number}: '{line[:60]}' is not a MOTS row; "
                "it needs frame id class height width rle, separated by spaces"
            ) from None
    wrong = find_malformed(rles)
    if wrong is not None:
        frame, track_id, _ = numbers[wrong]
        height, width = rles[wrong]["size"]
        raise SourceError(
            f"{path}, frame {frame}, id {track_id}: the run lengths are damaged or do not add up "
            f"to a mask of {height} x {width} pixels (height x width)"
        )
    rows = np.asarray([(*row, at) for at, row in enumerate(numbers)], np.int64).reshape(-1, 4)
    frame, track_id, class_id, place = _order_by_frame(rows).T
    return MaskRows(frame, track_id, class_id, tuple(rles[at] for at in place))


def _order_by_frame(table: np.ndarray) -> np.ndarray:
    if np.any(np.diff(table[:, 0]) < 0):
        return table[np.argsort(table[:, 0], kind="stable")]
    return table


def _read_bytes(path: str | Path) -> bytes:
    try:
        return Path(path).read_bytes()
    except OSError as error:
        raise SourceError(f"{path} cannot be read: {error.strerror}") from None


def _read_text(path: str | Path) -> str:
    try:
        return _read_bytes(path).decode("utf-8-sig")
    except UnicodeDecodeError:
        raise SourceError(f"{path} is not a text file; give MOTChallenge or MOTS text") from None


def _split_row(line: str) -> list[str]:
    return line.split(",") if "," in line else line.split()


def _parse_numbers(path: str | Path) -> Float[np.ndarray, "N columns"]:
    table = parse_decimal_table(_read_bytes(path), _MOT_COLUMNS)
    if table is None:
        table = _parse_any_numbers(path)
    if table.shape[1] < 6 or not np.isfinite(table[:, :6]).all():
        raise SourceError(
            f"{path} has rows of {table.shape[1]} columns; MOTChallenge needs frame,id,left,top,"
            "width,height and finite numbers"
        )
    whole = table[:, :2]
    wrong = np.argwhere((whole != np.round(whole)) | (np.abs(whole) > _MAX_WHOLE))
    if len(wrong):
        row, column = wrong[0]
        raise SourceError(
            f"{path}, row {row + 1}: {('frame', 'id')[column]} is {whole[row, column]}; "
            "it must be a whole number"
        )
    return table


def _parse_any_numbers(path: str | Path) -> Float[np.ndarray, "N columns"]:
    text = _read_text(path)
    if not text.strip():
        return np.zeros((0, 10))
    delimiter = "," if "," in text.split("\n", 1)[0] else None
    try:
        return np.loadtxt(io.StringIO(text), delimiter=delimiter, ndmin=2, comments=None)
    except ValueError:
        number, row = _find_bad_row(text, delimiter)
        raise SourceError(
            f"{path} is not MOTChallenge text: row {number} is '{row[:60]}'; every row needs the "
            "same columns of numbers, frame,id,left,top,width,height,..."
        ) from None


def _find_bad_row(text: str, delimiter: str | None) -> tuple[int, str]:
    """Number and text of the first row that is not numeric or not as long as the first."""
    rows = [(number, row) for number, row in enumerate(text.splitlines(), 1) if row.strip()]
    for number, row in rows:
        cells = row.split(delimiter)
        try:
            is_good = len([float(cell) for cell in cells]) == len(rows[0][1].split(delimiter))
        except ValueError:
            is_good = False
        if not is_good:
            return number, row.strip()
    return rows[0]
