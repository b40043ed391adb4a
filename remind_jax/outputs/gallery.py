"""The best view of each visit of each identity."""

from __future__ import annotations

import dataclasses
import math

import cv2
import numpy as np
from jaxtyping import Float, UInt8

from remind_jax.formats.firm import firm_rows
from remind_jax.masks.run_length import cut_masks
from remind_jax.outputs.drawing import NO_IMAGE_GRAY, fit_image, identity_color
from remind_jax.outputs.presence import MIN_ABSENCE_FRAMES
from remind_jax.tracks import Tracks

CROP_PX = 144
MAX_SIGHTINGS = 8  # visits shown per identity, the first ones

_NO_VIEW = np.full((CROP_PX, CROP_PX, 3), NO_IMAGE_GRAY, np.uint8)
# A view replaces another only if it is better by this factor, so that a visit costs few crops.
CLEARLY_BETTER = 1.1
# Masks of detectors end up to a few pixels before the frame does.
_BORDER_SHARE = 0.005
# What a view loses that the border of the frame cuts off.
_CUT_OFF = 0.25
# What a view loses whose shape is not the usual one of its object, as of two in one mask. In log
# units: how far a usual shape may be off, and over how much more it becomes an odd one.
_ODD, _USUAL, _FALL = 0.35, 0.1, 0.12
# Views that the usual shape is the average of: sides, filling, and the size, which may change soon.
_SHAPES_KEPT = np.array([30, 30, 5])
# Sharpness is compared at one size, about that at which views are shown; more pixels show no more.
_COMPARED_PX = 112
# Of a picture without any contrast, in gray levels: the size decides alone.
_MIN_CONTRAST = 0.1


@dataclasses.dataclass(frozen=True)
class Sighting:
    """A visit of an identity: from its first sight or a return until it is gone again."""

    object_id: int
    label: str
    name: str  # given by people; empty without one
    position: int  # of the first frame of the visit in the run, 0, 1, 2, ...
    absent_frames: int  # before the visit; 0 at first sight
    picture_position: int  # of the frame of the best view
    image: UInt8[np.ndarray, "S S 3"]  # best view of the visit: RGB, outlined, S = CROP_PX


@dataclasses.dataclass
class _Visit:
    """What is going on with an identity."""

    last_position: int
    place: int | None = None  # in the list of sightings; None where no more are shown
    quality: float = 0.0  # of the view kept
    count: int = 0  # visits so far
    shape: Float[np.ndarray, "3"] | float = 0.0  # of the identity, on average of the latest views
    num_shapes: int = 0

    def likeness(self, shape: Float[np.ndarray, "3"], is_whole: bool) -> float:
        """How usual a shape is for the identity, up to 1; whole ones make what is usual."""
        if is_whole:
            self.num_shapes += 1
            self.shape += (shape - self.shape) / np.minimum(self.num_shapes, _SHAPES_KEPT)
        distance = np.linalg.norm(shape - self.shape) if self.num_shapes else 0.0
        return max(_ODD, math.exp(-((max(0.0, float(distance) - _USUAL) / _FALL) ** 2)))


class SightingCollector:
    """Cuts out the best view of each visit while frames pass by.

    Memory grows with the number of identities, not of frames: of each visit one crop is kept.
    """

    def __init__(self) -> None:
        self.sightings: list[Sighting] = []
        self._visits: dict[int, _Visit] = {}
        self._position = 0

    def add(self, image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks) -> None:
        """Looks at the next frame of the run; without an image the mask is drawn on gray."""
        if image is not None:
            image = fit_image(image, *tracks.frame_size)
        for row in firm_rows(tracks).tolist():
            visit = self._follow(tracks, row)
            if visit.place is None:
                continue
            likeness = visit.likeness(_shape(tracks, row), not touches_border(tracks, row))
            quality = likeness * view_quality(image, tracks, row)
            if quality > CLEARLY_BETTER * visit.quality:
                visit.quality = quality
                self.sightings[visit.place] = dataclasses.replace(
                    self.sightings[visit.place],
                    picture_position=self._position,
                    image=crop_detection(image, tracks, row),
                )
        self._position += 1

    def _follow(self, tracks: Tracks, row: int) -> _Visit:
        """The visit that a detection belongs to, started if it is a first sight or a return."""
        object_id = int(tracks.object_id[row])
        visit = self._visits.setdefault(object_id, _Visit(self._position))
        absent = max(0, self._position - visit.last_position - 1)
        visit.last_position = self._position
        if visit.count and absent < MIN_ABSENCE_FRAMES:
            return visit
        visit.count += 1
        visit.place, visit.quality = None, 0.0
        if visit.count <= MAX_SIGHTINGS:
            visit.place = len(self.sightings)
            self.sightings.append(
                Sighting(
                    object_id=object_id,
                    label=tracks.labels[row],
                    name=tracks.names.get(object_id, ""),
                    position=self._position,
                    absent_frames=absent,
                    picture_position=self._position,
                    image=_NO_VIEW,
                )
            )
        return visit


def view_quality(image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks, row: int) -> float:
    """Higher is better; comparable between views of one object in one run."""
    size_px = min(math.sqrt(max(float(tracks.areas[row]), 0.0)), _COMPARED_PX)
    whole = _CUT_OFF if touches_border(tracks, row) else 1.0
    alone = 1.0 - _share_taken(tracks, row)
    return whole * alone * size_px * math.sqrt(_contrast(image, tracks.boxes[row]))


