"""Picture files before they are decoded: what they are, how large, and whether they are whole.

A library takes memory for any size that a header claims, and writes to the terminal on its own
where it finds damage. Fields are those of the specifications of PNG, JPEG, WebP, BMP and TIFF.
"""

from __future__ import annotations

import re
import struct
import zlib

from remind_jax.sources.source import UnreadableFrame

MOST_PIXELS = 1 << 26  # 8192 x 8192
MOST_SIDE = 1 << 16

_PNG = b"\x89PNG\r\n\x1a\n"
_JPEG_START, _JPEG_SCAN, _JPEG_END = b"\xff\xd8", 0xDA, 0xD9
_JPEG_MOST_SCANS = 100  # a picture that gets sharper has some ten; each takes as long as a picture
_JPEG_FRAMES = {*range(0xC0, 0xD0)} - {0xC4, 0xC8, 0xCC}  # segments that tell the size
_JPEG_ALONE = {0x01, *range(0xD0, 0xD8)}  # marks without a length
_JPEG_MARK = re.compile(rb"\xff[^\x00\x01\xd0-\xd7\xff]")  # what ends the data of a scan
_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_KIND = 256, 257, 254
_TIFF_BITS, _TIFF_FORMAT = 258, 339
_TIFF_WHOLE = 1  # format of samples: whole numbers without a sign, as they are if it is left out
_TIFF_BESIDE = 0b101  # kinds of pages that are no picture of their own: a smaller copy, a mask
_TIFF_MOST_PAGES = 64  # that are looked at
_WEBP_ANIMATION = 2
_CUT = "it is cut off or damaged"
_PAGES = "it has several pages, not one picture; give each as a picture of its own"
_ANIMATED = "it is an animation, not one picture; give it as a video of its own, or its pictures"


def check_picture(data: bytes) -> tuple[int, int]:
    """Height and width of a picture, as its header says.

    Raises:
      UnreadableFrame: If it is no picture of a known kind, without pixels, too large, cut off, an
        animation, or of several pages.
    """
    if not data:
        raise UnreadableFrame("the file is empty")
    measure = next((m for magic, m in _KINDS if data.startswith(magic)), None)
    if measure is None:
        raise UnreadableFrame("it is no picture; give PNG, JPEG, WebP, BMP or TIFF")
    try:
        height, width = measure(data)
    except (struct.error, IndexError) as error:
        raise UnreadableFrame(_CUT) from error
    if not 0 < width <= MOST_SIDE or not 0 < height <= MOST_SIDE or width * height > MOST_PIXELS:
        raise UnreadableFrame(
            f"it claims {width}x{height} pixels; a side has 1 to {MOST_SIDE}, a picture at most "
            f"{MOST_PIXELS}"
        )
    return height, width


def check_color(data: bytes) -> None:
    """Makes sure that a sound picture holds brightness, and no measures or numbers.

    Raises:
      UnreadableFrame: If its samples are floats, have a sign or more than 16 bits, in a TIFF.
    """
    if not data.startswith((b"II*\0", b"MM\0*")):
        return
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    tags, _ = _read_tiff_page(data, order, at)
    bits, kind = tags.get(_TIFF_BITS, 1), tags.get(_TIFF_FORMAT, _TIFF_WHOLE)
    if bits > 16 or kind != _TIFF_WHOLE:
        names = {_TIFF_WHOLE: "whole numbers", 2: "numbers with a sign", 3: "floats"}
        raise UnreadableFrame(
            f"its samples are {names.get(kind, 'of a kind')} of {bits} bits; give whole numbers of "
            "8 or 16 bits without a sign"
        )


def _measure_png(data: bytes) -> tuple[int, int]:
    """Goes through all chunks, comparing their checksums."""
    size: tuple[int, int] | None = None
    at = len(_PNG)
    while True:
        length, kind = struct.unpack_from(">I4s", data, at)
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(memoryview(data)[at + 4 : at + 8 + length]) != checksum:
            raise UnreadableFrame("it is damaged")
        if kind == b"IHDR":
            width, height = struct.unpack_from(">II", data, at + 8)
            size = height, width
        elif size is None:
            raise UnreadableFrame("it is damaged")
        elif kind == b"acTL":
            raise UnreadableFrame(_ANIMATED)
        elif kind == b"IEND":
            return size
        at += 12 + length


