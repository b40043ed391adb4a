"""Addresses of cameras and streams, and how they are shown: without user, password and query."""

from __future__ import annotations

import dataclasses
import os
import re
import stat
from numbers import Integral
from pathlib import Path
from typing import Any, Literal
from urllib.parse import urlsplit

from remind_jax.errors import SourceError

SCHEMES = ("rtsp", "rtsps", "http", "https")
MAX_CAMERA = 63  # number of a camera
_MAX_LETTERS = 2000  # of an address
_HIDDEN = "***"
_SCHEME = re.compile(r"([A-Za-z][A-Za-z0-9+.-]+)://")
_DEVICE = re.compile(r"/dev/video\d+")
_VIDEO_DEVICES = 81  # major number on Linux


@dataclasses.dataclass(frozen=True)
class Address:
    """A camera of this machine, or a stream from another one."""

    kind: Literal["camera", "stream"]
    target: int | str = dataclasses.field(repr=False)  # number or path of a camera, or a URL
    shown: str  # what of it may be printed or stored
    name: str
    host: str = ""  # of a stream
    port: int | None = None


def read_address(spec: Any) -> Address | None:
    """What a source names, if it is no file: 0, "0", "/dev/video0", "rtsp://..."; else None.

    A file called "0" is a file.

    Raises:
      SourceError: If it is an address, but none that can be read.
    """
    if isinstance(spec, Integral) and not isinstance(spec, bool):
        return _camera(int(spec))
    if not isinstance(spec, str | Path):
        return None
    text = str(spec)
    if _DEVICE.fullmatch(text) or _is_device(text):
        return Address("camera", text, text, f"camera-{Path(text).name}")
    if text.isascii() and text.isdigit() and not Path(text).exists():
        return _camera(int(text))
    scheme = _SCHEME.match(text)
    return _stream(text, scheme[1]) if scheme is not None and isinstance(spec, str) else None


def hide_secrets(text: str) -> str:
    """A text that may be an address, as it may be shown."""
    if _SCHEME.match(text) is None:
        return text
    try:
        parts = urlsplit(text)
        host, port = parts.hostname or "", parts.port
    except ValueError:  # damaged, so that nothing says where a password ends
        return f"{text.partition('://')[0]}://{_HIDDEN}"
    host = f"[{host}]" if ":" in host else host
    user = f"{_HIDDEN}@" if "@" in parts.netloc else ""
    query = f"?{_HIDDEN}" if parts.query or parts.fragment else ""
    return f"{parts.scheme}://{user}{host}{'' if port is None else f':{port}'}{parts.path}{query}"


def _camera(number: int) -> Address:
    if not 0 <= number <= MAX_CAMERA:
        raise SourceError(f"camera {number} cannot be; cameras are numbered from 0 to {MAX_CAMERA}")
    return Address("camera", number, f"camera-{number}", f"camera-{number}")


def _stream(url: str, scheme: str) -> Address:
    shown = hide_secrets(url)
    if scheme.lower() not in SCHEMES:
        raise SourceError(
            f"'{shown}' is of scheme '{scheme}', which is not read; give an address that begins "
            f"with {', '.join(f'{name}://' for name in SCHEMES)}, the number of a camera, or a file"
        )
    if len(url) > _MAX_LETTERS or not url.isprintable() or " " in url:
        raise SourceError(
            f"'{shown[:80]}' is no address; give at most {_MAX_LETTERS} letters, without spaces"
        )
    try:
        parts = urlsplit(url)
        host, port, path = parts.hostname, parts.port, parts.path
    except ValueError as error:
        raise SourceError(
            f"'{shown}' names no host with a port up to 65535; give {scheme}://HOST[:PORT]/PATH"
        ) from error
    if not host:
        raise SourceError(f"'{shown}' names no host; give {scheme}://HOST[:PORT]/PATH")
    words = re.sub(r"[^\w.]+", "-", f"{host}{path}").strip("-.")
    url = scheme.lower() + url[len(scheme) :]  # FFmpeg knows no other spelling
    return Address("stream", url, shown, words[:80] or host, host, port)


def _is_device(text: str) -> bool:
    """Whether it is the path of a video device, such as /dev/v4l/by-id/..."""
    if not text.startswith("/dev/"):
        return False
    try:
        found = Path(text).stat()
        return stat.S_ISCHR(found.st_mode) and os.major(found.st_rdev) == _VIDEO_DEVICES
    except (OSError, ValueError):
        return False