def _share_taken(tracks: Tracks, row: int) -> float:
    """The largest share of the box that another detection of the class has, up to nine tenths."""
    box, others = tracks.boxes[row], tracks.boxes
    corner, end = np.maximum(others[:, :2], box[:2]), np.minimum(others[:, 2:], box[2:])
    shared = np.prod(np.clip(end - corner, 0.0, None), axis=1)
    same = np.array([label == tracks.labels[row] for label in tracks.labels])
    same[row] = False
    size = max(float(np.prod(box[2:] - box[:2])), 1.0)
    return min(float(shared[same].max(initial=0.0)) / size, 0.9)


def _shape(tracks: Tracks, row: int) -> Float[np.ndarray, "3"]:
    """Width by height of the box, how far the mask fills it, and its size, as logarithms."""
    width, height = np.maximum(tracks.boxes[row, 2:] - tracks.boxes[row, :2], 1.0)
    area = max(float(tracks.areas[row]), 1.0)
    return np.log([width / height, area / (width * height), math.sqrt(area)])


def touches_border(tracks: Tracks, row: int) -> bool:
    """Whether the border of the frame may cut the object off."""
    height, width = tracks.frame_size
    near = max(1.0, _BORDER_SHARE * max(height, width))
    left, top, right, bottom = tracks.boxes[row]
    return bool(min(left, top, width - right, height - bottom) < near)


def _contrast(image: UInt8[np.ndarray, "H W 3"] | None, box: np.ndarray) -> float:
    """Deviation of the Laplacian in the box, in gray levels: small where it is blurred."""
    if image is None:
        return _MIN_CONTRAST
    left, top, right, bottom = (max(0, round(float(side))) for side in box)
    region = image[top:bottom, left:right]
    if not region.size:
        return _MIN_CONTRAST
    gray = cv2.cvtColor(np.ascontiguousarray(region), cv2.COLOR_RGB2GRAY)
    scale = _COMPARED_PX / max(gray.shape)
    size = tuple(max(1, round(scale * side)) for side in gray.shape[::-1])
    method = cv2.INTER_AREA if scale < 1 else cv2.INTER_LINEAR
    compared = cv2.resize(gray, size, interpolation=method)
    return max(float(cv2.Laplacian(compared, cv2.CV_32F).std()), _MIN_CONTRAST)


def crop_detection(
    image: UInt8[np.ndarray, "H W 3"] | None, tracks: Tracks, row: int, size_px: int = CROP_PX
) -> UInt8[np.ndarray, "S S 3"]:
    """A square around a detection with some margin, its mask outlined; gray outside the frame."""
    height, width = tracks.frame_size
    left, top, right, bottom = map(float, tracks.boxes[row])
    side = max(1.3 * max(right - left, bottom - top), 24.0)
    # Maps crop pixels to frame pixels; one warp cuts out and resizes without copies of the frame.
    scale = side / size_px
    matrix = np.array(
        [
            [scale, 0, (left + right - side) / 2 + (scale - 1) / 2],
            [0, scale, (top + bottom - side) / 2 + (scale - 1) / 2],
        ]
    )
    # What the square may read of the frame: its pixels are averaged with their neighbors.
    margin = 2 * scale + 2
    rows, columns = (
        slice(max(0, math.floor(start - margin)), min(end, math.ceil(start + side + margin)))
        for start, end in ((matrix[1, 2], height), (matrix[0, 2], width))
    )
    matrix[:, 2] -= columns.start, rows.start
    if image is None:
        crop = np.full((size_px, size_px, 3), NO_IMAGE_GRAY, np.uint8)
    else:
        image = fit_image(image, height, width)
        crop = _sample(image[rows, columns], matrix, size_px, NO_IMAGE_GRAY)
    inside = cut_masks([tracks.rles[row]], (height, width)).region(0, rows, columns)
    mask = _sample(inside * np.uint8(255), matrix, size_px, 0)
    contours, _ = cv2.findContours(
        (mask > 127).astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE
    )
    color = identity_color(int(tracks.object_id[row]))
    cv2.drawContours(crop, contours, -1, (16, 18, 22), 4, cv2.LINE_AA)
    cv2.drawContours(crop, contours, -1, color, 2, cv2.LINE_AA)
    return crop


def _sample(image: np.ndarray, matrix: np.ndarray, size_px: int, border: int) -> np.ndarray:
    scale = matrix[0, 0]
    if scale > 2:  # averaging first keeps small crops of large objects free of moire
        height, width = image.shape[:2]
        size = max(1, round(width / scale)), max(1, round(height / scale))
        factors = np.array(size) / (width, height)
        image = cv2.resize(image, size, interpolation=cv2.INTER_AREA)
        starts = (matrix[:, 2] + 0.5) * factors - 0.5
        matrix = np.column_stack([np.diag(scale * factors), starts])
    return cv2.warpAffine(
        image,
        matrix,
        (size_px, size_px),
        flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
        borderMode=cv2.BORDER_CONSTANT,
        borderValue=(border, border, border),
    )
