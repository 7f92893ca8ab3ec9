"""The compiled worlds hold what the lowered scene says, and their objects stay where they are."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from simfoundry.backends import compile_scene
from simfoundry.geometry.frames import Pose
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Link, Scene
from simfoundry.verify.readback import LinkReadback, pose_of
from simfoundry.worlds import open_world
from simfoundry.worlds.rest import ObjectMotion, simulate
from tests.readback import read_stage, read_world

ENGINES = {"MuJoCo": "mujoco", "PyBullet": "pybullet"}
"""The simulators, as people write them and as they are opened."""


@dataclass(frozen=True)
class Rest:
    """What two seconds of dynamics did to the objects: the farthest displacement [m] and rotation [deg]."""

    moved: float
    turned_deg: float
    restless: tuple[str, ...]


def stale_files(scene: Scene, build: Path) -> list[str]:
    """Files of a build folder that are not what ``scene`` compiles to, so that worlds of the scene speak for them."""
    stale = []
    for target in ("mjcf", "urdf", "pybullet", "usd"):
        for path, data in compile_scene(scene, target).files.items():
            file = build / target / path
            if not file.is_file() or file.read_bytes() != data:
                stale.append(f"{target}/{path}")
    return stale


def read_back_errors(scene: Scene, build: Path) -> dict[str, tuple[float, str]]:
    """Per world, the largest relative error of any mass property or pose, and the link that has it."""
    from pxr import Usd

    errors = {}
    for engine, key in ENGINES.items():
        with open_world(scene, key) as world:
            errors[engine] = _largest(scene, read_world(world).links, welded_roots_have_mass=engine != "PyBullet")
    stage = Usd.Stage.Open(str(build / "usd" / "scene.usda"))
    errors["USD"] = _largest(scene, read_stage(stage).links, welded_roots_have_mass=True)
    return errors


def rest(scene: Scene, engine: str, max_moved: float, max_turned_deg: float) -> Rest:
    """Two seconds of a scene in an engine; an object that moves or turns more than it may is restless."""
    with open_world(scene, ENGINES[engine]) as world:
        motions = simulate(world, 2.0)
    restless = [m for m in motions if not (m.moved <= max_moved and m.turned_deg <= max_turned_deg)]
    return Rest(
        moved=max((m.moved for m in motions), default=0.0),
        turned_deg=max((m.turned_deg for m in motions), default=0.0),
        restless=tuple(map(_sentence, restless)),
    )


def _sentence(motion: ObjectMotion) -> str:
    return f"{motion.name} moved {motion.moved * 100:.1f} cm, turned {motion.turned_deg:.0f} deg"


def _largest(scene: Scene, facts: Mapping[str, LinkReadback], welded_roots_have_mass: bool) -> tuple[float, str]:
    largest = (0.0, "")
    for name, link, X_WL, welded in _links(scene):
        fact = facts.get(name)
        if fact is None:
            return np.inf, f"{name} is missing"
        for quantity, error in _errors(link, X_WL, fact, welded and not welded_roots_have_mass):
            if not error <= largest[0]:
                largest = (error, f"{quantity} of {name}")
    return largest


def _links(scene: Scene) -> Iterator[tuple[str, Link, Pose, bool]]:
    for item in scene.objects:
        X_OL = link_poses(item)
        for link in item.links:
            yield item.qualified(link.name), link, item.X_WO @ X_OL[link.name], item.fixed and link is item.root


def _errors(link: Link, X_WL: Pose, fact: LinkReadback, massless: bool) -> Iterator[tuple[str, float]]:
    """Relative errors. A length is measured against that of the vector or, if larger, the radius of gyration."""
    held = pose_of(fact.pose or ())
    gyration = float(np.sqrt(np.trace(link.inertia) / link.mass))
    yield "position", float(np.linalg.norm(held.p - X_WL.p)) / max(float(np.linalg.norm(X_WL.p)), gyration)
    yield "rotation", held.angle_to(X_WL)
    if massless:
        return
    if fact.mass is None or fact.com is None or fact.inertia is None:
        yield "missing mass", np.inf
        return
    yield "mass", abs(fact.mass - link.mass) / link.mass
    yield "com", float(np.linalg.norm(np.array(fact.com) - link.com)) / max(float(np.linalg.norm(link.com)), gyration)
    yield (
        "inertia",
        float(np.linalg.norm(np.array(fact.inertia).reshape(3, 3) - link.inertia) / np.linalg.norm(link.inertia)),
    )
