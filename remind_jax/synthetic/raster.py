"""Which face is seen at each pixel (z-buffer), and the color and light found there."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from remind_jax.synthetic.mesh import Atlas, Mesh
from remind_jax.synthetic.scene import Pose

_NEAR_M = 0.04
NO_FACE = -1


@dataclasses.dataclass(frozen=True, eq=False)
class Camera:
    """A pinhole camera; rows of `rotation` are its right, down and forward directions."""

    position_m: Float[np.ndarray, "3"]
    rotation: Float[np.ndarray, "3 3"]
    focal_px: float
    width_px: int
    height_px: int

    @classmethod
    def at(cls, pose: Pose, fov_rad: float, width_px: int, height_px: int) -> Camera:
        """The camera of a pose; `fov_rad` is the horizontal field of view at zoom 1."""
        cos_yaw, sin_yaw = np.cos(pose.yaw_rad), np.sin(pose.yaw_rad)
        cos_pitch, sin_pitch = np.cos(pose.pitch_rad), np.sin(pose.pitch_rad)
        forward = np.array([cos_pitch * cos_yaw, cos_pitch * sin_yaw, sin_pitch])
        right = np.array([sin_yaw, -cos_yaw, 0.0])
        down = np.cross(forward, right)
        cos_roll, sin_roll = np.cos(pose.roll_rad), np.sin(pose.roll_rad)
        rolled = cos_roll * right + sin_roll * down, cos_roll * down - sin_roll * right
        focal_px = pose.zoom * 0.5 * width_px / np.tan(fov_rad / 2)
        rotation = np.stack([*rolled, forward])
        return cls(np.array(pose.position_m), rotation, focal_px, width_px, height_px)


@dataclasses.dataclass(frozen=True, eq=False)
class Projection:
    """Per face: planes over the image, as coefficients of `(x, y, 1)` in pixels."""

    inverse_depth: Float[np.ndarray, "F 3"]
    texels: Float[np.ndarray, "F 2 3"]  # of `(u, v) / depth`


@dataclasses.dataclass(frozen=True, eq=False)
class _Polygons:
    """Outlines of faces on the image, one after the other, clockwise as seen."""

    points: Float[np.ndarray, "V 2"]  # pixels
    counts: Int[np.ndarray, "P"]
    face: Int[np.ndarray, "P"]


@dataclasses.dataclass(frozen=True, eq=False)
class _Spans:
    """The pixels of polygons: columns `[first, end)` of each row, polygon after polygon."""

    first: Int[np.ndarray, "R"]
    end: Int[np.ndarray, "R"]
    starts: Int[np.ndarray, "P"]  # first row of each polygon among the `R`
    boxes: Int[np.ndarray, "P 4"]  # left, top, right, bottom; the last two excluded


def see_faces(mesh: Mesh, camera: Camera) -> tuple[Int[np.ndarray, "H W"], Projection]:
    """The nearest face at each pixel, `NO_FACE` where there is none."""
    distance = mesh.offset - mesh.normal @ camera.position_m
    projection = _project_planes(mesh, camera, distance)
    polygons = _project_corners(mesh, camera, distance)
    spans = _scan(polygons, camera)
    nearest = np.zeros((camera.height_px, camera.width_px), np.float32)
    seen = np.full((camera.height_px, camera.width_px), NO_FACE, np.int32)
    planes = projection.inverse_depth.astype(np.float32)
    columns = np.arange(camera.width_px, dtype=np.int32)
    x = columns.astype(np.float32) + np.float32(0.5)
    y = np.arange(camera.height_px, dtype=np.float32)[:, None] + np.float32(0.5)
    for row, face in enumerate(polygons.face):
        left, top, right, bottom = spans.boxes[row]
        if left >= right or top >= bottom:
            continue
        span = slice(spans.starts[row], spans.starts[row] + bottom - top)
        window = (slice(top, bottom), slice(left, right))
        a, b, c = planes[face]
        depth = a * x[left:right] + (b * y[top:bottom] + c)
        closer = depth > nearest[window]
        closer &= columns[left:right] >= spans.first[span, None]
        closer &= columns[left:right] < spans.end[span, None]
        np.copyto(nearest[window], depth, where=closer)
        np.copyto(seen[window], face, where=closer)
    return seen, projection


def shade(
    mesh: Mesh,
    projection: Projection,
    seen: Int[np.ndarray, "H W"],
    camera: Camera,
    images: Atlas,
    lights: Atlas,
    light_scale: Float[np.ndarray, "n 2"],
) -> tuple[UInt8[np.ndarray, "H W 3"], Float[np.ndarray, "H W 2"]]:
    """Looks up the color and the lamp and window light of every pixel.

    Args:
      light_scale: Light texels per color texel along u and v, per surface.
    """
    face = np.maximum(seen, 0)
    depth = 1 / np.maximum(_evaluate(projection.inverse_depth, face), np.float32(1e-4))
    u = _evaluate(projection.texels[:, 0], face) * depth
    v = _evaluate(projection.texels[:, 1], face) * depth
    level = _choose_level(mesh, camera, face, depth, images.num_levels)
    scale = (0.5 ** np.arange(images.num_levels)).astype(np.float32)[level]
    origins = images.origins[mesh.surface].astype(np.float32)[face, level]
    color = _look_up(images, origins[..., 0] + u * scale, origins[..., 1] + v * scale)
    start, step = lights.origins[mesh.surface, 0], light_scale[mesh.surface]
    light = _look_up(
        lights,
        _take(start[:, 0], face) + u * _take(step[:, 0], face),
        _take(start[:, 1], face) + v * _take(step[:, 1], face),
    )
    light[seen == NO_FACE] = 0
    return color, light


def _choose_level(
    mesh: Mesh,
    camera: Camera,
    face: Int[np.ndarray, "H W"],
    depth: Float[np.ndarray, "H W"],
    num_levels: int,
) -> Int[np.ndarray, "H W"]:
    """The smaller version of an image whose texels are about as large as the pixels."""
    distance = np.maximum(np.abs(mesh.offset - mesh.normal @ camera.position_m), 1e-6)
    sharpness = np.log2(mesh.texels_per_m / camera.focal_px) - 0.5 * np.log2(distance)
    # Texels per pixel grow with depth, and by half its power more with the slant of the face. The
    # last term prefers the sharper of two versions.
    level = _take(sharpness, face) + np.float32(1.5) * np.log2(depth) - np.float32(0.35)
    return np.clip(np.rint(level), 0, num_levels - 1).astype(np.int32)


def _take(values: Float[np.ndarray, "F"], face: Int[np.ndarray, "H W"]) -> np.ndarray:
    """A face's value at each of its pixels."""
    return values.astype(np.float32)[face]


