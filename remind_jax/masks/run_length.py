"""Masks as compressed COCO run-length codes: made, read, measured, and checked for damage.

A code is text: five bits to a character (offset 48), lowest first, bit 5 set if more follow; from
the fourth run on, the difference to the run two before is stored. Runs alternate background and
foreground over the pixels in column-major order.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from hotcoco import mask as coco
from jaxtyping import Bool, Float, Int, Integer, UInt8

from remind_jax.crops import Crops, cut_runs
from remind_jax.frame import Rle

# More characters to a number overflow 64 bits; no picture is that large.
_MAX_CHARACTERS = 8


def encode_masks(masks: Bool[np.ndarray, "N H W"] | Crops) -> tuple[Rle, ...]:
    """Run-length encodes pixel masks, one COCO RLE per mask."""
    crops, codes = Crops.of(masks), []
    height, _ = crops.size
    for (left, top), window in zip(crops.corners, crops.windows, strict=True):
        # As columns of the picture, with a pixel of background before and behind.
        columns = np.zeros((window.shape[1], height), bool)
        columns[:, top : top + window.shape[0]] = window.T
        edges = np.flatnonzero(np.diff(columns.ravel(), prepend=False, append=False))
        codes.append(_encode_edges(edges + left * height, crops.size))
    return tuple(codes)


def _encode_edges(edges: Int[np.ndarray, "edges"], frame_size: tuple[int, int]) -> Rle:
    """The code of a mask by the places where its runs begin and end, pixels by columns."""
    height, width = frame_size
    counts = np.diff(edges, prepend=0, append=height * width).tolist()
    plain = {"size": [height, width], "counts": counts if counts[-1] else counts[:-1]}
    return coco.frPyObjects(plain, height, width)


def encode_label_map(labels: Integer[np.ndarray, "H W"]) -> dict[int, Rle]:
    """One code for each number above 0 of a label map, by rising number."""
    pixels = np.ascontiguousarray(labels.T).ravel()
    starts = np.concatenate([[0], np.flatnonzero(pixels[1:] != pixels[:-1]) + 1])
    stops = np.append(starts[1:], pixels.size)
    values = pixels[starts].astype(np.int64)
    order = np.argsort(values, kind="stable")
    order = order[values[order] > 0]
    rles: dict[int, Rle] = {}
    for runs in np.split(order, np.flatnonzero(np.diff(values[order])) + 1):
        if not len(runs):
            continue
        edges = np.column_stack([starts[runs], stops[runs]]).ravel()
        rles[int(values[runs[0]])] = _encode_edges(edges, labels.shape)
    return rles


def encode_polygon(corners: Float[np.ndarray, "P 2"], frame_size: tuple[int, int]) -> Rle:
    """The pixels of a polygon by the rule of COCO, from three or more finite corners `x, y`."""
    height, width = frame_size
    # Corners far outside of the frame change nothing inside but take time and memory.
    near = np.clip(corners, [-4.0 * width, -4.0 * height], [5.0 * width, 5.0 * height])
    return coco.merge(coco.frPyObjects([near.ravel().tolist()], height, width))


def decode_mask(rle: Rle) -> UInt8[np.ndarray, "H W"]:
    """The mask as pixels, 1 inside."""
    return coco.decode(rle)


def cut_masks(rles: Sequence[Rle], frame_size: tuple[int, int]) -> Crops:
    """The masks of sound codes as boxes; nothing of the size of the picture is made."""
    runs = (_read_runs(_read_digits(rle))[0] for rle in rles)
    return Crops.join(frame_size, (cut_runs(of_mask, frame_size[0]) for of_mask in runs))


def mask_box(rle: Rle) -> tuple[int, int, int, int]:
    """Left, top, width and height in pixels of the smallest box around a mask; zero if empty."""
    left, top, width, height = (int(side) for side in coco.toBbox(rle))
    return left, top, width, height


def mask_areas(rles: Sequence[Rle]) -> Int[np.ndarray, "N"]:
    """Pixels of each mask."""
    return np.asarray(coco.area(list(rles)), int)


def union_area(rles: Sequence[Rle]) -> int:
    """Pixels that at least one mask holds."""
    return int(coco.area(coco.merge(list(rles)))) if rles else 0


def find_malformed(rles: Sequence[Rle]) -> int | None:
    """The first code that `is_malformed`; None if all are sound."""
    return next((place for place, rle in enumerate(rles) if is_malformed(rle)), None)


def is_malformed(rle: Rle) -> bool:
    """Whether a code is damaged or does not cover its picture exactly.

    The library that decodes them takes codes that end early for sound, and memory for any size.
    """
    digit, (height, width) = _read_digits(rle), rle["size"]
    if min(height, width) < 1 or not len(digit) or digit[-1] & 32:
        return True
    if digit.min() < 0 or digit.max() > 63:
        return True
    runs, lengths = _read_runs(digit)
    return bool(
        lengths.max() > _MAX_CHARACTERS or runs.min() < 0 or int(runs.sum()) != height * width
    )


def _read_digits(rle: Rle) -> Int[np.ndarray, "characters"]:
    return np.frombuffer(rle["counts"], np.uint8).astype(np.int64) - 48


def _read_runs(
    digit: Int[np.ndarray, "characters"],
) -> tuple[Int[np.ndarray, "runs"], Int[np.ndarray, "runs"]]:
    """The runs (background, mask, ...) of a code that ends with a number, and their characters."""
    ends = np.flatnonzero((digit & 32) == 0)
    starts = np.concatenate([[0], ends[:-1] + 1])
    lengths = ends - starts + 1
    place = np.arange(len(digit)) - np.repeat(starts, lengths)
    parts = (digit & 31) << np.minimum(5 * place, 5 * _MAX_CHARACTERS)
    value = np.add.reduceat(parts, starts)
    is_negative = (digit[ends] & 16) != 0
    value -= np.where(is_negative, 1 << np.minimum(5 * lengths, 60), 0)
    # From the fourth number on, each is the difference to the run two before.
    value[1::2] = np.cumsum(value[1::2])
    value[2::2] = np.cumsum(value[2::2])
    return value, lengths
