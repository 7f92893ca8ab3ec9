"""Shapes fitted to real captures of objects whose true size is known. Skipped where the captures are absent.

A default run fits one object of each kind and each camera.
"""

from __future__ import annotations

import functools
import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh
from numpy.typing import NDArray

from simfoundry.capture.frame import Frame, SupportSurface
from simfoundry.capture.shapes.fit import FittedShape, fit_shape, size_of
from simfoundry.capture.shapes.solid_casts import cast_mesh
from simfoundry.capture.shapes.texture import textured_mesh
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Cylinder, Mesh, tessellate

DATA = Path(__file__).resolve().parents[2].parent / "shared" / "data"

# Between the middles of opposite faces of the scanned cartons, which bulge: their bounding boxes are up to 8 mm larger.
CRACKERS, SUGAR = (0.0642, 0.1601, 0.2115), (0.0408, 0.0901, 0.1750)

# What the inverse depth of the camera behind `posecnn_demo` is too large by [1/m], 3% at one meter. A constant there
# maps planes to planes, so no single object gives it away, but upright faces lean back by 4 to 6 degrees, lids lie low
# far from any edge, and this one number brings cartons, bowl and pitcher of four frames to their sizes.
TOO_NEAR = 0.03

pytestmark = [
    pytest.mark.slow,  # 10 s
    pytest.mark.skipif(not DATA.is_dir(), reason=f"no real captures at {DATA}"),
]


def read(path: Path) -> NDArray[Any]:
    import cv2

    picture = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
    assert picture is not None, path
    return np.asarray(picture)


def load(folder: str, index: int) -> tuple[Frame, dict[str, Any]]:
    entry = json.loads((DATA / folder / "capture.json").read_text())["frames"][index]
    raw = read(DATA / folder / entry["depth"])
    depth = np.where(np.isin(raw, entry["depth_invalid"]), np.nan, raw * entry["depth_scale_to_m"])
    return Frame(read(DATA / folder / entry["rgb"])[:, :, ::-1].copy(), depth, np.array(entry["K"], float)), entry


def plane_under(frame: Frame, candidates: NDArray[np.bool_]) -> SupportSurface:
    """The plane that most of the candidate pixels lie on, by sampling."""
    points = frame.points[candidates & np.isfinite(frame.depth)]
    rng = np.random.default_rng(0)
    sample = points[rng.integers(0, len(points), 4000)]
    best = np.zeros(len(points), dtype=bool)
    for _ in range(300):
        a, b, c = sample[rng.integers(0, len(sample), 3)]
        normal = np.cross(b - a, c - a)
        if np.linalg.norm(normal) > 1e-6:
            near = np.abs((sample - a) @ (normal / np.linalg.norm(normal))) < 0.008
            if near.sum() > best.sum():
                best = near
    inliers = sample[best]
    for _ in range(3):
        origin = inliers.mean(axis=0)
        normal = np.linalg.svd(inliers - origin, full_matrices=False)[2][2]
        inliers = points[np.abs((points - origin) @ normal) < 0.008][::11]
    normal = normal if normal @ origin < 0 else -normal
    x = np.array([0.0, 0.0, 1.0]) - normal[2] * normal
    x /= np.linalg.norm(x)
    X_WC = np.eye(4)
    X_WC[:3, :3] = np.stack([x, np.cross(normal, x), normal])
    X_WC[:3, 3] = -X_WC[:3, :3] @ origin
    pose = Pose.from_matrix(X_WC)
    height = pose.apply(frame.points)[..., 2]
    return SupportSurface(pose, frozen_array(np.zeros((0, 2))), 0.002, np.abs(height) < 0.008)


def component_at(frame: Frame, support: SupportSurface, u: int, v: int) -> NDArray[np.bool_]:
    """Pixels above the plane that hang together without a step in depth, from a pixel on the object."""
    from scipy import ndimage

    depth = frame.depth
    step = np.abs(np.diff(depth, axis=1, prepend=depth[:, :1])) > 0.012
    step |= np.abs(np.diff(depth, axis=0, prepend=depth[:1])) > 0.012
    part, _ = ndimage.label(np.isfinite(depth) & (support.X_WC.apply(frame.points)[..., 2] > 0.012) & ~step)
    near = part[v - 12 : v + 13, u - 12 : u + 13]
    assert near.any(), "no depth near the seed pixel"
    return np.asarray(part == np.argmax(np.bincount(near[near > 0])))


@functools.cache
def posecnn(
    index: int, u: int, v: int, nearer: float = 0.0
) -> tuple[FittedShape, Frame, SupportSurface, NDArray[np.bool_]]:
    """A fit to the object at pixel (u, v); ``nearer`` [1/m] is what the camera's inverse depth is too large by."""
    frame, _ = load("posecnn_demo", index)
    depth = 1 / (1 / frame.depth - nearer)
    frame = Frame(frame.color, np.where(depth > 1.6, np.nan, depth), frame.K)
    support = plane_under(frame, np.isfinite(frame.depth))
    mask = component_at(frame, support, u, v)
    return fit_shape(frame, support, mask, 0.0), frame, support, mask