def _evaluate(planes: Float[np.ndarray, "F 3"], face: Int[np.ndarray, "H W"]) -> np.ndarray:
    """A face's plane over the image at each of its pixels."""
    height, width = face.shape
    x = np.arange(width, dtype=np.float32) + np.float32(0.5)
    y = np.arange(height, dtype=np.float32)[:, None] + np.float32(0.5)
    a, b, c = (_take(planes[:, column], face) for column in range(3))
    return x * a + y * b + c


def _look_up(atlas: Atlas, x: Float[np.ndarray, "H W"], y: Float[np.ndarray, "H W"]) -> np.ndarray:
    """Reads an atlas between its texels; whole numbers are their corners."""
    half = np.float32(0.5)
    return cv2.remap(atlas.pixels, x - half, y - half, cv2.INTER_LINEAR)


def _project_planes(mesh: Mesh, camera: Camera, distance: Float[np.ndarray, "F"]) -> Projection:
    """Depth and texels along the rays of the image, for every face."""
    to_ray = np.array(
        [
            [1 / camera.focal_px, 0, -0.5 * camera.width_px / camera.focal_px],
            [0, 1 / camera.focal_px, -0.5 * camera.height_px / camera.focal_px],
            [0, 0, 1.0],
        ]
    )
    back = camera.rotation.T @ to_ray
    safe = np.where(np.abs(distance) < 1e-9, 1e-9, distance)
    inverse_depth = mesh.normal @ back / safe[:, None]
    at_camera = mesh.texel_slope @ camera.position_m + mesh.texel_start
    texels = mesh.texel_slope @ back + at_camera[..., None] * inverse_depth[:, None]
    return Projection(inverse_depth, texels)


def _project_corners(mesh: Mesh, camera: Camera, distance: Float[np.ndarray, "F"]) -> _Polygons:
    """Outlines on the image of all faces that show their front before the near plane."""
    in_camera = (mesh.corners - camera.position_m) @ camera.rotation.T
    nearest = np.minimum.reduceat(in_camera[:, 2], mesh.starts)
    farthest = np.maximum.reduceat(in_camera[:, 2], mesh.starts)
    drawn = (distance < -1e-6) & (farthest > _NEAR_M)
    whole = np.flatnonzero(drawn & (nearest >= _NEAR_M))
    cut = np.flatnonzero(drawn & (nearest < _NEAR_M))
    clipped = [
        _clip_near(in_camera[mesh.starts[face] : mesh.starts[face] + mesh.counts[face]])
        for face in cut
    ]
    corners = np.concatenate([in_camera[_ranges(mesh.starts[whole], mesh.counts[whole])], *clipped])
    center = np.array([camera.width_px, camera.height_px]) / 2
    on_screen = corners[:, :2] / corners[:, 2:] * camera.focal_px + center
    counts = np.concatenate([mesh.counts[whole], [len(polygon) for polygon in clipped]]).astype(int)
    polygons = _Polygons(on_screen, counts, np.concatenate([whole, cut]))
    return _drop_unseen(polygons, camera)


