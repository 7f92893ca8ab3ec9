"""Colors and textures taken from the picture."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from simfoundry.capture.shapes.fit import FittedShape, fit_shape
from simfoundry.capture.shapes.texture import dominant_color, face_normals, textured_mesh, unwrap
from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Box, Cylinder, Geometry, Mesh, Sphere, revolved, tessellate
from tests.capture.depth_camera import see, yaw_pose

# +x red, -x green, +y blue, -y yellow, +z white, -z black
PAINT = np.array([[220, 20, 20], [20, 200, 20], [30, 40, 220], [230, 220, 20], [235, 235, 235], [5, 5, 5]], np.uint8)
MAGENTA = np.array([255, 0, 255])
CARTON = Box(np.array([0.12, 0.08, 0.15]))
MUG = revolved(np.array([[0, 0.006], [0.036, 0.006], [0.036, 0.095], [0.04, 0.095], [0.04, 0], [0, 0]]))


def decode(png: bytes) -> NDArray[np.uint8]:
    import cv2

    picture = cv2.imdecode(np.frombuffer(png, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    return np.asarray(picture[:, :, ::-1], dtype=np.uint8)


def painted(geometry: Geometry, X_WO: Pose) -> tuple[Mesh, FittedShape]:
    """The textured mesh of a painted solid whose shape is known exactly."""
    frame, support, labels = see([(geometry, X_WO)], face_colors=PAINT)
    shape = FittedShape(geometry, X_WO, 0.0, 1.0, False)
    return textured_mesh(shape, frame, support, labels == 1), shape


def color_of_faces(mesh: Mesh, direction: Array) -> Array:
    """Mean texture color at the centers of the faces that look in a direction of the object frame."""
    assert mesh.uv is not None and mesh.texture is not None
    picture = decode(mesh.texture)
    size = picture.shape[0]
    facing = face_normals(mesh.vertices, mesh.faces) @ direction > 0.9
    centers = mesh.uv[mesh.faces[facing]].mean(axis=1)
    col, row = (centers[:, 0] * size).astype(int), ((1 - centers[:, 1]) * size).astype(int)
    return np.asarray(picture[row, col].astype(float).mean(axis=0))


def test_visible_faces_of_a_box_get_their_own_colors() -> None:
    mesh, _ = painted(CARTON, yaw_pose(0.02, 0.01, 0.075, 60))
    # The camera stands toward (-0.9, -0.4): turned by 60 degrees, the faces -x and +y look at it, and the top.
    top = color_of_faces(mesh, np.array([0.0, 0.0, 1.0]))
    green = color_of_faces(mesh, np.array([-1.0, 0.0, 0.0]))
    blue = color_of_faces(mesh, np.array([0.0, 1.0, 0.0]))
    assert np.abs(top - PAINT[4]).max() < 6
    assert np.abs(green - PAINT[1]).max() < 6
    assert np.abs(blue - PAINT[2]).max() < 6


def test_hidden_faces_mirror_the_seen_ones() -> None:
    mesh, _ = painted(CARTON, yaw_pose(0.02, 0.01, 0.075, 60))
    assert np.abs(color_of_faces(mesh, np.array([1.0, 0.0, 0.0])) - PAINT[1]).max() < 6
    assert np.abs(color_of_faces(mesh, np.array([0.0, -1.0, 0.0])) - PAINT[2]).max() < 6


@pytest.mark.parametrize(
    ("geometry", "height"), [(CARTON, 0.075), (Cylinder(0.04, 0.1), 0.05), (Sphere(0.05), 0.05), (MUG, 0.0)]
)
def test_no_color_bleeds_in(geometry: Geometry, height: float) -> None:
    mesh, _ = painted(geometry, yaw_pose(0.02, 0.01, height, 37))
    assert mesh.texture is not None
    picture = decode(mesh.texture).reshape(-1, 3).astype(int)
    assert np.abs(picture - MAGENTA).sum(axis=1).min() > 60
    assert max(decode(mesh.texture).shape) <= 512


@pytest.mark.parametrize("geometry", [CARTON, Cylinder(0.04, 0.1), Sphere(0.05), MUG])
def test_textured_mesh_is_the_same_surface(geometry: Geometry) -> None:
    mesh, shape = painted(geometry, yaw_pose(0.02, 0.01, 0.08, 37))
    plain = tessellate(shape.geometry)
    assert mesh.uv is not None and mesh.uv.shape == (len(mesh.vertices), 2)
    assert mesh.uv.min() >= 0 and mesh.uv.max() <= 1
    assert np.array_equal(mesh.vertices[mesh.faces], plain.vertices[plain.faces])


def test_texture_is_upright_with_v_up() -> None:
    frame, support, labels = see([(Cylinder(0.04, 0.1), Pose.of((0.02, 0.01, 0.05)))])
    points = support.X_WC.apply(frame.points)
    color = frame.color.copy()
    color[(labels == 1) & (points[..., 2] > 0.05)] = (200, 30, 30)
    color[(labels == 1) & (points[..., 2] <= 0.05)] = (30, 30, 200)
    shape = FittedShape(Cylinder(0.04, 0.1), Pose.of((0.02, 0.01, 0.05)), 0.0, 1.0, False)
    mesh = textured_mesh(shape, type(frame)(color, frame.depth, frame.K), support, labels == 1)
    assert mesh.uv is not None and mesh.texture is not None
    picture, size = decode(mesh.texture), decode(mesh.texture).shape[0]
    corners, uv = mesh.vertices[mesh.faces], mesh.uv[mesh.faces]
    side = np.abs(face_normals(mesh.vertices, mesh.faces)[:, 2]) < 0.1
    for weight in ((0.8, 0.1, 0.1), (0.1, 0.8, 0.1), (0.1, 0.1, 0.8)):
        height = np.einsum("ijk,j->ik", corners[side], weight)[:, 2]
        at = np.einsum("ijk,j->ik", uv[side], weight)
        got = picture[((1 - at[:, 1]) * size).astype(int), (at[:, 0] * size).astype(int)].astype(int)
        upper = got[:, 0] > got[:, 2]
        clear = np.abs(height) > 0.01
        assert (upper[clear] == (height[clear] > 0)).mean() > 0.97


def test_fitted_shape_to_texture_is_deterministic() -> None:
    frame, support, labels = see([(CARTON, yaw_pose(0.02, 0.01, 0.075, 37))], face_colors=PAINT)
    shape = fit_shape(frame, support, labels == 1, 0.0, labels=labels)
    first = textured_mesh(shape, frame, support, labels == 1)
    second = textured_mesh(shape, frame, support, labels == 1)
    assert first.digest == second.digest
    assert first.texture is not None and first.texture.startswith(b"\x89PNG")


def test_charts_do_not_overlap() -> None:
    size = 128
    atlas = unwrap(np.asarray(MUG.vertices), np.asarray(MUG.faces), size)
    corners = atlas.texel[atlas.faces]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
    area = np.abs(np.linalg.det(edges)) / 2
    owner = np.zeros((size * 4, size * 4), dtype=int)
    grid = (np.arange(size * 4) + 0.5) / 4
    for triangle in corners[area > 1e-6]:
        a, b, c = triangle
        low, high = np.floor(triangle.min(axis=0) * 4).astype(int), np.ceil(triangle.max(axis=0) * 4).astype(int)
        x, y = np.meshgrid(grid[low[0] : high[0]], grid[low[1] : high[1]])
        w = np.linalg.solve(np.column_stack([b - a, c - a]), np.stack([x.ravel() - a[0], y.ravel() - a[1]]))
        inside = ((w > 1e-6).all(axis=0) & (w.sum(axis=0) < 1 - 1e-6)).reshape(x.shape)
        owner[low[1] : high[1], low[0] : high[0]] += inside
    assert owner.max() == 1
    assert area.sum() > 0.2 * size**2


def test_dominant_color_ignores_highlights_and_the_rim() -> None:
    frame, _, labels = see([(CARTON, yaw_pose(0.02, 0.01, 0.075, 37))])
    mask = labels == 1
    color = frame.color.copy()
    rows, cols = np.nonzero(mask)
    color[mask] = (40, 90, 160)
    color[rows[: len(rows) // 12], cols[: len(rows) // 12]] = 255
    grown = mask | np.roll(mask, 1, axis=1) | np.roll(mask, -1, axis=1)
    r, g, b = dominant_color(type(frame)(color, frame.depth, frame.K), grown)
    assert (r, g, b) == pytest.approx((40 / 255, 90 / 255, 160 / 255), abs=0.01)


def test_empty_mask_is_refused() -> None:
    frame, support, labels = see([(CARTON, yaw_pose(0.02, 0.01, 0.075, 37))])
    shape = FittedShape(CARTON, Pose.of((0, 0, 0.075)), 0.0, 1.0, False)
    with pytest.raises(ValueError, match="empty mask"):
        textured_mesh(shape, frame, support, np.zeros_like(labels, dtype=bool))
