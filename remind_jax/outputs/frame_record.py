"""A live run recorded: the frames that the tracker took, and their detections, without loss.

What is recorded is a source like any other, so that the run can be repeated:
`remind run seen/ --masks seen/detections.jsonl`. A folder gets one PNG per frame, a file (`.mkv`) a
lossless video (FFV1); detections go to `detections.jsonl` in the folder, or beside the file under
its name. Every frame is on disk when `add` returns.
"""

from __future__ import annotations

import contextlib
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
from av.error import FFmpegError

from remind_jax.errors import OutputError
from remind_jax.files import as_path, make_folder, replace_file, writing
from remind_jax.frame import NO_INSTANCE, Detections, Frame
from remind_jax.masks.run_length import encode_masks

DETECTIONS_NAME = "detections.jsonl"
VIDEO_SUFFIX = ".mkv"
_CLOCK = 1000  # ticks per second of the video, as Matroska counts


class FrameRecord(contextlib.AbstractContextManager):
    """Writes frames as they are taken.

    Args:
      target: A folder, or a video (`.mkv`).
      overwrite: Allow a folder with files in it, or a file that is there.

    Raises:
      OutputError: If it cannot be written, or is there and `overwrite` is False.
    """

    def __init__(self, target: str | Path, overwrite: bool = False) -> None:
        self.target = as_path(target, "the record of the frames", OutputError)
        self._is_video = self.target.suffix.lower() == VIDEO_SUFFIX
        if not self._is_video and self.target.suffix:
            raise OutputError(
                f"frames cannot be recorded as '{self.target.suffix}'; give a folder, or a video "
                f"that ends in {VIDEO_SUFFIX} (without loss)"
            )
        self._overwrite = overwrite
        inside = self.target / DETECTIONS_NAME
        self._rows_path = self.target.with_suffix(".jsonl") if self._is_video else inside
        self._check()
        self._container: Any = None
        self._stream: Any = None
        self._last_tick, self._num = -1, 0

    def __enter__(self) -> FrameRecord:
        make_folder(self.target.parent if self._is_video else self.target)
        with writing(self.target):
            if self._overwrite and not self._is_video:
                for old in self.target.glob("[0-9]" * 6 + ".png"):
                    old.unlink()
            self._rows = self._rows_path.open("w", encoding="ascii", newline="\n")
        if self._is_video:
            with writing(self.target, FFmpegError):
                self._container = av.open(str(self.target), "w", format="matroska")
        return self

    def __exit__(self, *raised: object) -> None:
        self._rows.close()
        if self._container is not None:
            with writing(self.target, FFmpegError):
                if self._stream is not None:
                    self._container.mux(self._stream.encode(None))
                self._container.close()

    def add(self, frame: Frame) -> None:
        """Writes a frame with its detections.

        Raises:
          OutputError: If the disk is full, or the frame has no image.
        """
        if frame.image is None:
            raise OutputError(f"frame '{frame.name}' has no image to record; leave out record")
        if self._is_video:
            self._add_to_video(frame.image, frame.time_s)
        else:
            options = [cv2.IMWRITE_PNG_COMPRESSION, 1]  # the sizes are near, the times are not
            pixels = cv2.cvtColor(frame.image, cv2.COLOR_RGB2BGR)
            png = cv2.imencode(".png", pixels, options)[1].tobytes()
            replace_file(self.target / f"{self._num:06d}.png", png)
        row = {
            "frame": self._num,
            "source_index": frame.source_index,
            "time_s": frame.time_s,
            "detections": [] if frame.detections is None else _rows_of(frame.detections),
        }
        with writing(self._rows_path):
            self._rows.write(json.dumps(row, separators=(",", ":")) + "\n")
            self._rows.flush()
        self._num += 1

    def _check(self) -> None:
        if self._overwrite:
            return
        taken = [path for path in (self.target, self._rows_path) if path.exists()]
        if taken and (self._is_video or not self.target.is_dir() or any(self.target.iterdir())):
            raise OutputError(
                f"'{taken[0]}' is there already; choose another name for the record or allow "
                "overwriting (--overwrite)"
            )

    def _add_to_video(self, image: np.ndarray, time_s: float) -> None:
        with writing(self.target, FFmpegError):
            if self._stream is None:
                self._stream = self._container.add_stream("ffv1", rate=30)
                self._stream.height, self._stream.width = image.shape[:2]
                self._stream.pix_fmt = "bgr0"
                self._stream.time_base = Fraction(1, _CLOCK)
                self._stream.codec_context.time_base = Fraction(1, _CLOCK)
            picture = av.VideoFrame.from_ndarray(image, format="rgb24")
            self._last_tick = max(self._last_tick + 1, round(time_s * _CLOCK))
            picture.pts, picture.time_base = self._last_tick, Fraction(1, _CLOCK)
            self._container.mux(self._stream.encode(picture))


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