def _drop_unseen(polygons: _Polygons, camera: Camera) -> _Polygons:
    """Without the polygons whose bounding box misses the image."""
    starts = np.cumsum(polygons.counts) - polygons.counts
    low = np.minimum.reduceat(polygons.points, starts)
    high = np.maximum.reduceat(polygons.points, starts)
    seen = ((low < (camera.width_px, camera.height_px)) & (high > 0)).all(axis=1)
    rows = np.flatnonzero(seen)
    points = polygons.points[_ranges(starts[rows], polygons.counts[rows])]
    return _Polygons(points, polygons.counts[rows], polygons.face[rows])


def _scan(polygons: _Polygons, camera: Camera) -> _Spans:
    """Finds the pixels of convex polygons, given clockwise as seen, row by row.

    A pixel belongs to a polygon if its middle is inside: polygons that share an edge share no
    pixel and leave none out.
    """
    counts = polygons.counts
    starts = np.cumsum(counts) - counts
    after = np.arange(len(polygons.points)) + 1
    after[starts + counts - 1] = starts
    here, there = polygons.points, polygons.points[after]
    rises = there[:, 1] < here[:, 1]
    # Edges run from their upper end, so that both neighbors of an edge find the same pixels.
    upper, lower = (np.where(rises[:, None], a, b) for a, b in ((there, here), (here, there)))
    rows = [
        np.ceil(np.clip(end[:, 1] - 0.5, 0, camera.height_px)).astype(int) for end in (upper, lower)
    ]
    num_rows = rows[1] - rows[0]
    top = np.minimum.reduceat(np.where(num_rows > 0, rows[0], camera.height_px), starts)
    bottom = np.maximum.reduceat(np.where(num_rows > 0, rows[1], 0), starts)
    heights = np.maximum(bottom - top, 0)
    span_starts = np.cumsum(heights) - heights

    edge = np.repeat(np.arange(len(here)), num_rows)
    row = _ranges(rows[0], num_rows)
    with np.errstate(divide="ignore", invalid="ignore"):
        slope = (lower[:, 0] - upper[:, 0]) / (lower[:, 1] - upper[:, 1])
    x = upper[edge, 0] + (row + 0.5 - upper[edge, 1]) * slope[edge]
    column = np.ceil(np.clip(x - 0.5, 0, camera.width_px)).astype(np.int32)
    polygon = np.repeat(np.arange(len(counts)), counts)[edge]
    slot = span_starts[polygon] + row - top[polygon]
    first = np.full(heights.sum(), camera.width_px, np.int32)
    end = np.zeros(heights.sum(), np.int32)
    leftwards = rises[edge]
    first[slot[leftwards]] = column[leftwards]
    end[slot[~leftwards]] = column[~leftwards]

    boxes = np.zeros((len(counts), 4), int)
    filled = np.flatnonzero(heights)
    boxes[:, 1], boxes[:, 3] = top, bottom
    if len(filled):
        boxes[filled, 0] = np.minimum.reduceat(first, span_starts[filled])
        boxes[filled, 2] = np.maximum.reduceat(end, span_starts[filled])
    return _Spans(first, end, span_starts, boxes)


def _ranges(starts: Int[np.ndarray, "n"], counts: Int[np.ndarray, "n"]) -> Int[np.ndarray, "m"]:
    """`start, start + 1, ...` for each start, one after the other."""
    begin = np.cumsum(counts) - counts
    return np.arange(counts.sum()) + np.repeat(starts - begin, counts)


def _clip_near(polygon: Float[np.ndarray, "k 3"]) -> Float[np.ndarray, "m 3"]:
    """Cuts off what lies in front of the near plane (Sutherland-Hodgman, one plane)."""
    kept = []
    for here, after in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        if here[2] >= _NEAR_M:
            kept.append(here)
        if (here[2] >= _NEAR_M) != (after[2] >= _NEAR_M):
            share = (_NEAR_M - here[2]) / (after[2] - here[2])
            kept.append(here + share * (after - here))
    return np.array(kept)
