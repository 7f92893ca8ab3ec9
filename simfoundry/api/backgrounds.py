"""Backgrounds: conversion of splat files, and alignment of a scene's background."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from collections.abc import Sequence

    from simfoundry.geometry.frames import Pose
    from simfoundry.geometry.similarity import Similarity
    from simfoundry.scene.model import Scene
    from simfoundry.spec.files import Loaded
    from simfoundry.splats.alignment import CameraBridge, ColorCloud
    from simfoundry.splats.gaussians import GaussianSplat

# Decimals of positions [m] and angles [deg] that are written: 10 m away, an angle of 1e-4 deg is worth 0.02 mm.
_POSITION_DIGITS, _ANGLE_DIGITS, _SCALE_DIGITS = 5, 4, 8

# Number of points sampled on a background mesh, and least opacity of the Gaussians that count as points.
_SAMPLES, _SOLID = 20_000, 0.3

# Maximum sizes of files with pairs and camera poses [bytes]; a thousand lines have 100 kB.
_MAX_TEXT = 10 * 2**20


@dataclass(frozen=True, eq=False)
class BackgroundAlignment:
    """The alignment of a scene's background.

    Attributes:
        S_WF: Map from the axes of the background's file, with z up, to the world [m].
        error_m: Largest remaining distance [m] of pairs or cameras, or the median distance of clouds.
        note: Sentence about the remaining error.
    """

    S_WF: Similarity
    error_m: float
    note: str

    @property
    def values(self) -> dict[str, Any]:
        """The values of `pose` and `scale` in the document, as plain data."""
        import numpy as np

        from simfoundry.geometry.frames import rpy_from_quat

        rpy = [round(math.degrees(v), _ANGLE_DIGITS) + 0.0 for v in rpy_from_quat(self.S_WF.X_AB.q)]
        pose: dict[str, Any] = {"xyz": [round(float(v), _POSITION_DIGITS) + 0.0 for v in self.S_WF.X_AB.p]}
        if any(rpy[:2]):
            pose["rpy_deg"] = rpy
        elif rpy[2]:
            pose["yaw_deg"] = rpy[2]
        assert np.isfinite(pose["xyz"]).all()
        return {"pose": pose, "scale": float(f"{self.S_WF.scale:.{_SCALE_DIGITS}g}")}


def convert_splat(source: str | Path, out: str | Path, *, scene: str | Path | None = None) -> int:
    """Convert a splat file to the format that the suffix of ``out`` states, and return its number of Gaussians.

    Args:
        source: A PLY, SPZ, GLB or USD file.
        out: The file to write.
        scene: A scene whose background the file is. The splat is written in the scene's world, in meters.

    Raises:
        SimfoundryError: If a file is not usable.
    """
    from simfoundry.assets.errors import MeshError
    from simfoundry.runtime.files import write_atomically
    from simfoundry.splats.files import read_splat, splat_bytes

    try:
        splat = read_splat(Path(source))
        if scene is not None:
            splat = splat.moved(_written_similarity(_loaded(Path(scene))[1]))
        data = splat_bytes(splat, Path(out).name)
    except MeshError as error:
        raise _as_sentence(error) from None
    write_atomically(Path(out), data)
    return len(splat)


def align_background(
    scene: str | Path,
    *,
    pairs: str | Path | None = None,
    reference: str | Path | None = None,
    cameras: str | Path | None = None,
) -> BackgroundAlignment:
    """Find the pose and the scale of a scene's background, by exactly one of the sources. Nothing is written.

    Args:
        scene: The scene document.
        pairs: Text file with a pair of points in each line: three coordinates in the background's file (with z up),
            three in the world [m], and optionally a weight.
        reference: Splat or mesh file that shows the same surroundings in the world, in meters.
        cameras: JSON file with the pose of cameras of the scene in the background's file: ``{"front": [[...], ...]}``
            with a matrix of four rows each, from the camera's axes (x right, y down, z forward) to those of the file.
            With one camera, the scale follows from the depth of the scene's fixed objects, such as a tabletop.

    Raises:
        SpecError: If the document has errors.
        SimfoundryError: If a file is not usable, or does not determine an alignment.
    """
    if sum(source is not None for source in (pairs, reference, cameras)) != 1:
        raise SimfoundryError("give exactly one of: pairs of points, a reference, or camera poses")
    loaded, written = _loaded(Path(scene))
    file = loaded.file(written.mesh or written.splat or "")
    try:
        if pairs is not None:
            return _by_pairs(Path(pairs))
        if reference is not None:
            return _by_reference(file, written.splat is not None, Path(reference))
        assert cameras is not None
        return _by_cameras(loaded, file if written.splat is not None else None, Path(cameras))
    except ValueError as error:
        raise SimfoundryError(f"the background cannot be aligned: {error}") from None


def write_alignment(scene: str | Path, found: BackgroundAlignment) -> Path:
    """Write an alignment to the scene document, keeping its comments and layout."""
    from simfoundry.api.scenes import SceneDocument

    document = SceneDocument.load(scene)
    written = document.background
    assert written is not None
    values: dict[str, Any] = {key: getattr(written, key) for key in ("mesh", "splat") if getattr(written, key)}
    new = found.values
    if new["scale"] == 1.0:
        del new["scale"]
    document.background = {**values, **new}
    return document.save()


def _loaded(path: Path) -> tuple[Loaded, Any]:
    """Return a scene document and its background."""
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_scene(path)
    assert isinstance(loaded.spec, SceneSpec)
    if loaded.spec.background is None:
        raise SimfoundryError(f"{path} has no background; add `background: {{splat: room.ply}}` first")
    return loaded, loaded.spec.background


def _written_similarity(written: Any) -> Similarity:
    from simfoundry.geometry.similarity import Similarity
    from simfoundry.scene.state import pose

    return Similarity(pose(written.pose), written.scale)


def _by_pairs(path: Path) -> BackgroundAlignment:
    from simfoundry.geometry.similarity import fit_similarity

    rows = _numbers(path)
    S_WF = fit_similarity(rows[:, :3], rows[:, 3:6], rows[:, 6])
    worst = float(S_WF.residuals(rows[:, :3], rows[:, 3:6])[rows[:, 6] > 0].max())
    return BackgroundAlignment(S_WF, worst, f"the points of {len(rows)} pairs are at most {1000 * worst:.1f} mm apart")


def _numbers(path: Path) -> Any:
    """Return the rows of a file with pairs, each with a weight, shape (n, 7)."""
    import numpy as np

    rows = []
    for number, line in enumerate(_text(path).splitlines(), 1):
        words = line.partition("#")[0].replace(",", " ").split()
        if not words:
            continue
        try:
            row = [float(word) for word in words]
        except ValueError:
            row = []
        if len(row) not in (6, 7):
            message = "expected six numbers, and optionally a weight"
            raise SimfoundryError(f"{path}, line {number}: {message}; got `{line.strip()[:60]}`")
        rows.append(row if len(row) == 7 else [*row, 1.0])
    return np.array(rows, dtype=np.float64).reshape(-1, 7)


def _text(path: Path) -> str:
    try:
        if path.stat().st_size > _MAX_TEXT:
            raise SimfoundryError(f"{path} has more than {_MAX_TEXT // 2**20} MiB")
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "it is not a text file"
        raise SimfoundryError(f"{path} could not be read: {reason}") from None


def _by_reference(file: Path, is_splat: bool, reference: Path) -> BackgroundAlignment:
    import numpy as np

    from simfoundry.assets.errors import MeshError
    from simfoundry.splats.alignment import ColorCloud, align_clouds

    try:
        here, there = _cloud(file, is_splat), _cloud(reference, None)
    except MeshError as error:
        raise _as_sentence(error) from None
    if any(np.ptp(cloud.colors, axis=0).max() == 0 for cloud in (here, there)):  # a mesh, whose colors are not known
        here, there = (ColorCloud(cloud.points, np.zeros_like(cloud.points)) for cloud in (here, there))
    found = align_clouds(here, there)
    shown = f"the median distance to {reference.name} is {1000 * found.error:.1f} mm"
    return BackgroundAlignment(found.S_AB, found.error, f"{shown}, and {found.overlap:.0%} of it is covered")


def _cloud(path: Path, is_splat: bool | None) -> ColorCloud:
    """Return the points of a splat or mesh file. If it is not known which one it is, a splat is tried first."""
    import numpy as np

    from simfoundry.assets.errors import MeshError
    from simfoundry.assets.mesh import merged, read_parts
    from simfoundry.spec.files import MESH_SUFFIXES, SPLAT_SUFFIXES
    from simfoundry.splats.alignment import ColorCloud
    from simfoundry.splats.files import read_splat
    from simfoundry.splats.harmonics import SH0

    suffix = path.suffix.lower()
    if is_splat or (is_splat is None and suffix in SPLAT_SUFFIXES):
        try:
            splat = read_splat(path)
        except MeshError:
            if is_splat or suffix not in MESH_SUFFIXES:
                raise
        else:
            solid = splat.opacities >= min(_SOLID, float(splat.opacities.max()))
            points = splat.positions[solid].astype(np.float64)
            return ColorCloud(points, np.clip(splat.harmonics[solid, 0] * SH0 + 0.5, 0.0, 1.0).astype(np.float64))
    vertices, faces = merged(read_parts(path))
    corners = vertices[faces]
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    rng = np.random.default_rng(0)
    face = rng.choice(len(faces), _SAMPLES, p=area / area.sum())
    u, v = rng.uniform(size=(2, _SAMPLES))
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    a, b, c = (corners[face, k] for k in range(3))
    return ColorCloud(a + u[:, None] * (b - a) + v[:, None] * (c - a), np.full((_SAMPLES, 3), 0.5))


def _by_cameras(loaded: Loaded, splat_file: Path | None, path: Path) -> BackgroundAlignment:
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.splats.alignment import bridge_cameras

    scene = lower(loaded, Cache.default())
    fixed = {camera.name: camera for camera in scene.cameras}
    X_FC = _camera_poses(path, fixed)
    X_WC = [fixed[name].X_WC for name in X_FC]
    poses = list(X_FC.values())
    if len(poses) > 1:
        return _bridged(bridge_cameras(poses, X_WC), len(poses))
    if splat_file is None:
        raise SimfoundryError("one camera aligns only splats, whose depth gives the scale; give two cameras for a mesh")
    scale = _support_scale(scene, splat_file, next(iter(X_FC)), poses[0])
    return _bridged(bridge_cameras(poses, X_WC, scale), 1)


def _bridged(bridge: CameraBridge, count: int) -> BackgroundAlignment:
    worst, angle = bridge.position_error, math.degrees(bridge.angle_error)
    note = f"the poses of {count} cameras differ by at most {1000 * worst:.1f} mm and {angle:.2f} degrees"
    return BackgroundAlignment(
        bridge.S_WF, worst, note if count > 1 else "the scale is that of the fixed objects' depth"
    )


def _camera_poses(path: Path, known: Sequence[str] | dict[str, Any]) -> dict[str, Pose]:
    """Return the poses of cameras in a JSON file, by name."""
    import numpy as np

    from simfoundry.geometry.frames import Pose

    try:
        data = json.loads(_text(path))
        matrices = {name: np.array(rows, dtype=np.float64) for name, rows in data.items()}
    except (ValueError, TypeError, AttributeError, RecursionError):
        raise SimfoundryError(
            f'{path} is not a JSON mapping from cameras to matrices, such as {{"front": ...}}'
        ) from None
    if not matrices:
        raise SimfoundryError(f"{path} has no cameras")
    poses = {}
    for name, matrix in matrices.items():
        if name not in known:
            names = ", ".join(known) or "none"
            raise SimfoundryError(f"{path}: the scene has no fixed camera `{name}`; it has {names}")
        linear = matrix[:3, :3] if matrix.shape == (4, 4) else np.zeros((3, 3))
        rigid = np.isfinite(matrix).all() and np.abs(linear @ linear.T - np.eye(3)).max() < 1e-3
        if not rigid or np.linalg.det(linear) < 0:
            raise SimfoundryError(f"{path}: the matrix of `{name}` is not a rigid transform with four rows")
        poses[name] = Pose.from_matrix(matrix)
    return poses


def _support_scale(scene: Scene, file: Path, name: str, X_FC: Pose) -> float:
    """Return the length of one unit of a splat [m] from the depth of fixed objects, such as a tabletop."""
    from dataclasses import replace

    import numpy as np

    from simfoundry.assets.errors import MeshError
    from simfoundry.render.raycast import raycast
    from simfoundry.render.views import shrunk
    from simfoundry.splats.alignment import scale_from_depth
    from simfoundry.splats.files import read_splat
    from simfoundry.splats.raster import splat_image

    camera = shrunk(next(c for c in scene.cameras if c.name == name), 320, 240)
    seen = raycast(replace(scene, background=None), camera)
    fixed = np.array([False, *(item.fixed for item in scene.objects)])[seen.objects]
    try:
        splat: GaussianSplat = read_splat(file)
    except MeshError as error:
        raise _as_sentence(error) from None
    depth = splat_image(splat, X_FC.inverse(), camera).depth
    return scale_from_depth(np.where(fixed, depth, 0.0), seen.depth)


def _as_sentence(error: Any) -> SimfoundryError:
    return SimfoundryError(f"{error.message}; {error.hint}" if error.hint else error.message)
