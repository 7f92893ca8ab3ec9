"""Stand-ins for foundation models: simple methods, and annotations of a picture, behind the protocol of the models.

They answer honestly, but none of them is a foundation model, and their identity says so. What they prove is that the
stages of a reconstruction ask for each task, check the answer and use it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scaffold import Model, Result

from simfoundry.models.contract import MESH
from simfoundry.models.offline import OfflineDepth, OfflineImages
from simfoundry.models.setup import ModelSetup
from simfoundry.models.tasks.masks import bounding_boxes
from simfoundry.models.tasks.meshes import parse_glb
from simfoundry.models.tasks.poses import Z_UP
from simfoundry.models.wire import Bundle, BundleFile, BundleImage
from simfoundry.spec.models.model_sources import ModelSource
from tests.models.test_tasks import serving
from tests.models.truth import splat_ply

__all__ = ["SOLVED", "Model", "Result", "StandIns", "configured", "serving"]

IDENTITY = {"name": "stand-in", "version": "1", "licence": "Apache-2.0 (no foundation model)", "commercial": True}

Labels = Any


@dataclass
class StandIns:
    """Answers about one picture.

    Attributes:
        labels: Number of the object at each pixel, shape (h, w), as a person or a renderer annotated it.
        names: Phrases of the objects, by number.
        moving: Numbers of the objects with parts that move.
        glb: A mesh for each object that has one, by number; others get their extruded silhouette.
        asked: The tasks that were asked for, in order.
        spoil: Changes the answer for a task, for tests of faults.
        commercial: What the server states about commercial use.
        trained: The images from which the last splat was made.
        masses: Masses of objects [kg] that are stated, by number.
        measured: Depth [m] of the picture, shape (h, w), which the task `depth` is answered with.
    """

    labels: Labels
    names: Mapping[int, str]
    moving: tuple[int, ...] = ()
    glb: Mapping[int, bytes] = field(default_factory=dict)
    asked: list[str] = field(default_factory=list)
    spoil: Mapping[str, Callable[[Result], None]] = field(default_factory=dict)
    commercial: bool = True
    measured: Any = None
    trained: list[Any] = field(default_factory=list)
    masses: Mapping[int, float] = field(default_factory=dict)

    def model(self) -> Model:
        """Return a server of all tasks."""
        solvers = {name: getattr(self, name) for name in (*SOLVED, "depth")}
        identity = {**IDENTITY, "commercial": self.commercial}
        return Model(identity, {name: self._noted(name, solve) for name, solve in solvers.items()})

    def _noted(self, name: str, solve: Callable[[Bundle], Result]) -> Callable[[Bundle], Result]:
        def noted(request: Bundle) -> Result:
            self.asked.append(name)
            result = solve(request)
            if name in self.spoil:
                self.spoil[name](result)
            return result

        return noted

    def read_scene(self, request: Bundle) -> Result:
        """List what is annotated."""
        numbers = list(self.names)
        boxes = bounding_boxes(np.array([self.labels == k for k in numbers]))
        objects = [
            {"phrase": self.names[k], "category": self.names[k].split()[-1], "box": box.tolist(),
             "is_articulated": k in self.moving, "mass": self.masses.get(k)}
            for k, box in zip(numbers, boxes, strict=True)
        ]  # fmt: skip
        return Result(values={"objects": objects, "support": "table"})

    def depth(self, request: Bundle) -> Result:
        """Return the depth that a sensor measured."""
        return Result({"depth": np.nan_to_num(np.asarray(self.measured, np.float32))})

    def segment(self, request: Bundle) -> Result:
        """Return the annotated masks with the asked phrases, or those that fit the asked boxes best."""
        asked = request.head["parameters"]
        by_name = {name: k for k, name in self.names.items()}
        found = [(k, by_name[p]) for k, p in enumerate(asked.get("phrases", [])) if p in by_name]
        for k, (left, top, right, bottom) in enumerate(asked.get("boxes", [])):
            inside = self.labels[int(top) : int(bottom), int(left) : int(right)]
            counts = np.bincount(inside[inside > 0].ravel(), minlength=1)
            found += [(k, int(counts.argmax()))] if counts.sum() else []
        masks = np.array([self.labels == number for _, number in found], bool).reshape(-1, *self.labels.shape)
        scores, prompts = np.full(len(found), 0.9, np.float32), np.array([k for k, _ in found], np.int32)
        return Result({"masks": masks, "boxes": bounding_boxes(masks), "scores": scores, "prompts": prompts})

    def complete_depth(self, request: Bundle) -> Result:
        """Continue the surfaces around holes."""
        image, depth, mask = (request.members[name] for name in ("image", "depth", "mask"))
        assert isinstance(image, BundleImage) and isinstance(depth, np.ndarray) and isinstance(mask, np.ndarray)
        return Result({"depth": OfflineDepth().complete_depth(image.pixels, depth, mask).depth})

    def inpaint(self, request: Bundle) -> Result:
        """Fill a hole from its rim."""
        image, mask = request.members["image"], request.members["mask"]
        assert isinstance(image, BundleImage) and isinstance(mask, np.ndarray)
        return Result({"image": BundleImage(OfflineImages().inpaint(image.pixels, mask).image)})

    def mesh(self, request: Bundle) -> Result:
        """Return the given mesh of the object with the most similar silhouette, or its silhouette, extruded."""
        image: Any = request.members["image"]
        mask = image.pixels[..., 3] > 0
        known = {k: abs(int((self.labels == k).sum()) - int(mask.sum())) for k in self.glb}
        nearest = min(known, key=lambda k: known[k], default=None)
        found = extruded(mask) if nearest is None else self.glb[nearest]
        return Result({"mesh": BundleFile("glb", found)}, {"mesh": {"frame": MESH}})

    def pose(self, request: Bundle) -> Result:
        """Return the poses at which the mesh stands on the plane of the table, the one nearest to the depth first."""
        glb, depth, K, mask = (request.members[name] for name in ("mesh", "depth", "K", "mask"))
        assert isinstance(glb, BundleFile)
        poses, errors = standing_poses(glb.data, np.asarray(depth), np.asarray(K), np.asarray(mask))
        order = np.argsort(errors)
        return Result({"object_to_camera": poses[order], "scores": -errors[order]})

    def parts(self, request: Bundle) -> Result:
        """Divide a mesh at three quarters of its height: a lid, and the rest."""
        vertices, faces = np.asarray(request.members["vertices"]), np.asarray(request.members["faces"])
        height = vertices[faces][..., 2].mean(axis=1)
        low, high = vertices[:, 2].min(), vertices[:, 2].max()
        return Result({"labels": (height > low + 0.75 * (high - low)).astype(np.int32)})

    def articulate(self, request: Bundle) -> Result:
        """Hinge the highest part at its back."""
        vertices, faces, labels = (np.asarray(request.members[name]) for name in ("vertices", "faces", "labels"))
        heights = {int(k): float(vertices[faces[labels == k]][..., 2].mean()) for k in np.unique(labels) if k >= 0}
        lid = max(heights, key=lambda k: heights[k])
        corners = vertices[faces[labels == lid]].reshape(-1, 3)
        origin = [float(corners[:, 0].min()), float(corners[:, 1].mean()), float(corners[:, 2].min())]
        joint = {"part": lid, "type": "revolute", "axis": [0, -1, 0], "origin": origin, "lower": 0, "upper": 1.2}
        return Result(values={"joints": [{**joint, "name": "lid"}]})

    def splat(self, request: Bundle) -> Result:
        """Make a small, opaque Gaussian of each point to start from, in the color that the first image has there."""
        images, K, poses, points = (request.members[name] for name in ("images", "K", "world_to_camera", "points"))
        assert isinstance(images, tuple)
        seen = np.asarray(points) @ np.asarray(poses)[0, :3, :3].T + np.asarray(poses)[0, :3, 3]
        pixels = np.rint((seen @ np.asarray(K)[0].T)[:, :2] / seen[:, 2:]).astype(int)
        self.trained[:] = [image.pixels for image in images]
        picture = images[0].pixels
        columns, rows = np.clip(pixels.T, 0, [[picture.shape[1] - 1], [picture.shape[0] - 1]])
        return Result({"splat": BundleFile("ply", splat_ply(np.asarray(points), picture[rows, columns] / 255))})


def extruded(mask: Any) -> bytes:
    """Return a silhouette as GLB, one unit high and half as deep as it is wide."""
    import cv2
    import shapely
    import trimesh

    contours, _ = cv2.findContours(mask.astype(np.uint8), cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_SIMPLE)
    outline = max(contours, key=cv2.contourArea)[:, 0] * [1, -1] / mask.shape[0]
    polygon = shapely.Polygon(outline).simplify(0.01).buffer(0)
    whole = max(getattr(polygon, "geoms", [polygon]), key=lambda each: each.area)
    solid = trimesh.creation.extrude_polygon(whole, float(np.ptp(outline[:, 0])) / 2)
    return bytes(solid.export(file_type="glb"))


def standing_poses(glb: bytes, depth: Any, K: Any, mask: Any) -> tuple[Any, Any]:
    """Return poses of a GLB file in the camera, shape (n, 4, 4), and their distances from the depth of the mask [m].

    The mesh is upright on the plane through most of the depth outside of the mask, turned in steps of 15 degrees.
    """
    from scipy.spatial import cKDTree

    v, u = np.nonzero(depth > 0)
    cloud = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones(len(u))], axis=1) * depth[v, u, None]
    own = cloud[mask[v, u]]
    normal, offset = _plane(cloud[~mask[v, u]])
    surface = np.concatenate([part.vertices[part.faces].mean(axis=1) for part in parse_glb(glb)])
    low, high = surface.min(axis=0), surface.max(axis=0)
    base = np.array([*(low + high)[:2] / 2, low[2]])
    side = np.cross(normal, [0.0, 0, 1])
    side /= np.linalg.norm(side)
    frame = np.column_stack([side, np.cross(normal, side), normal])
    poses, errors = [], []
    for angle in np.radians(np.arange(0, 360, 15)):
        turn = np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
        R = frame @ turn
        placed = (surface - base) @ R.T
        along = placed @ own.mean(axis=0)
        shift = own.mean(axis=0) - placed[along <= np.median(along)].mean(axis=0)
        shift += normal * (offset - normal @ shift)
        errors.append(float(np.mean(cKDTree(placed + shift).query(own[::20])[0])))
        X = np.eye(4)
        X[:3, :3], X[:3, 3] = R, shift - R @ base
        poses.append(X @ Z_UP)
    return np.array(poses), np.array(errors)


def _plane(points: Any) -> tuple[Any, float]:
    """Return the unit normal toward the camera and the offset of the plane with most points, within 1 cm."""
    rng = np.random.default_rng(0)
    most, best, offset = 0, np.array([0.0, 0.0, -1.0]), 0.0
    sample = points[rng.choice(len(points), min(len(points), 4000), replace=False)]
    for _ in range(200):
        a, b, c = sample[rng.choice(len(sample), 3, replace=False)]
        normal = np.cross(b - a, c - a)
        length = np.linalg.norm(normal)
        if length > 1e-9:
            normal = normal / length * (-1 if normal[2] > 0 else 1)
            count = int((np.abs((sample - a) @ normal) < 0.01).sum())
            if count > most:
                most, best, offset = count, normal, float(normal @ a)
    return best, offset


SOLVED = ("read_scene", "segment", "complete_depth", "inpaint", "mesh", "pose", "parts", "articulate", "splat")


@contextmanager
def configured(stand_ins: StandIns, root: Path, *tasks: str, record: str | None = None) -> Iterator[ModelSetup]:
    """Serve stand-ins, and yield a setup in which the given tasks, or all, are configured to use them."""
    with serving(stand_ins.model()) as url:
        source = ModelSource(url=url, record=record, timeout_s=120)
        yield ModelSetup(root, dict.fromkeys(tasks or SOLVED, (source, "a test")))
