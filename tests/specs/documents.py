"""The documents in ``specs/`` that people copy, and where the things of a task may start."""

from __future__ import annotations

import math
from functools import cache
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from simfoundry.geometry.frames import Array, Pose, quat_from_rpy
from simfoundry.geometry.shapes import tessellate
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.task import ResetRegion, TaskSpec
from tests.conftest import REPOSITORY

if TYPE_CHECKING:
    from shapely.geometry import Polygon

SPECS = REPOSITORY / "specs"
ASSETS = sorted((SPECS / "assets").glob("*.asset.yaml"))
GALLERY = SPECS / "assets" / "gallery.scene.yaml"
SCENES = [*sorted((SPECS / "scenes").glob("*.scene.yaml")), GALLERY]
TASKS = sorted((SPECS / "tasks").glob("*.task.yaml"))
TURN_STEP_DEG = 10.0


def name_of(path: Path) -> str:
    """What a document is called by its file."""
    return path.name.split(".")[0]


@cache
def lowered(path: Path) -> Scene:
    """A scene document as the simulators get it."""
    return lower_file(path)


@cache
def task_at(path: Path) -> tuple[Loaded, TaskSpec]:
    """A task document with its findings."""
    loaded = load(path)
    assert isinstance(loaded.spec, TaskSpec), loaded.findings
    return loaded, loaded.spec


def scene_of_task(path: Path) -> Scene:
    """The lowered scene of a task."""
    loaded, task = task_at(path)
    return lowered(loaded.file(task.scene))


def footprint(item: SceneObject, X_WO: Pose) -> Array:
    """Points of an object seen from above [m, world], shape (n, 2); what it covers is their convex hull."""
    links = link_poses(item)
    corners = [
        X_WO.apply(links[link.name].apply(c.X_LG.apply(tessellate(c.geometry, 24).vertices)))
        for link in item.links
        for c in link.colliders
    ]
    return np.concatenate(corners)[:, :2]


def swept(item: SceneObject, region: ResetRegion | None) -> Polygon:
    """The ground that an object may cover, seen from above: a convex outline, its turns taken in steps."""
    from shapely.geometry import MultiPoint

    if region is None:
        return MultiPoint(footprint(item, item.X_WO)).convex_hull
    low, high = region.yaw_deg
    turns = np.linspace(low, high, 1 + math.ceil((high - low) / TURN_STEP_DEG))
    points = [
        footprint(item, Pose.of([x, y, 0.0], (Pose.of(q=quat_from_rpy(0, 0, math.radians(turn))) @ item.X_WO).q))
        for x, y, turn in product(region.x, region.y, turns)
    ]
    return MultiPoint(np.concatenate(points)).convex_hull