def graspnet(index: int) -> FittedShape:
    from scipy import ndimage

    frame, entry = load("graspnet6dof", index)
    support = plane_under(frame, np.isfinite(frame.depth))
    target = np.load(DATA / "graspnet6dof" / entry["target_object_points"]).reshape(-1, 3).astype(float)
    p_W, target_W = support.X_WC.apply(frame.points), support.X_WC.apply(target)
    low, high = np.percentile(target_W, 1, axis=0)[:2] - 0.02, np.percentile(target_W, 99, axis=0)[:2] + 0.02
    above = (p_W[..., 2] > 0.006) & ((p_W[..., :2] > low) & (p_W[..., :2] < high)).all(axis=-1)
    part, _ = ndimage.label(above)
    return fit_shape(frame, support, part == 1 + np.argmax(np.bincount(part[part > 0])[1:]), 0.0)


@pytest.mark.slow
def test_cracker_box_behind_a_bottle() -> None:
    shape, *_ = posecnn(4, 250, 120)
    assert isinstance(shape.geometry, Box)
    thin, wide, tall = sorted(size_of(shape.geometry))
    assert tall == pytest.approx(CRACKERS[2], abs=0.007)
    assert wide == pytest.approx(CRACKERS[1], abs=0.004)
    assert thin == pytest.approx(CRACKERS[0], abs=0.012)


def test_sugar_box_lying() -> None:
    shape, *_ = posecnn(1, 266, 373)
    assert isinstance(shape.geometry, Box)
    assert sorted(size_of(shape.geometry)) == pytest.approx(SUGAR, abs=0.009)
    assert size_of(shape.geometry)[2] == pytest.approx(SUGAR[0], abs=0.003)


def test_bowl_is_hollow() -> None:
    shape, *_ = posecnn(2, 445, 312)
    assert shape.hollow
    width, _, height = size_of(shape.geometry)
    assert width == pytest.approx(0.161, abs=0.008)
    assert height == pytest.approx(0.055, abs=0.005)


@pytest.mark.slow
def test_pitcher_height() -> None:
    shape, *_ = posecnn(3, 294, 255)
    assert size_of(shape.geometry)[2] == pytest.approx(0.235, abs=0.015)


@pytest.mark.slow  # 2 s
@pytest.mark.parametrize(
    ("index", "u", "v", "truth"),
    [
        # its narrow side is seen at a grazing angle
        pytest.param(4, 250, 120, (None, *CRACKERS[1:]), marks=pytest.mark.slow),
        (1, 266, 373, SUGAR),
        pytest.param(0, 395, 196, CRACKERS, marks=pytest.mark.slow),
        pytest.param(2, 445, 312, (0.055, 0.161, 0.161), marks=pytest.mark.slow),
        (3, 294, 255, (None, None, 0.235)),
    ],
    ids=["crackers", "sugar", "crackers lying", "bowl", "pitcher"],
)
def test_sizes_once_the_camera_is_put_right(index: int, u: int, v: int, truth: tuple[float | None, ...]) -> None:
    shape, *_ = posecnn(index, u, v, TOO_NEAR)
    for got, want in zip(sorted(size_of(shape.geometry)), truth, strict=True):
        assert want is None or got == pytest.approx(want, abs=max(0.005, 0.035 * want))


def test_sugar_carton() -> None:
    shape = graspnet(1)
    assert isinstance(shape.geometry, Box) and shape.confidence > 0.75
    assert sorted(size_of(shape.geometry)) == pytest.approx(SUGAR, abs=0.004)


@pytest.mark.slow
def test_cracker_carton_covers_its_outline() -> None:
    """Its true size is unknown; the sizes are those whose edges lie on the carton's edges in the color picture."""
    shape = graspnet(2)
    assert isinstance(shape.geometry, Box) and shape.confidence > 0.9 and shape.fit_m < 0.001
    assert sorted(size_of(shape.geometry)) == pytest.approx([0.051, 0.150, 0.193], abs=0.003)


@pytest.mark.parametrize(
    ("index", "kind"),
    [
        (0, "hollow"),
        pytest.param(3, "hollow", marks=pytest.mark.slow),
        (4, "can"),
        pytest.param(5, "can", marks=pytest.mark.slow),
    ],
)
def test_mug_bowl_and_cans(index: int, kind: str) -> None:
    shape = graspnet(index)
    assert shape.hollow == (kind == "hollow")
    if kind == "can":
        assert isinstance(shape.geometry, Cylinder) or size_of(shape.geometry)[2] > 0.12
    assert shape.confidence > 0.7 and shape.fit_m < 0.002


