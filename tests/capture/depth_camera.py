"""A table with solids on it as a depth camera sees them: one-sided, noisy, with flying pixels at the edges."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.shapes.solid_casts import cast_mesh, first_faces
from simfoundry.capture.shapes.texture import face_normals
from simfoundry.geometry.frames import Array, Pose, frozen_array, look_at
from simfoundry.geometry.shapes import Geometry, tessellate

WIDTH, HEIGHT, FOCAL = 320, 240, 300.0
K = np.array([[FOCAL, 0, 158.7], [0, FOCAL * 1.002, 121.4], [0, 0, 1]])
NOISE = 0.0015
EYE = np.array([-0.55, -0.25, 0.48])

Solid = tuple[Geometry, Pose]


def yaw_pose(x: float, y: float, z: float, yaw_deg: float) -> Pose:
    half = np.deg2rad(yaw_deg) / 2
    return Pose.of((x, y, z), (np.cos(half), 0, 0, np.sin(half)))


def see(
    solids: list[Solid], *, eye: Array = EYE, noise: float = NOISE, face_colors: NDArray[np.uint8] | None = None
) -> tuple[Frame, SupportSurface, NDArray[np.int32]]:
    """Frame, support and labels (1..n) of solids above the plane z = 0.

    ``face_colors`` uint8, shape (6, 3), paints the first solid by the direction of its surface in its own frame:
    +x, -x, +y, -y, +z, -z. The table is magenta, which no object may take up.
    """
    rng = np.random.default_rng(7)
    X_WC = look_at(eye, np.array([0.02, 0.01, 0.05]))
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(u.shape)], axis=-1).reshape(-1, 3)
    rays = rays @ X_WC.rotation.T
    with np.errstate(divide="ignore"):
        plane = -X_WC.p[2] / rays[:, 2]
    depth = np.where((plane > 0) & (plane < 1.6), plane, np.nan)
    labels = np.zeros(len(rays), np.int32)
    color = np.tile(np.array([255, 0, 255], np.uint8), (len(rays), 1))
    for number, (geometry, X_WO) in enumerate(solids, 1):
        mesh = tessellate(geometry)
        vertices = X_WO.apply(mesh.vertices)
        face = first_faces(X_WC.p, rays, vertices, mesh.faces)
        hit = cast_mesh(X_WC.p, rays, vertices, mesh.faces).depth
        index = np.flatnonzero(np.isfinite(hit) & ~(depth < hit))
        depth[index], labels[index] = hit[index], number
        color[index] = (90, 140, 60)
        if number == 1 and face_colors is not None:
            local = face_normals(vertices, mesh.faces)[face[index]] @ X_WO.rotation
            color[index] = face_colors[np.argmax(np.hstack([local, -local])[:, [0, 3, 1, 4, 2, 5]], axis=1)]
    noisy = (depth + rng.normal(0, noise, depth.shape)).reshape(HEIGHT, WIDTH)
    picture = labels.reshape(HEIGHT, WIDTH)
    edge = picture != np.roll(picture, 1, axis=1)
    flying = edge & (rng.random(edge.shape) < 0.5)
    noisy[flying] = (0.5 * noisy + 0.5 * np.roll(noisy, 1, axis=1))[flying]
    outline = frozen_array([[-0.6, -0.6], [0.6, -0.6], [0.6, 0.6], [-0.6, 0.6]])
    frame = Frame(color.reshape(HEIGHT, WIDTH, 3), noisy, K)
    return frame, SupportSurface(X_WC, outline, noise, (picture == 0) & np.isfinite(noisy)), picture


def blinded(frame: Frame, mask: NDArray[np.bool_], inside: int, outside: int) -> Frame:
    """The frame without depth in a band along the silhouette ``mask``, so many pixels wide on either side of it.

    That is how cameras that project a pattern see edges: the pattern falls on both sides of them or into a shadow.
    """
    from scipy import ndimage

    band = ndimage.binary_dilation(mask, iterations=outside) & ~ndimage.binary_erosion(mask, iterations=inside)
    return Frame(frame.color, np.where(band, np.nan, frame.depth), frame.K)