def _measure_jpeg(data: bytes) -> tuple[int, int]:
    """Goes through all segments and scans, and looks for the end after them.

    A preview inside of a segment has an end mark of its own; within a scan none can occur by
    chance. OpenCV 4 fills what is missing with gray instead.
    """
    size: tuple[int, int] | None = None
    at = 2
    while True:
        if data[at] != 0xFF:
            raise UnreadableFrame(_CUT)
        mark = data[at + 1]
        if mark == 0xFF or mark in _JPEG_ALONE:
            at += 1 if mark == 0xFF else 2
            continue
        if mark == _JPEG_SCAN:
            break
        (length,) = struct.unpack_from(">H", data, at + 2)
        if mark in _JPEG_FRAMES:
            height, width = struct.unpack_from(">HH", data, at + 5)
            size = height, width
        at += 2 + length
    num_scans = 0
    while found := _JPEG_MARK.search(data, at):
        at, mark = found.end(), data[found.end() - 1]
        num_scans += mark == _JPEG_SCAN
        if mark == _JPEG_END:
            break
        (length,) = struct.unpack_from(">H", data, at)
        if mark != _JPEG_SCAN and at + length <= len(data):
            at += length
    if size is None or found is None:
        raise UnreadableFrame(_CUT)
    if num_scans > _JPEG_MOST_SCANS:
        raise UnreadableFrame(
            f"it has {num_scans} scans, at most {_JPEG_MOST_SCANS} are read; write it anew"
        )
    return size


def _measure_webp(data: bytes) -> tuple[int, int]:
    length, name, kind = struct.unpack_from("<I4s4s", data, 4)
    if name != b"WEBP" or len(data) < length + 8:
        raise UnreadableFrame(_CUT)
    if kind == b"VP8X" and data[20] & _WEBP_ANIMATION:
        raise UnreadableFrame(_ANIMATED)
    if kind == b"VP8X":  # the canvas, less one
        return int.from_bytes(data[27:30], "little") + 1, int.from_bytes(data[24:27], "little") + 1
    if kind == b"VP8L":
        (bits,) = struct.unpack_from("<I", data, 21)
        return (bits >> 14 & 0x3FFF) + 1, (bits & 0x3FFF) + 1
    width, height = struct.unpack_from("<HH", data, 26)
    return height & 0x3FFF, width & 0x3FFF


def _measure_bmp(data: bytes) -> tuple[int, int]:
    (header,) = struct.unpack_from("<I", data, 14)
    if header == 12:
        width, height = struct.unpack_from("<HH", data, 18)
    else:
        width, height = struct.unpack_from("<ii", data, 18)
    return abs(height), width  # rows may go downward


def _measure_tiff(data: bytes) -> tuple[int, int]:
    """The size of the first page; only the first is decoded."""
    order = "<" if data[:2] == b"II" else ">"
    (at,) = struct.unpack_from(f"{order}I", data, 4)
    tags, following = _read_tiff_page(data, order, at)
    for _ in range(_TIFF_MOST_PAGES):
        if not following:
            break
        try:
            page, following = _read_tiff_page(data, order, following)
        except struct.error:  # behind the picture
            break
        if not page.get(_TIFF_KIND, 0) & _TIFF_BESIDE:
            raise UnreadableFrame(_PAGES)
    return tags.get(_TIFF_HEIGHT, 0), tags.get(_TIFF_WIDTH, 0)


def _read_tiff_page(data: bytes, order: str, at: int) -> tuple[dict[int, int], int]:
    """What a page says of itself by tags, and where the next page begins; 0 without one."""
    (count,) = struct.unpack_from(f"{order}H", data, at)
    tags: dict[int, int] = {}
    for entry in range(at + 2, at + 2 + 12 * count, 12):
        tag, kind, number = struct.unpack_from(f"{order}HHI", data, entry)
        if tag in (_TIFF_WIDTH, _TIFF_HEIGHT, _TIFF_KIND, _TIFF_BITS, _TIFF_FORMAT):
            place = entry + 8
            if kind == 3 and number > 2:  # of every channel; they do not fit here
                (place,) = struct.unpack_from(f"{order}I", data, place)
            (value,) = struct.unpack_from(order + ("H" if kind == 3 else "I"), data, place)
            tags[tag] = max(value, tags.get(tag, 0))  # of one that stands twice, either is read
    try:
        (following,) = struct.unpack_from(f"{order}I", data, at + 2 + 12 * count)
    except struct.error:
        following = 0
    return tags, following


_KINDS = (
    (_PNG, _measure_png),
    (_JPEG_START, _measure_jpeg),
    (b"RIFF", _measure_webp),
    (b"BM", _measure_bmp),
    (b"II*\0", _measure_tiff),
    (b"MM\0*", _measure_tiff),
)