@pytest.mark.slow
def test_table_of_containers_and_tins() -> None:
    frame, entry = load("mosd_dev", 11)
    parts = read(DATA / "mosd_dev" / entry["label_image"]).astype(int)
    labels = np.where(parts >= 20, parts // 10 - 1, 0).astype(np.int32)
    support = plane_under(frame, (parts >= 1) & (parts <= 9))
    shapes = [fit_shape(frame, support, labels == k, 0.0, labels=labels) for k in range(1, 6)]
    assert [s.hollow for s in shapes] == [False, False, True, True, True]
    assert all(isinstance(s.geometry, Cylinder) for s in shapes[:2])
    for shape in shapes:
        mesh = tessellate(shape.geometry)
        solid = trimesh.Trimesh(shape.X_WO.apply(mesh.vertices), mesh.faces, process=False)
        assert solid.is_watertight and solid.volume > 0
        assert solid.bounds[0, 2] == pytest.approx(0.0, abs=1e-6)


def warped(entry: dict[str, Any]) -> Frame:
    """Color with the depth of the other camera brought over to it."""
    raw = read(DATA / "m3t_desk" / entry["depth"])
    z = np.where(np.isin(raw, entry["depth_invalid"]), np.nan, raw * entry["depth_scale_to_m"])
    X_CD = np.array(entry["T_color_depth"])
    points = Frame(np.zeros((*z.shape, 3), np.uint8), z, np.array(entry["depth_K"], float)).points[z < 1.5]
    points = points @ X_CD[:3, :3].T + X_CD[:3, 3]
    z_C: Array = points[:, 2]
    color, K = read(DATA / "m3t_desk" / entry["rgb"])[:, :, ::-1].copy(), np.array(entry["K"], float)
    depth: Array = np.full(color.shape[:2], np.inf)
    for du, dv in [(a, b) for a in (-0.6, 0.0, 0.6) for b in (-0.6, 0.0, 0.6)]:
        u = np.round(points[:, 0] / points[:, 2] * K[0, 0] + K[0, 2] + du).astype(int)
        v = np.round(points[:, 1] / points[:, 2] * K[1, 1] + K[1, 2] + dv).astype(int)
        ok = (u >= 0) & (v >= 0) & (u < depth.shape[1]) & (v < depth.shape[0])
        np.minimum.at(depth, (v[ok], u[ok]), z_C[ok])
    return Frame(color, np.where(np.isfinite(depth), depth, np.nan), K)


def silhouette(frame: Frame, vertices_C: Array, faces: NDArray[np.int32]) -> NDArray[np.bool_]:
    h, w = frame.depth.shape
    u, v = np.meshgrid(np.arange(w), np.arange(h))
    rays = [(u - frame.K[0, 2]) / frame.K[0, 0], (v - frame.K[1, 2]) / frame.K[1, 1], np.ones((h, w))]
    hits = cast_mesh(np.zeros(3), np.stack(rays, axis=-1).reshape(-1, 3), vertices_C, faces)
    return np.isfinite(hits.depth).reshape(h, w)


@pytest.mark.slow  # 2 s
def test_shampoo_bottle_where_its_pose_says() -> None:
    entry = json.loads((DATA / "m3t_desk" / "capture.json").read_text())["frames"][0]
    frame = warped(entry)
    bottle = trimesh.load(DATA / "m3t_desk" / entry["objects"][0]["mesh"], force="mesh")
    X_CO = np.array(entry["objects"][0]["T_cam_obj"], float)
    truth_C = np.asarray(bottle.vertices) @ X_CO[:3, :3].T + X_CO[:3, 3]
    mask = silhouette(frame, truth_C, np.asarray(bottle.faces))
    support = plane_under(frame, np.isfinite(frame.depth))
    shape = fit_shape(frame, support, mask, 0.0)
    assert isinstance(shape.geometry, Mesh)
    truth, got = support.X_WC.apply(truth_C), shape.X_WO.apply(shape.geometry.vertices)
    center = (truth.min(axis=0) + truth.max(axis=0)) / 2
    assert np.linalg.norm((got.min(axis=0) + got.max(axis=0)) / 2 - center) < 0.02
    assert np.ptp(got, axis=0) == pytest.approx(np.ptp(truth, axis=0), abs=0.015)


def test_texture_of_a_real_box_shows_its_colors() -> None:
    import cv2

    shape, frame, support, mask = posecnn(1, 266, 373)
    mesh = textured_mesh(shape, frame, support, mask)
    assert mesh.texture is not None
    picture = cv2.imdecode(np.frombuffer(mesh.texture, np.uint8), cv2.IMREAD_COLOR)
    assert picture is not None
    blue, green, red = picture.reshape(-1, 3).astype(int).T
    assert ((red > 150) & (green > 120) & (blue < 110)).mean() > 0.3
