"""Pictures of a live source, one after the other: streams by FFmpeg (PyAV), cameras by OpenCV."""

from __future__ import annotations

import contextlib
import errno
import functools
import os
import socket
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

import cv2
import lazy_loader
import numpy as np

from remind_jax.errors import SourceError
from remind_jax.files.limits import MAX_PICTURE_PIXELS
from remind_jax.sources.address import Address
from remind_jax.sources.source import Content, UnreadableFrame
from remind_jax.sources.video import CONTAINERS, DAMAGED, check_video_size, read_picture

if TYPE_CHECKING:
    import av
    import av.container
    import av.error
    import av.video.reformatter
else:
    av = lazy_loader.load("av")

# What a stream may come in, beside what files do; nothing in it may name a local file.
_FORMATS = f"{CONTAINERS},mpjpeg,rtsp,rtp,sdp,hls,mpegtsraw"
_PROTOCOLS = "http,https,tcp,tls,rtsp,rtsps,rtp,srtp,udp,crypto"
_MAX_DAMAGED = 300  # packets without a picture between two, until a stream counts as unreadable


class Unreachable(SourceError):
    """A live source cannot be opened now."""


class Lost(Exception):
    """A live source gives no more pictures; the text says why, without its subject."""


# A picture as it arrived, not yet in RGB, so that one that is passed over costs little; raises
# UnreadableFrame.
Picture = Callable[[], Content]


class Capture(Protocol):
    """An open live source, for one thread."""

    def read(self) -> Picture | None:
        """Waits for the next picture; None if the source has ended by itself.

        Raises:
          Lost: If none comes any more.
        """
        ...

    def close(self) -> None:
        """Lets go of the source."""
        ...


def open_capture(address: Address, wait_s: float) -> Capture:
    """Opens a camera or a stream. Raises Unreachable if that fails; it may be tried again."""
    return _Camera(address) if address.kind == "camera" else _Stream(address, wait_s)


class _Stream:
    """A stream by FFmpeg, which raises at the end of the time given."""

    def __init__(self, address: Address, wait_s: float) -> None:
        options = {
            "format_whitelist": _FORMATS,
            "protocol_whitelist": _PROTOCOLS,
            "rtsp_transport": "tcp",  # what gets lost otherwise tears pictures apart
            "max_pixels": str(MAX_PICTURE_PIXELS),
            "analyzeduration": "1000000",  # microseconds that finding out about it may take
            "fpsprobesize": "0",
        }
        url, wait = str(address.target), (wait_s, wait_s)
        try:
            self._container = av.open(url, options=options, timeout=wait)
        except (av.error.FFmpegError, OSError, ValueError) as error:
            # The address in the text of the error may hold a password.
            raise Unreachable(_say_unreachable(address, error, wait_s)) from None
        try:
            self._pictures = self._decode(_video_of(self._container, address))
        except SourceError:
            self._container.close()
            raise
        self._wait_s = wait_s

    def read(self) -> Picture | None:
        try:
            return next(self._pictures, None)
        except av.error.ExitError:
            raise Lost(f"sent nothing for {self._wait_s:g} s") from None
        except (av.error.FFmpegError, OSError) as error:
            if isinstance(error, av.error.EOFError):
                return None
            raise Lost("broke off") from None

    def close(self) -> None:
        with contextlib.suppress(av.error.FFmpegError, OSError):
            self._container.close()

    def _decode(self, stream: av.VideoStream) -> Iterator[Picture]:
        to_rgb = av.video.reformatter.VideoReformatter()
        stream.thread_type = "SLICE"  # threads by frames would hold back as many frames
        num_damaged, has_begun = 0, False
        for packet in self._container.demux(stream):
            try:
                frames = packet.decode()
            except av.error.EOFError:
                return
            except av.error.InvalidDataError:
                frames = []
                if has_begun:  # before, it may be the middle of what began earlier
                    yield _read_damaged
            num_damaged = 0 if frames else num_damaged + 1
            if num_damaged > _MAX_DAMAGED:
                raise Lost("sends nothing that can be decoded")
            has_begun = has_begun or bool(frames)
            yield from (functools.partial(read_picture, frame, to_rgb) for frame in frames)


