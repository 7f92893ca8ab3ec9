"""An object whose solid falls over gets its next best one, or is held in place and reported."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from simfoundry.capture.description import describe
from simfoundry.capture.description.kinds import CAN, SUPPORT, kind_of
from simfoundry.capture.findings import HELD
from simfoundry.capture.frame import Segmentation
from simfoundry.capture.reconstruct import Reconstruction
from simfoundry.capture.segment.find_support import find_support
from simfoundry.capture.settling.standing import StandingScene, settle_objects
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.texture import textured_mesh
from simfoundry.geometry.frames import Pose, frozen_array, quat_from_rpy
from simfoundry.geometry.shapes import Box, Cylinder, hull_mesh, revolved
from simfoundry.runtime.files import write_file
from simfoundry.scene.lower import lower_file
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.reuse import FramedPose
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec
from simfoundry.spec.models.shapes import BoxShape
from simfoundry.spec.yaml.write import to_yaml
from simfoundry.worlds import open_world
from simfoundry.worlds.rest import simulate
from tests.capture import pictures

SETUP = pictures.Setup((pictures.Box((0.05, 0.02, 0.06), (0.10, 0.08, 0.12)),))
ALMOST_LYING = quat_from_rpy(-math.pi / 2, math.radians(89.99), 0.9)  # as a pose is rounded to 0.01 deg
BESIDE = Pose.of((2.0, 0.0, 0.0))  # where there is no table
CORNERS = [(0, 0, 0), (0.01, 0, 0), (0, 0.01, 0), (0.12, 0.1, 0.15), (0.12, -0.1, 0.15), (-0.02, 0, 0.15)]
"""A solid on a base of 1 cm whose center of mass is beside it [m]."""

PLATE = [
    *((0, 0.005), (0.0522, 0.005), (0.0536, 0.008), (0.0609, 0.0116), (0.0631, 0.0152), (0.0734, 0.0205)),
    *((0.0793, 0.025), (0.0833, 0.025), (0.0774, 0.0205), (0.0671, 0.0152), (0.0649, 0.0116), (0.0576, 0.008)),
    *((0.0562, 0.0062), (0.0562, 0), (0, 0)),
]
"""The profile of a plate whose convex parts hold a disk in their middle [m]."""


def tower(X_WO: Pose) -> FittedShape:
    mesh = hull_mesh(np.array(CORNERS))
    assert mesh is not None
    return FittedShape(mesh, X_WO, 0.002, 0.6, False)


def settled(folder: Path, X_WO: Pose, alternatives: tuple[FittedShape, ...]) -> StandingScene:
    return settled_scene(folder, {"tower": replace(tower(X_WO), alternatives=alternatives)})


def settled_scene(folder: Path, shapes: dict[str, FittedShape]) -> StandingScene:
    frame, labels = pictures.photograph(SETUP)
    support = find_support(frame)
    priors = (SUPPORT, *(kind_of(shape).material for shape in shapes.values()))
    objects = {name: describe.object_spec("tower", name, shape, 1) for name, shape in shapes.items()}
    spec = SceneSpec(
        simfoundry="scene/1",
        name="tower",
        materials={prior.name: prior.material for prior in priors},
        objects={"table": describe.support_spec("tower", support, None).model_copy(update={"visual": None}), **objects},
        relations=tuple(f"OnTop({name}, table)" for name in shapes),
    )
    files: dict[str, bytes] = {}
    for name, shape in shapes.items():
        files |= describe.mesh_files(name, textured_mesh(shape, frame, support, labels == 1))
    built = Reconstruction(spec, files, support, Segmentation(labels, {1: 0}), dict.fromkeys(shapes, 1), shapes, ())
    return settle_objects(built, frame, folder / "tower.scene.yaml", None, lambda stage, share: None)


def test_the_next_best_solid_replaces_one_that_falls_over(tmp_path: Path) -> None:
    box = FittedShape(Box(frozen_array([0.1, 0.08, 0.12])), Pose.of((0.0, 0.0, 0.06)), 0.003, 0.5, False)
    standing = settled(tmp_path, Pose.of(), (box,))
    built = standing.reconstruction
    assert built.findings == () and standing.settled.passed
    assert isinstance(built.shapes["tower"].geometry, Box) and not built.spec.objects["tower"].fixed
    assert built.spec.relations == ("OnTop(tower, table)",)


def test_what_finds_no_rest_is_held_in_place_and_reported(tmp_path: Path) -> None:
    standing = settled(tmp_path, BESIDE, (tower(BESIDE),))
    built = standing.reconstruction
    (finding,) = built.findings
    assert finding.code == HELD and finding.objects == ("tower",)
    held = built.spec.objects["tower"]
    assert held.fixed and held.origin is not None and "held in place" in (held.origin.note or "")
    (item,) = (o for o in standing.scene.objects if o.name == "tower")
    assert item.fixed and np.allclose(item.X_WO.p, BESIDE.p, atol=1e-4)


@pytest.mark.slow  # 2.5 s: several settlings
@pytest.mark.parametrize("has_another", [True, False])
def test_one_of_two_solids_that_are_wedged_gets_another_or_is_held(tmp_path: Path, has_another: bool) -> None:
    plate = FittedShape(revolved(PLATE, 32), Pose.of((0, 0, 0)), 0.002, 0.95, True, np.array(PLATE))
    disk = FittedShape(Cylinder(0.0844, 0.0195), Pose.of((0.005, 0.0068, 0.0096)), 0.002, 0.8, False)
    thin = FittedShape(Box(frozen_array([0.04, 0.04, 0.03])), Pose.of((0, 0, 0.015)), 0.003, 0.5, False)
    shapes = {"plate": plate, "disk": replace(disk, alternatives=(thin,) * has_another)}
    standing = settled_scene(tmp_path, shapes)
    built = standing.reconstruction
    assert built.shapes["plate"] is plate
    if has_another:
        assert isinstance(built.shapes["disk"].geometry, Box) and not built.findings and standing.settled.at_rest
    else:
        assert {f.code for f in built.findings} == {HELD} and built.spec.objects["disk"].fixed
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    with open_world(lower_file(tmp_path / "tower.scene.yaml"), "pybullet") as world:
        assert all(motion.stays for motion in simulate(world, 2.0))


@pytest.mark.parametrize("resists", [True, False])
def test_a_lying_can_stays_in_pybullet_because_it_resists_rolling(tmp_path: Path, resists: bool) -> None:
    pytest.importorskip("pybullet", reason="PyBullet is not installed")
    material = CAN.material if resists else Material(density=CAN.density, friction=CAN.friction)
    can = FittedShape(Cylinder(0.022, 0.085), Pose.of((0, 0, 0.0218), ALMOST_LYING), 0.001, 0.8, False)
    top = ObjectSpec(fixed=True, shape=BoxShape(box=(1.0, 1.0, 0.04)), pose=FramedPose(xyz=(0.0, 0.0, -0.02)))
    item = describe.object_spec("can", "can", can).model_copy(update={"material": "can", "visual": None})
    spec = SceneSpec(simfoundry="scene/1", name="can", materials={"can": material}, objects={"table": top, "can": item})
    write_file(tmp_path / "can.scene.yaml", to_yaml(spec).encode())
    with open_world(lower_file(tmp_path / "can.scene.yaml"), "pybullet") as world:
        (motion,) = simulate(world, 2.0)
    assert motion.stays == resists
