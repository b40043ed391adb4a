"""A live run recorded without loss, as a folder that is a source like any other."""

from __future__ import annotations

import contextlib
import json
from pathlib import Path
from typing import Any

import cv2

from remind_jax.errors import OutputError
from remind_jax.files import as_path, make_folder, replace_file, writing
from remind_jax.formats.pictures import TIMES_NAME
from remind_jax.frame import NO_INSTANCE, Detections, Frame
from remind_jax.masks.run_length import encode_masks
from remind_jax.outputs.store import DETECTIONS_NAME, FrameWriter


class FrameRecord(contextlib.AbstractContextManager):
    """Writes frames as they are taken.

    Raises:
      OutputError: If it cannot be written, or is there and `overwrite` is False.
    """

    def __init__(self, target: str | Path, overwrite: bool = False) -> None:
        self.target = as_path(target, "the record of the frames", OutputError)
        if self.target.suffix:
            raise OutputError(
                f"frames cannot be recorded as '{self.target.suffix}'; give a folder, which gets "
                "them without loss"
            )
        is_taken = self.target.exists() and (not self.target.is_dir() or any(self.target.iterdir()))
        if is_taken and not overwrite:
            raise OutputError(
                f"'{self.target}' is there already; choose another name for the record or allow "
                "overwriting (--overwrite)"
            )
        self._num = 0

    def __enter__(self) -> FrameRecord:
        make_folder(self.target)
        with writing(self.target):
            for old in self.target.glob("[0-9]" * 6 + ".png"):
                old.unlink()
        self._rows = FrameWriter(self.target / DETECTIONS_NAME, "", self._say_detections)
        self._times = FrameWriter(self.target / TIMES_NAME, "", lambda f: f"{float(f.time_s)!r}\n")
        return self

    def __exit__(self, *raised: object) -> None:
        self._rows.close()
        self._times.close()
        if not self._num:  # nothing is recorded, and nothing is in the way of the next try
            for name in (DETECTIONS_NAME, TIMES_NAME):
                (self.target / name).unlink(missing_ok=True)

    def add(self, frame: Frame) -> None:
        """Writes a frame with its detections.

        Raises:
          OutputError: If the disk is full, or the frame has no image.
        """
        if frame.image is None:
            raise OutputError(f"frame '{frame.name}' has no image to record; leave out record")
        self._times.add(frame)  # first: where a recording is cut off, every picture has its time
        options = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # the sizes are near, the times are not
        pixels = cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
        png = cv2.imencode(".png", pixels, options)[1].tobytes()
        replace_file(self.target / f"{self._num:06d}.png", png)
        self._rows.add(frame)
        self._num += 1

    def _say_detections(self, frame: Frame) -> str:
        row = {
            "frame": self._num,
            "source_index": frame.source_index,
            "time_s": frame.time_s,
            "detections": [] if frame.detections is None else _rows_of(frame.detections),
        }
        return json.dumps(row, separators=(",", ":")) + "\n"


def _rows_of(detections: Detections) -> list[dict[str, Any]]:
    """Detections as `--masks` reads them."""
    codes = encode_masks(detections.masks)
    rows = []
    for row, code in enumerate(codes):
        content: dict[str, Any] = {
            "segmentation": {"size": code["size"], "counts": code["counts"].decode("ascii")},
            "score": float(detections.scores[row]),
            "label": detections.labels[row],
        }
        if detections.instance_ids[row] != NO_INSTANCE:
            content["instance_id"] = int(detections.instance_ids[row])
        rows.append(content)
    return rows
