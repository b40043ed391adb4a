"""Surfaces cut into flat faces, with what a rasterizer needs to know of each.

Letters: `F` faces, `V` corners of all faces one after the other.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from remind_jax.synthetic.surfaces import Surface

_FLAT_TOLERANCE_M = 1e-7


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
