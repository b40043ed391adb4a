"""Videos through FFmpeg (PyAV): every frame once, upright, in RGB, with its own time stamp."""

from __future__ import annotations

import contextlib
import functools
from collections.abc import Generator, Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

from remind_jax import files
from remind_jax.errors import SourceError
from remind_jax.files.limits import MAX_PICTURE_PIXELS, MAX_SIDE_PX
from remind_jax.frame import SkippedFrame
from remind_jax.sources.source import Content, Entry, Report, UnreadableFrame

if TYPE_CHECKING:
    import av
    import av.container
    import av.error
    import av.video.reformatter
else:
    av = lazy_loader.load("av")  # takes long, and a live tracker of given images reads no video

DAMAGED = "the picture is damaged"
# Kinds of files that hold videos themselves: no lists of other files or addresses, no text.
CONTAINERS = (
    "mov,mp4,m4a,3gp,3g2,mj2,matroska,webm,avi,mpegts,mpeg,mpegvideo,m4v,flv,asf,ogg,gif,apng,"
    "h264,hevc,av1,obu,ivf,yuv4mpegpipe,mxf,nut,mjpeg,dv,rm,wtv,wav"
)
ESTIMATE_SLACK = 0.02  # share by which a frame count taken from the duration may err


class VideoReader:
    """One video file. Raises SourceError if it is no video, or no frame of it can be decoded."""

    kind = "video"

    def __init__(self, file: Path, name: str) -> None:
        self._file, self.name = file, name
        self.entry_names: tuple[str, ...] | None = None
        with self._open() as container:
            stream = _video_stream(container, file)
            self.fps = _positive(stream.average_rate) or _positive(stream.guessed_rate)
            # Where frames are not counted, their number is an estimate by this end in seconds.
            self.num_entries, self.end_s = _count_frames(container, stream, self.fps)
        self._require_a_frame()

    def entries(self, report: Report) -> Generator[Entry, None, None]:
        """Yields decoded pictures; damaged stretches and a missing end are reported."""
        index, origin_s, time_s, is_damaged = 0, None, 0.0, False
        with self._open() as container:
            stream = _video_stream(container, self._file)
            stream.thread_type = "AUTO"
            to_rgb = av.video.reformatter.VideoReformatter()
            for frame in _decode(container, stream):
                if isinstance(frame, SkippedFrame):
                    report(frame)
                    index, is_damaged = index + frame.count, True
                    time_s += frame.count / (self.fps or 1.0)
                    continue
                time_s = frame.time if frame.time is not None else index / (self.fps or 1.0)
                origin_s = time_s if origin_s is None else origin_s
                read = functools.partial(read_picture, frame, to_rgb)
                yield Entry(index, time_s - origin_s, f"{index:06d}", read, is_timed=True)
                index += 1
        last_s = time_s - (origin_s or 0.0)
        # Of frames that come as they like, the rate that the container names is of no use.
        seen_fps = (index - 1) / last_s if last_s > 0 else self.fps
        self._report_missing(index, time_s, seen_fps, is_damaged, report)

    def count(self) -> int | None:
        """Frames; where the container does not say, by reading the whole file."""
        if self.num_entries is not None and self.end_s is None:
            return self.num_entries
        with self._open() as container, contextlib.suppress(av.error.FFmpegError):
            packets = container.demux(_video_stream(container, self._file))
            return sum(packet.size > 0 for packet in packets)

    @contextlib.contextmanager
    def _open(self) -> Iterator[av.container.InputContainer]:
        options = {"format_whitelist": CONTAINERS, "max_pixels": str(MAX_PICTURE_PIXELS)}
        try:
            files.check_regular(self._file)
            container = av.open(str(self._file), mode="r", options=options)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            raise SourceError(
                f"'{self._file}' cannot be opened as a video ({_say(error)}): it is damaged, cut "
                "off, or not a video"
            ) from error
        with container:
            yield container

    def _require_a_frame(self) -> None:
        reports: list[SkippedFrame] = []
        entries = self.entries(reports.append)
        first = next(entries, None)
        entries.close()
        if first is None:
            why = f" ({reports[0].reason})" if reports else ""
            raise SourceError(f"no frame of the video '{self._file}' can be decoded{why}")

    def _report_missing(
        self,
        num_seen: int,
        last_s: float,
        seen_fps: float | None,
        is_damaged: bool,
        report: Report,
    ) -> None:
        """Frames that are not there, by their count; where that is an estimate, by time."""
        if self.num_entries is None:
            return
        missing, tolerated = self.num_entries - num_seen, 0
        if self.end_s is not None and seen_fps is not None:
            by_time = round((self.end_s - last_s) * seen_fps) - 1
            missing = max(by_time, missing) if is_damaged else by_time
            tolerated = max(1, round(self.num_entries * ESTIMATE_SLACK))
        if missing > tolerated:
            name = f"frames {num_seen} to {num_seen + missing - 1}"
            report(SkippedFrame(name, "the video ends early (cut off or damaged)", missing))