def _read_damaged() -> Content:
    raise UnreadableFrame(DAMAGED)


def _video_of(container: av.container.InputContainer, address: Address) -> av.VideoStream:
    if not container.streams.video:
        raise Unreachable(f"'{address.shown}' sends no pictures; give that of a video stream")
    stream = container.streams.video[0]
    if container.duration is not None and container.duration > 0:
        raise SourceError(
            f"'{address.shown}' is a recording of {container.duration / av.time_base:.1f} s and no "
            "live stream; download it, and give the file"
        )
    check_video_size(stream, address.shown)
    return stream


def _say_unreachable(address: Address, error: BaseException, wait_s: float) -> str:
    """Why a stream cannot be opened, and what to do."""
    late = f"did not answer within {wait_s:g} s; is the host right, and reachable?"
    reasons = (
        (av.error.ConnectionRefusedError, "refuses the connection; is it on, and the port right?"),
        (av.error.HTTPUnauthorizedError, "asks for a user and a password: //USER:PASSWORD@HOST"),
        (av.error.HTTPForbiddenError, "forbids access; give a user who may see it"),
        (av.error.HTTPNotFoundError, "does not exist on that host; is the path right?"),
        (av.error.ExitError, late),
        (av.error.TimeoutError, late),
        (
            av.error.InvalidDataError,
            "sends no pictures that can be read; give the address of a video stream",
        ),
    )
    shown = f"'{address.shown}'"
    for kind, what in reasons:
        if isinstance(error, kind):
            return f"{shown} {what}"
    try:
        socket.getaddrinfo(address.host, address.port)
    except OSError:
        return f"the host '{address.host}' of {shown} is unknown; is it spelled right?"
    if isinstance(error, av.error.OSError) and error.errno == errno.EIO:
        return f"{shown} breaks off before it sends any pictures"
    why = getattr(error, "strerror", None) or type(error).__name__
    return f"{shown} cannot be opened: {why}"


class _Camera:
    """A camera by OpenCV."""

    def __init__(self, address: Address) -> None:
        device = address.target
        if isinstance(device, str) and not os.access(device, os.R_OK):
            raise Unreachable(_say_no_camera(address))
        log: Any = cv2.utils.logging
        before = log.getLogLevel()
        log.setLogLevel(log.LOG_LEVEL_SILENT)  # what it says past Python is said below
        try:
            backend = cv2.CAP_V4L2 if sys.platform == "linux" else cv2.CAP_ANY
            self._device: Any = cv2.VideoCapture(device, backend)  # pyright: ignore[reportCallIssue, reportArgumentType]
        except cv2.error as error:
            raise Unreachable(_say_no_camera(address)) from error
        finally:
            log.setLogLevel(before)
        if not self._device.isOpened():
            self._device.release()
            raise Unreachable(_say_no_camera(address))
        self._device.set(cv2.CAP_PROP_BUFFERSIZE, 1)  # the newest picture, where drivers can

    def read(self) -> Picture | None:
        is_there, pixels = self._device.read()
        if not is_there or pixels is None:
            raise Lost("gave no picture")
        return functools.partial(_content_of_bgr, pixels)

    def close(self) -> None:
        self._device.release()


def _content_of_bgr(pixels: np.ndarray) -> Content:
    code = cv2.COLOR_GRAY2RGB if pixels.ndim == 2 else cv2.COLOR_BGR2RGB
    return Content(cv2.cvtColor(pixels, code))


def _say_no_camera(address: Address) -> str:
    """Why there is no picture of a camera, as far as the system tells."""
    is_number = isinstance(address.target, int)
    if not is_number or sys.platform == "linux":
        path = Path(f"/dev/video{address.target}" if is_number else str(address.target))
        if not path.exists():
            found = ", ".join(sorted(str(camera) for camera in Path("/dev").glob("video*")))
            return f"there is no camera '{path}'; this machine has {found or 'none'}"
        if not os.access(path, os.R_OK):
            return (
                f"the camera '{path}' may not be read by this user; allow it, as by joining the "
                "group 'video'"
            )
    return f"camera '{address.shown}' cannot be opened; does another program use it?"
