"""Surfaces cut into flat faces, with what a rasterizer needs to know of each.

Letters: `F` faces, `V` corners of all faces one after the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import cv2
import numpy as np
from jaxtyping import Float, Int, UInt8

from remind_jax.synthetic.surfaces import Surface

_FLAT_TOLERANCE_M = 1e-7

NUM_LEVELS = 4
_GUTTER_PX = 2


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Flat convex faces; each lies in a plane `normal . p = offset` and is seen from outside it.

    Image coordinates `(u, v)`, in texels from the image's upper left corner, are affine in the
    plane: `texel_slope @ p + texel_start`.
    """

    corners: Float[np.ndarray, "V 3"]  # meters
    starts: Int[np.ndarray, "F"]  # first corner of each face
    counts: Int[np.ndarray, "F"]  # corners of each face, at least 3
    normal: Float[np.ndarray, "F 3"]
    offset: Float[np.ndarray, "F"]
    texel_slope: Float[np.ndarray, "F 2 3"]
    texel_start: Float[np.ndarray, "F 2"]
    texels_per_m: Float[np.ndarray, "F"]
    surface: Int[np.ndarray, "F"]  # which surface a face was cut from

    def moved(
        self, rotation: Float[np.ndarray, "F 3 3"], shift_m: Float[np.ndarray, "F 3"]
    ) -> Mesh:
        """Every face turned about the origin of the world and then shifted, on its own."""
        corner_face = np.repeat(np.arange(len(self.counts)), self.counts)
        turned = np.einsum("vij,vj->vi", rotation[corner_face], self.corners)
        normal = np.einsum("fij,fj->fi", rotation, self.normal)
        slope = np.einsum("fij,fkj->fki", rotation, self.texel_slope)
        return dataclasses.replace(
            self,
            corners=turned + shift_m[corner_face],
            normal=normal,
            offset=self.offset + np.einsum("fi,fi->f", normal, shift_m),
            texel_slope=slope,
            texel_start=self.texel_start - np.einsum("fki,fi->fk", slope, shift_m),
        )


def build_mesh(surfaces: Sequence[Surface]) -> Mesh:
    """Cuts surfaces into faces: quads where they are flat parallelograms, else triangles."""
    corners, texels, counts, owners = [], [], [], []
    for index, surface in enumerate(surfaces):
        faces, face_texels = _cut(surface)
        corners += faces
        texels += face_texels
        counts += [len(face) for face in faces]
        owners += [index] * len(faces)
    first = np.array([[face[0], face[1], face[-1]] for face in corners])
    first_texels = np.array([[texel[0], texel[1], texel[-1]] for texel in texels])
    normal, slope = _plane_maps(first, first_texels)
    start = first_texels[:, 0] - np.einsum("fij,fj->fi", slope, first[:, 0])
    return Mesh(
        corners=np.concatenate(corners),
        starts=np.concatenate([[0], np.cumsum(counts)[:-1]]).astype(np.int64),
        counts=np.array(counts),
        normal=normal,
        offset=np.einsum("fi,fi->f", normal, first[:, 0]),
        texel_slope=slope,
        texel_start=start,
        texels_per_m=np.linalg.norm(slope, axis=2).max(1),
        surface=np.array(owners),
    )