def _decode(
    container: av.container.InputContainer, stream: av.VideoStream
) -> Iterator[av.VideoFrame | SkippedFrame]:
    """Decodes packet by packet, so that one damaged packet costs one frame."""
    packets = container.demux(stream)
    while True:
        try:
            packet = next(packets, None)
        except av.error.FFmpegError as error:
            yield SkippedFrame("rest", f"the file is damaged: {_say(error)}", count=0)
            return
        if packet is None:
            return
        try:
            yield from packet.decode()
        except av.error.EOFError:
            return
        except av.error.FFmpegError as error:
            pts, clock = packet.pts, packet.time_base
            at = "" if pts is None or clock is None else f" at {float(pts * clock):.2f} s"
            yield SkippedFrame(f"packet{at}", f"it cannot be decoded: {_say(error)}")


def _video_stream(container: av.container.InputContainer, file: Path) -> av.VideoStream:
    if not container.streams.video:
        raise SourceError(f"'{file}' has no video track")
    stream = container.streams.video[0]
    if stream.codec_context is None or not stream.codec_context.width:
        raise SourceError(f"the pictures of '{file}' are of an unknown kind or size, or damaged")
    check_video_size(stream, str(file))
    stream.codec_context.options = {"max_pixels": str(MAX_PICTURE_PIXELS)}
    return stream


def check_video_size(stream: av.VideoStream, shown: str) -> None:
    """Raises SourceError if a stream is of larger pictures than are read."""
    width, height = stream.width, stream.height
    if width * height > MAX_PICTURE_PIXELS or max(width, height) > MAX_SIDE_PX:
        raise SourceError(
            f"'{shown}' claims pictures of {width}x{height} pixels; at most {MAX_PICTURE_PIXELS} "
            "are read"
        )


def _count_frames(
    container: av.container.InputContainer, stream: av.VideoStream, fps: float | None
) -> tuple[int | None, float | None]:
    """Frames as the container says, or by its end in seconds, which comes along then."""
    if stream.frames > 0:
        return stream.frames, None
    duration_s = None
    if stream.duration is not None and stream.time_base is not None:
        duration_s = float(stream.duration * stream.time_base)
    elif container.duration is not None and len(container.streams) == 1:
        duration_s = container.duration / av.time_base
    if duration_s is None or fps is None or duration_s <= 0:
        return None, None
    return max(1, round(duration_s * fps)), duration_s


def read_picture(frame: av.VideoFrame, to_rgb: av.video.reformatter.VideoReformatter) -> Content:
    """A decoded picture in RGB, turned upright as the container says (telephones film sideways).

    `to_rgb` is the reader's own: that which PyAV shares between readers has threads, which a
    process that is forked lacks; it would wait for them for ever.

    Raises:
      UnreadableFrame: If it is damaged.
    """
    if frame.is_corrupt:
        raise UnreadableFrame(DAMAGED)
    image = to_rgb.reformat(frame, format="rgb24").to_ndarray()
    matrix = frame.side_data.get("DISPLAYMATRIX")
    return Content(image if matrix is None else _turn_upright(image, np.frombuffer(matrix, "i4")))


def _turn_upright(image: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """Turned by quarters and mirrored, by the 3x3 matrix of a container: (x, y, 1) times it."""
    (x_by_x, y_by_x, _), (x_by_y, y_by_y, _), _ = matrix.reshape(3, 3).tolist()
    across, down = x_by_x, y_by_y
    if abs(x_by_y) > abs(x_by_x):
        image, across, down = image.swapaxes(0, 1), x_by_y, y_by_x
    return np.ascontiguousarray(image[:: -1 if down < 0 else 1, :: -1 if across < 0 else 1])


def _positive(rate: object) -> float | None:
    value = float(rate) if rate else 0.0  # pyright: ignore[reportArgumentType]
    return value if 0 < value < 1000 else None


def _say(error: Exception) -> str:
    text = getattr(error, "strerror", None) or str(error)
    return str(text).rstrip(".")