def _cut(surface: Surface) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Corners `[k, 3]` and their texels `[k, 2]` of every face of a surface."""
    height, width = surface.image.shape[:2]
    points = surface.points
    if surface.outline is not None:
        u, v = surface.outline.T[..., None]
        right, down = points[0, 1] - points[0, 0], points[1, 0] - points[0, 0]
        return [points[0, 0] + u * right + v * down], [surface.outline * (width, height)]
    rows, columns = points.shape[:2]
    u = np.linspace(0, width, columns)
    v = np.linspace(0, height, rows)
    texels = np.stack(np.meshgrid(u, v), -1)
    faces, face_texels = [], []
    for row in range(rows - 1):
        for column in range(columns - 1):
            ring = ([row, row, row + 1, row + 1], [column, column + 1, column + 1, column])
            quad, quad_texels = points[ring], texels[ring]
            skew = np.abs(quad[0] + quad[2] - quad[1] - quad[3]).max()
            pieces = ((0, 1, 2, 3),) if skew < _FLAT_TOLERANCE_M else ((0, 1, 3), (2, 3, 1))
            for piece in pieces:
                face = quad[list(piece)]
                if np.linalg.norm(np.cross(face[1] - face[0], face[-1] - face[0])) > 1e-10:
                    faces.append(face)
                    face_texels.append(quad_texels[list(piece)])
    return faces, face_texels


def _plane_maps(
    points: Float[np.ndarray, "F 3 3"], texels: Float[np.ndarray, "F 3 2"]
) -> tuple[Float[np.ndarray, "F 3"], Float[np.ndarray, "F 2 3"]]:
    """Unit normals and texel gradients from three corners, given clockwise as seen."""
    edges = points[:, 1:] - points[:, :1]
    steps = texels[:, 1:] - texels[:, :1]
    normal = np.cross(edges[:, 1], edges[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    gram = np.linalg.inv(edges @ edges.swapaxes(1, 2))
    slope = (edges.swapaxes(1, 2) @ gram @ steps).swapaxes(1, 2)
    return normal, slope


@dataclasses.dataclass(frozen=True, eq=False)
class Atlas:
    """Packed images; level `k` is an image at `1 / 2^k` of its size."""

    pixels: UInt8[np.ndarray, "h w c"] | Float[np.ndarray, "h w c"]
    origins: Float[np.ndarray, "n levels 2"]  # x, y of the upper left texel's center

    @property
    def num_levels(self) -> int:
        """How many sizes there are of each image."""
        return self.origins.shape[1]


def pack_images(images: Sequence[np.ndarray], num_levels: int = NUM_LEVELS) -> Atlas:
    """Packs images and their smaller versions; equal images share their place."""
    unique: dict[tuple[tuple[int, ...], bytes], int] = {}
    rows = [unique.setdefault((one.shape, one.tobytes()), len(unique)) for one in images]
    kept = [images[rows.index(row)] for row in range(len(unique))]
    levels = [level for image in kept for level in _shrink(image, num_levels)]
    pixels, origins = _pack(levels)
    return Atlas(pixels, origins.reshape(len(kept), num_levels, 2)[rows])


def _shrink(image: np.ndarray, num_levels: int) -> list[np.ndarray]:
    levels = [image]
    for _ in range(num_levels - 1):
        height, width = levels[-1].shape[:2]
        size = (max(1, (width + 1) // 2), max(1, (height + 1) // 2))
        levels.append(cv2.resize(levels[-1], size, interpolation=cv2.INTER_AREA))
    return levels


def _pack(images: Sequence[np.ndarray]) -> tuple[np.ndarray, Float[np.ndarray, "n 2"]]:
    """Places images in rows of falling height; each gets a border of its own edge texels."""
    sizes = np.array([image.shape[:2] for image in images]) + 2 * _GUTTER_PX
    area = float(np.prod(sizes, axis=1).sum())
    width = max(int(sizes[:, 1].max()), int(np.sqrt(1.1 * area)) + 1)
    corners = np.zeros((len(images), 2), int)
    x = y = row_height = 0
    for index in np.argsort(-sizes[:, 0], kind="stable"):
        height_px, width_px = sizes[index]
        if x + width_px > width:
            x, y, row_height = 0, y + row_height, 0
        corners[index] = x, y
        x, row_height = x + width_px, max(row_height, height_px)
    pixels = np.zeros((y + row_height, width, images[0].shape[2]), images[0].dtype)
    for image, (left, top) in zip(images, corners, strict=True):
        gutter = _GUTTER_PX
        bordered = cv2.copyMakeBorder(image, gutter, gutter, gutter, gutter, cv2.BORDER_REPLICATE)
        height_px, width_px = bordered.shape[:2]
        pixels[top : top + height_px, left : left + width_px] = bordered
    return pixels, corners.astype(np.float64) + _GUTTER_PX
