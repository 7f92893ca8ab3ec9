"""The USD backend: valid stages that say what the scene says."""

from __future__ import annotations

import dataclasses
import math
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from simfoundry.backends.features import Fidelity
from simfoundry.backends.names import InvalidSceneError
from simfoundry.backends.usd import compile_usd
from simfoundry.backends.usd.bodies import joint_frame
from simfoundry.geometry.frames import Array, Pose, frozen_array
from simfoundry.geometry.shapes import Box, Mesh, Sphere
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import (
    Camera,
    JointType,
    LightType,
    Scene,
    SceneObject,
    Visual,
    pair_friction,
)
from simfoundry.scene.state import SceneState
from simfoundry.verify.readback import pose_of
from tests.backends.stage_kinematics import poses_by_joints, read_back_state
from tests.mechanisms import gripper, mechanisms, pot
from tests.readback import assert_joints, assert_links, read_stage
from tests.scenes import all_scenes, cabinet, full_scene, pose, rgba, scene_of, solid, textured_object, wedge_mesh

if TYPE_CHECKING:
    from pxr import Usd

SCENES = all_scenes() | {"mechanisms": mechanisms()}
ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture(scope="module")
def folders(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    """Each scene compiled and written once."""
    base = tmp_path_factory.mktemp("usd")
    for name, scene in SCENES.items():
        compile_usd(scene).write(base / name)
    return {name: base / name for name in SCENES}


@pytest.fixture(params=sorted(SCENES))
def compiled(request: pytest.FixtureRequest, folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    name: str = request.param
    return SCENES[name], open_stage(folders[name])


@pytest.fixture
def full(folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    return SCENES["full"], open_stage(folders["full"])


@pytest.fixture
def mechanical(folders: dict[str, Path]) -> tuple[Scene, Usd.Stage]:
    return SCENES["mechanisms"], open_stage(folders["mechanisms"])


def open_stage(folder: Path) -> Usd.Stage:
    from pxr import Usd

    return Usd.Stage.Open(str(folder / "scene.usda"))


def written(scene: Scene, folder: Path) -> Usd.Stage:
    compile_usd(scene).write(folder)
    return open_stage(folder)


def links_of(scene: Scene) -> Iterator[tuple[str, SceneObject, int]]:
    for item in scene.objects:
        for k, link in enumerate(item.links):
            yield item.qualified(link.name), item, k


def validation_errors(stage: Usd.Stage) -> list[str]:
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    names = {validator.GetMetadata().name for validator in validators}
    assert {"usdPhysicsValidators:ArticulationChecker", "usdShadeValidators:ShaderSdrCompliance"} <= names
    return [str(e.GetErrorAsString()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]


def test_every_validator_of_usd_accepts_the_stage(compiled: tuple[Scene, Usd.Stage]) -> None:
    assert validation_errors(compiled[1]) == []


def test_validation_would_see_a_wrong_stage(folders: dict[str, Path], tmp_path: Path) -> None:
    from pxr import UsdPhysics

    stage = open_stage(shutil.copytree(folders["fan"], tmp_path / "fan"))
    UsdPhysics.ArticulationRootAPI.Apply(stage.GetPrimAtPath("/World/Objects/fan"))
    assert any("NestedArticulation" in error for error in validation_errors(stage))


def test_links_and_joints_read_back(compiled: tuple[Scene, Usd.Stage]) -> None:
    scene, stage = compiled
    found = read_stage(stage)
    assert list(found.links) == [name for name, _, _ in links_of(scene)]
    assert_links(scene, found, 1e-6, 1e-10)
    assert_joints(scene, found, 1e-6)
    for name, item, k in links_of(scene):
        frictions = [c.friction for c in found.links[name].colliders or ()]
        assert frictions == pytest.approx([c.friction for c in item.links[k].colliders], rel=1e-6)


def test_state_and_joint_frames_agree_with_kinematics(compiled: tuple[Scene, Usd.Stage]) -> None:
    scene, stage = compiled
    state, initial, by_joints = read_back_state(stage), SceneState.initial(scene), poses_by_joints(stage)
    assert dict(state.joints) == pytest.approx(dict(initial.joints), rel=1e-6)
    assert set(state.motions) == set(initial.motions)
    for name, motion in initial.motions.items():
        np.testing.assert_allclose(state.motions[name].matrix, motion.matrix, rtol=0, atol=2e-6)
    assert list(state.poses) == list(initial.poses)
    for name, item, k in links_of(scene):
        carried = {j.child for j in item.joints if j.type is not JointType.FREE} | (
            {item.root.name} if item.fixed else set()
        )
        if not item.joints or item.links[k].name not in carried:
            continue
        X_WL = item.X_WO @ link_poses(item)[item.links[k].name]
        np.testing.assert_allclose(by_joints.pop(name).matrix, X_WL.matrix, rtol=0, atol=2e-6)
    assert not by_joints


@pytest.mark.parametrize("axis", [[1, 0, 0], [0, -1, 0], [0, 0, -1], [0.6, -0.64, 0.48], [-0.1, -0.2, -0.97]])
def test_joint_frame_turns_a_coordinate_axis_onto_the_axis(axis: list[float]) -> None:
    unit = frozen_array(np.array(axis) / np.linalg.norm(axis))
    token, X_CJ = joint_frame(unit)
    np.testing.assert_allclose(X_CJ.apply(np.eye(3)["XYZ".index(token)]), unit, atol=1e-15)


def test_stage_metadata_gravity_and_relations(compiled: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom, UsdPhysics

    scene, stage = compiled
    assert stage.GetDefaultPrim().GetPath() == "/World"
    assert UsdGeom.GetStageUpAxis(stage) == "Z"
    assert UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert UsdPhysics.GetStageKilogramsPerUnit(stage) == 1.0
    assert not stage.HasAuthoredTimeCodeRange()
    physics = UsdPhysics.Scene(stage.GetPrimAtPath("/World/Physics"))
    direction = np.array(physics.GetGravityDirectionAttr().Get(), dtype=np.float64)
    np.testing.assert_allclose(direction * physics.GetGravityMagnitudeAttr().Get(), scene.gravity, atol=1e-6)
    data = stage.GetDefaultPrim().GetCustomDataByKey("simfoundry")
    assert (data["name"], list(data["relations"])) == (scene.name, [str(r) for r in scene.relations])


def test_no_gravity_is_no_gravity(tmp_path: Path) -> None:
    stage = written(
        scene_of(solid("ball", Sphere(0.03), pose(0, 0, 1)), gravity=frozen_array([0, 0, 0])), tmp_path / "x"
    )
    assert stage.GetPrimAtPath("/World/Physics").GetAttribute("physics:gravityMagnitude").Get() == 0.0


def test_bodies_articulations_and_static_objects(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdPhysics

    scene, stage = full
    bodies = {str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)}
    moving = [item for item in scene.objects if not item.fixed or item.joints]
    assert bodies == {f"/World/Objects/{item.name}/{link.name}" for item in moving for link in item.links}
    assert bodies == {str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.MassAPI)}
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == ["/World/Objects/cabinet", "/World/Objects/fan/base"]
    anchor = UsdPhysics.Joint(stage.GetPrimAtPath("/World/Objects/cabinet/Joints/Anchor"))
    assert anchor.GetPrim().IsA(UsdPhysics.FixedJoint)
    assert [str(p) for p in anchor.GetBody1Rel().GetTargets()] == ["/World/Objects/cabinet/carcass"]
    assert not stage.GetPrimAtPath("/World/Objects/fan/Joints/Anchor")


def test_linked_links_do_not_collide_with_each_other(full: tuple[Scene, Usd.Stage]) -> None:
    assert filtered_pairs(full[1]) == {
        frozenset(pair)
        for pair in (
            ("cabinet/carcass", "cabinet/drawer"), ("cabinet/carcass", "cabinet/door"), ("fan/base", "fan/rotor"),
            ("cabinet/carcass", "cabinet/handle"), ("cabinet/door", "cabinet/handle"),
        )
    }  # fmt: skip
    # The drawer can meet the door and its handle; the fan has no links that are not linked.
    for path, touching in (("cabinet", True), ("fan/base", False)):
        prim = full[1].GetPrimAtPath(f"/World/Objects/{path}")
        assert prim.GetAttribute("newton:selfCollisionEnabled").Get() is touching
        assert prim.GetAttribute("physxArticulation:enabledSelfCollisions").Get() is touching


def filtered_pairs(stage: Usd.Stage) -> set[frozenset[str]]:
    from pxr import UsdPhysics

    found = set()
    for prim in stage.Traverse():
        if prim.HasAPI(UsdPhysics.FilteredPairsAPI):
            targets = UsdPhysics.FilteredPairsAPI(prim).GetFilteredPairsRel().GetTargets()
            assert all(stage.GetPrimAtPath(target) for target in targets)
            names = [str(path).removeprefix("/World/Objects/") for path in (prim.GetPath(), *targets)]
            found |= {frozenset((names[0], name)) for name in names[1:]}
    return found


def test_scene_pairs_name_bodies_or_the_colliders_of_what_has_none(mechanical: tuple[Scene, Usd.Stage]) -> None:
    pairs = filtered_pairs(mechanical[1])
    assert frozenset(("ball/body", "gripper/left")) in pairs
    assert frozenset(("pot/lid", "table/body/Colliders/shape")) in pairs
    assert frozenset(("pot/grip", "pot/lid")) in pairs
    assert frozenset(("pot/body", "pot/lid")) not in pairs  # a free joint connects nothing


def test_ball_and_free_joints(mechanical: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdPhysics

    _, stage = mechanical
    swing = stage.GetPrimAtPath("/World/Objects/pendulum/Joints/swing")
    assert swing.IsA(UsdPhysics.SphericalJoint)
    assert swing.GetAttribute("newton:damping").Get() == pytest.approx(0.01 * np.pi / 180)
    assert swing.GetAttribute("newton:armature").Get() == pytest.approx(0.001)
    assert not stage.GetPrimAtPath("/World/Objects/pot/Joints/rests")
    lid = stage.GetPrimAtPath("/World/Objects/pot/lid")
    assert lid.HasAPI(UsdPhysics.RigidBodyAPI)
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == [f"/World/Objects/{path}" for path in ("gripper", "pendulum/post", "pot/body", "pot/lid")]


def test_a_fixed_object_with_a_free_part_is_valid(tmp_path: Path) -> None:
    """Two articulations in one object: the fixed one has its root at its anchor, or one would lie in the other."""
    from pxr import UsdPhysics

    item = pot(fixed=True)
    hinge = dataclasses.replace(item.joints[0], type=JointType.CONTINUOUS)
    stage = written(scene_of(dataclasses.replace(item, joints=(hinge, *item.joints[1:]))), tmp_path / "x")
    assert validation_errors(stage) == []
    roots = [str(p.GetPath()) for p in stage.Traverse() if p.HasAPI(UsdPhysics.ArticulationRootAPI)]
    assert roots == ["/World/Objects/pot/lid", "/World/Objects/pot/Joints/Anchor"]
    still = written(scene_of(item), tmp_path / "y")  # its handle is welded: only the lid moves
    assert validation_errors(still) == []
    bodies = [p.GetName() for p in still.Traverse() if p.HasAPI(UsdPhysics.RigidBodyAPI)]
    assert bodies == ["lid", "flap", "knob"]


def test_mimics_follow_in_physx_and_in_newton(mechanical: tuple[Scene, Usd.Stage]) -> None:
    follower = mechanical[1].GetPrimAtPath("/World/Objects/gripper/Joints/right_slide")
    assert {"PhysxMimicJointAPI:rotX", "NewtonMimicAPI"} <= set(follower.GetPrimTypeInfo().GetAppliedAPISchemas())
    for name in ("newton:mimicJoint", "physxMimicJoint:rotX:referenceJoint"):
        targets = [str(path) for path in follower.GetRelationship(name).GetTargets()]
        assert targets == ["/World/Objects/gripper/Joints/left_slide"]
    values = {
        name: follower.GetAttribute(name).Get()
        for name in (
            "newton:mimicCoef0",
            "newton:mimicCoef1",
            "physxMimicJoint:rotX:gearing",
            "physxMimicJoint:rotX:offset",
        )
    }
    assert list(values.values()) == pytest.approx([0.02, -0.5, 0.5, -0.02])


def test_a_hinge_that_follows_counts_in_degrees(tmp_path: Path) -> None:
    item = gripper()
    turning = tuple(dataclasses.replace(j, type=JointType.REVOLUTE) for j in item.joints)
    stage = written(scene_of(dataclasses.replace(item, joints=turning)), tmp_path / "x")
    follower = stage.GetPrimAtPath("/World/Objects/gripper/Joints/right_slide")
    assert follower.GetAttribute("newton:mimicCoef0").Get() == pytest.approx(np.degrees(0.02))
    assert follower.GetAttribute("newton:mimicCoef1").Get() == -0.5


def test_losses_of_mechanisms_are_stated() -> None:
    losses = {loss.path: loss for loss in compile_usd(mechanisms()).losses}
    assert set(losses) == {
        "friction", "torsional_friction", "rolling_friction", "gripper.left_slide.damping", "pendulum.swing.damping",
        "pot.swivel.damping",
    }  # fmt: skip
    assert losses["gripper.left_slide.damping"].fidelity is Fidelity.APPROXIMATED
    item = gripper()
    mixed = (dataclasses.replace(item.joints[0], type=JointType.REVOLUTE), item.joints[1])
    found = {loss.path for loss in compile_usd(scene_of(dataclasses.replace(item, joints=mixed))).losses}
    assert "gripper.right_slide.mimic" in found


def test_colliders_touch_and_visuals_do_not(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom, UsdPhysics

    scene, stage = full
    for _, item, k in links_of(scene):
        path = f"/World/Objects/{item.name}/{item.links[k].name}"
        for visual in item.links[k].visuals:
            prim = stage.GetPrimAtPath(f"{path}/Visuals/{visual.name}")
            assert not prim.HasAPI(UsdPhysics.CollisionAPI)
            assert UsdGeom.Imageable(prim).ComputePurpose() == "default"
        for collider in item.links[k].colliders:
            prim = stage.GetPrimAtPath(f"{path}/Colliders/{collider.name}")
            kind = "Cube" if type(collider.geometry).__name__ == "Box" else type(collider.geometry).__name__
            assert (prim.GetTypeName(), prim.HasAPI(UsdPhysics.CollisionAPI)) == (kind, True)
            assert UsdGeom.Imageable(prim).ComputePurpose() == "guide"
            approximation = UsdPhysics.MeshCollisionAPI(prim).GetApproximationAttr().Get()
            assert approximation == ("convexHull" if kind == "Mesh" else None)


def world_bounds(item: SceneObject, k: int) -> list[Array]:
    """Axis-aligned bounds of a link's meshes and boxes that collide, from the scene alone, shape (2, 3)."""
    X_WL = item.X_WO @ link_poses(item)[item.links[k].name]
    found = []
    for collider in item.links[k].colliders:
        geometry = collider.geometry
        if isinstance(geometry, Mesh):
            points = geometry.vertices
        elif isinstance(geometry, Box):
            signs = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T
            points = signs * geometry.size / 2
        else:
            continue
        corners = (X_WL @ collider.X_LG).apply(points)
        found.append(np.stack([corners.min(axis=0), corners.max(axis=0)]))
    return found


def test_geometry_is_where_the_scene_has_it(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom

    scene, stage = full
    cache = UsdGeom.XformCache()
    compared = 0
    for _, item, k in links_of(scene):
        link = item.links[k]
        wanted = world_bounds(item, k)
        prims = [
            stage.GetPrimAtPath(f"/World/Objects/{item.name}/{link.name}/Colliders/{c.name}") for c in link.colliders
        ]
        solids = [prim for prim in prims if prim.GetTypeName() in ("Mesh", "Cube")]
        for prim, bounds in zip(solids, wanted, strict=True):
            if prim.GetTypeName() == "Mesh":
                points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get(), dtype=np.float64)
            else:
                signs = np.array(np.meshgrid([-0.5, 0.5], [-0.5, 0.5], [-0.5, 0.5])).reshape(3, -1).T
                points = signs * UsdGeom.Cube(prim).GetSizeAttr().Get()
            matrix = np.array(cache.GetLocalToWorldTransform(prim))
            seen = points @ matrix[:3, :3] + matrix[3, :3]
            np.testing.assert_allclose(np.stack([seen.min(axis=0), seen.max(axis=0)]), bounds, atol=1e-7)
            compared += 1
    assert compared >= 10


def test_round_primitives_keep_their_sizes(full: tuple[Scene, Usd.Stage]) -> None:
    _, stage = full
    sizes = {}
    for name in ("ball", "can", "pill"):
        prim = stage.GetPrimAtPath(f"/World/Objects/{name}/body/Colliders/shape")
        sizes[name] = tuple(prim.GetAttribute(a).Get() for a in ("radius", "height", "axis") if prim.GetAttribute(a))
    assert sizes == {"ball": (0.03,), "can": (0.03, 0.11, "Z"), "pill": (0.02, 0.06, "Z")}


def test_every_boundable_states_its_extent(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import Usd, UsdGeom

    boundables = [UsdGeom.Boundable(p) for p in full[1].Traverse() if p.IsA(UsdGeom.Boundable)]
    assert len(boundables) > 20
    for boundable in boundables:
        computed = UsdGeom.Boundable.ComputeExtentFromPlugins(boundable, Usd.TimeCode.Default())
        assert boundable.GetExtentAttr().HasAuthoredValue() or boundable.GetPrim().GetTypeName() == "DomeLight"
        if computed is not None:
            np.testing.assert_allclose(boundable.GetExtentAttr().Get(), computed, atol=1e-7)


def test_mesh_faces_normals_and_texture_coordinates(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom

    mesh = UsdGeom.Mesh(full[1].GetPrimAtPath("/World/Objects/wedge/body/Visuals/skin"))
    source = wedge_mesh(0.10, 0.06, 0.05, textured=True)
    points = np.array(mesh.GetPointsAttr().Get(), dtype=np.float64)
    faces = np.array(mesh.GetFaceVertexIndicesAttr().Get()).reshape(-1, 3)
    np.testing.assert_array_equal(faces, source.faces)
    outward = points[faces].mean(axis=1) - points.mean(axis=0)
    normals = np.array(mesh.GetNormalsAttr().Get(), dtype=np.float64)
    assert mesh.GetNormalsInterpolation() == "uniform"
    assert (np.einsum("ij,ij->i", normals, outward) > 0).all()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0, atol=1e-6)
    uv = UsdGeom.PrimvarsAPI(mesh).GetPrimvar("st")
    assert (uv.GetInterpolation(), uv.GetTypeName().type.typeName) == ("vertex", "VtArray<GfVec2f>")
    assert source.uv is not None
    np.testing.assert_allclose(np.array(uv.Get()), source.uv, atol=1e-7)


def test_looks(full: tuple[Scene, Usd.Stage], folders: dict[str, Path]) -> None:
    from pxr import UsdShade

    scene, stage = full

    def shader(path: str) -> UsdShade.Shader:
        material, _ = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path)).ComputeBoundMaterial()
        return material.ComputeSurfaceSource()[0]

    knob = shader("/World/Objects/wedge/body/Visuals/knob")
    assert knob.GetIdAttr().Get() == "UsdPreviewSurface"
    assert knob.GetInput("opacity").Get() == pytest.approx(0.5)
    # sRGB 0.1, 0.2, 0.8 in linear light, from the standard's formula.
    np.testing.assert_allclose(knob.GetInput("diffuseColor").Get(), [0.010023, 0.033105, 0.603827], atol=1e-5)
    skin = shader("/World/Objects/wedge/body/Visuals/skin")
    image = UsdShade.Shader(skin.GetInput("diffuseColor").GetConnectedSource()[0].GetPrim())
    assert image.GetIdAttr().Get() == "UsdUVTexture"
    np.testing.assert_allclose(image.GetInput("scale").Get(), [0.787412, 0.787412, 1.0, 1.0], atol=1e-5)
    texture = Path(image.GetInput("file").Get().resolvedPath)
    assert texture.parent == folders["full"] / "assets"
    skin_mesh = scene.object("wedge").root.visuals[0].geometry
    assert isinstance(skin_mesh, Mesh) and texture.read_bytes() == skin_mesh.texture
    reader = UsdShade.Shader(image.GetInput("st").GetConnectedSource()[0].GetPrim())
    assert reader.GetInput("varname").Get() == "st"


def test_contact_materials_multiply_to_geometric_means(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdPhysics, UsdShade

    _, stage = full

    def material(path: str) -> Usd.Prim:
        binding = UsdShade.MaterialBindingAPI(stage.GetPrimAtPath(path))
        return binding.ComputeBoundMaterial("physics")[0].GetPrim()

    puck = material("/World/Objects/puck/body/Colliders/shape")
    heel = material("/World/Objects/wedge/body/Colliders/heel")
    for prim in (puck, heel):
        assert "PhysxMaterialAPI" in prim.GetMetadata("apiSchemas").GetAppliedItems()
        assert prim.GetAttribute("physxMaterial:frictionCombineMode").Get() == "multiply"
        assert prim.GetAttribute("physxMaterial:restitutionCombineMode").Get() == "multiply"
    a, b = UsdPhysics.MaterialAPI(puck), UsdPhysics.MaterialAPI(heel)
    assert a.GetStaticFrictionAttr().Get() == a.GetDynamicFrictionAttr().Get()
    friction = a.GetDynamicFrictionAttr().Get() * b.GetDynamicFrictionAttr().Get()
    assert friction == pytest.approx(pair_friction(0.1, 0.35), rel=1e-6)
    restitution = a.GetRestitutionAttr().Get() * b.GetRestitutionAttr().Get()
    assert restitution == pytest.approx(math.sqrt(0.4 * 0.1), rel=1e-6)
    assert puck.GetAttribute("simfoundry:friction").Get() == 0.1


def pixel_of(prim: Usd.Prim, camera: Camera, point: Pose) -> Array:
    """Where a point of the world lies in the picture [px], pixel centers at whole numbers, by USD's own frustum."""
    from pxr import Gf, UsdGeom

    frustum = UsdGeom.Camera(prim).GetCamera().frustum
    device = (frustum.ComputeViewMatrix() * frustum.ComputeProjectionMatrix()).Transform(Gf.Vec3d(*point.p))
    return np.array([(device[0] + 1) / 2 * camera.width, (1 - device[1]) / 2 * camera.height]) - 0.5


def test_cameras_project_as_the_scene_does(full: tuple[Scene, Usd.Stage]) -> None:
    scene, stage = full
    for camera in scene.cameras:
        prim = stage.GetPrimAtPath(f"/World/Cameras/{camera.name}")
        for offset in ([0.1, 0.2, 1.5], [-0.5, 0.05, 0.9], [0.0, 0.0, 2.0]):
            x, y, z = offset
            wanted = [camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy]
            seen = pixel_of(prim, camera, camera.X_WC @ Pose.of(offset))
            np.testing.assert_allclose(seen, wanted, atol=1e-3)
        assert tuple(prim.GetAttribute("simfoundry:resolution").Get()) == (camera.width, camera.height)


def test_lights(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdGeom, UsdLux

    scene, stage = full
    types = {LightType.DISTANT: "DistantLight", LightType.POINT: "SphereLight", LightType.DOME: "DomeLight"}
    full_intensity = {"DistantLight": np.pi, "SphereLight": 4 * np.pi, "DomeLight": 1.0}
    cache = UsdGeom.XformCache()
    for light in scene.lights:
        prim = stage.GetPrimAtPath(f"/World/Lights/{light.name}")
        assert prim.GetTypeName() == types[light.type]
        api = UsdLux.LightAPI(prim)
        assert api.GetIntensityAttr().Get() == pytest.approx(light.intensity * full_intensity[prim.GetTypeName()])
        matrix = np.array(cache.GetLocalToWorldTransform(prim)).T
        np.testing.assert_allclose(matrix, light.X_WL.matrix, atol=1e-10)


def test_semantics_label_each_object_with_its_category(full: tuple[Scene, Usd.Stage]) -> None:
    from pxr import UsdSemantics

    scene, stage = full
    for item in scene.objects:
        labels = UsdSemantics.LabelsAPI(stage.GetPrimAtPath(f"/World/Objects/{item.name}"), "category")
        assert list(labels.GetLabelsAttr().Get()) == [item.category]


def test_the_folder_can_be_moved_and_its_loader_runs(folders: dict[str, Path], tmp_path: Path) -> None:
    moved = Path(shutil.copytree(folders["full"], tmp_path / "else where"))
    assert validation_errors(open_stage(moved)) == []
    for path in moved.rglob("*"):
        assert path.is_dir() or not any(p in path.read_bytes() for p in (b"/tmp", b"/home", str(ROOT).encode()))
    environment = {k: v for k, v in os.environ.items() if k not in ("DISPLAY", "WAYLAND_DISPLAY", "PYTHONPATH")}
    run = subprocess.run(
        [sys.executable, "load.py"], cwd=moved, env=environment, capture_output=True, text=True, timeout=60, check=False
    )
    assert (run.returncode, run.stderr) == (0, "")
    assert run.stdout == "scene.usda: 9 objects, 12 rigid bodies, 5 joints\n"


def test_loader_offers_the_surfaces_own_friction(folders: dict[str, Path]) -> None:
    code = (
        "import load; s = load.load(own_friction=True, own_restitution=True); p = s.GetPrimAtPath('/World/Contacts/"
        "friction_0_1_restitution_0_4'); print([round(p.GetAttribute('physics:' + n).Get(), 6) for n in "
        "('staticFriction', 'dynamicFriction', 'restitution')])"
    )
    run = subprocess.run(
        [sys.executable, "-c", code], cwd=folders["full"], capture_output=True, text=True, timeout=60, check=True
    )
    assert run.stdout.strip() == "[0.1, 0.1, 0.4]"


def test_same_bytes_in_another_process_with_another_hash_seed() -> None:
    code = "from tests.scenes import full_scene; from simfoundry.backends.usd import compile_usd; import sys; "
    code += "sys.stdout.buffer.write(compile_usd(full_scene()).manifest)"
    for seed in ("1", "77"):
        environment = {**os.environ, "PYTHONHASHSEED": seed, "PYTHONPATH": str(ROOT)}
        run = subprocess.run(
            [sys.executable, "-c", code], env=environment, cwd=ROOT, capture_output=True, timeout=60, check=True
        )
        assert run.stdout == compile_usd(full_scene()).manifest


def test_losses_are_stated() -> None:
    losses = {loss.path: loss for loss in compile_usd(full_scene()).losses}
    assert sorted(losses) == ["friction", "lamp", "restitution"]
    assert all(loss.fidelity is Fidelity.APPROXIMATED for loss in losses.values())
    assert "0.592 for 0.35" in losses["friction"].reason
    frictionless = solid("ball", Sphere(0.03), pose(0, 0, 1), friction=1.0)
    assert compile_usd(scene_of(frictionless)).losses == ()


def test_a_texture_without_coordinates_is_reported_and_left_out() -> None:
    item = textured_object()
    mesh = item.root.visuals[0].geometry
    assert isinstance(mesh, Mesh)
    bare = Visual("skin", dataclasses.replace(mesh, uv=None), rgba(0.5, 0.5, 0.5))
    link = dataclasses.replace(item.root, visuals=(bare,))
    artifact = compile_usd(scene_of(dataclasses.replace(item, links=(link,))))
    dropped = [loss.path for loss in artifact.losses if loss.fidelity is Fidelity.DROPPED]
    assert dropped == ["wedge.body.skin.texture"]
    assert not any(path.endswith(".png") for path in artifact.files)


def test_a_welded_object_that_is_fixed_has_no_bodies(tmp_path: Path) -> None:
    from pxr import UsdPhysics

    item = cabinet(fixed=True)
    welds = tuple(dataclasses.replace(joint, type=JointType.FIXED) for joint in item.joints)
    scene = scene_of(dataclasses.replace(item, joints=welds))
    stage = written(scene, tmp_path / "welded")
    assert not any(p.HasAPI(UsdPhysics.RigidBodyAPI) or p.IsA(UsdPhysics.Joint) for p in stage.Traverse())
    handle = read_stage(stage).links["cabinet.handle"]
    X_OL = link_poses(scene.objects[0])
    assert handle.pose is not None
    np.testing.assert_allclose(pose_of(handle.pose).matrix, (item.X_WO @ X_OL["handle"]).matrix, atol=1e-10)
    assert handle.mass == pytest.approx(0.07, rel=1e-6)
    assert [x.path for x in compile_usd(scene).losses][1:] == ["cabinet.slide", "cabinet.hinge", "cabinet.weld"]
    assert validation_errors(stage) == []


def test_two_objects_of_one_name_are_refused() -> None:
    ball = solid("ball", Sphere(0.03), pose(0, 0, 1))
    with pytest.raises(InvalidSceneError, match="ball"):
        compile_usd(scene_of(ball, ball))


def hundred_objects() -> Scene:
    """A hundred free objects in a grid, each one of the four kinds of shape, a third of them meshes."""
    shapes = [solid("x", Sphere(0.03), pose(0, 0, 0)), textured_object(), SCENES["primitives"].object("can")]
    items = []
    for k in range(100):
        X_WO = pose(0.2 * (k % 10), 0.2 * (k // 10), 0.5, 0.1 * k, 0.2, -0.03 * k)
        items.append(dataclasses.replace(shapes[k % 3], name=f"item_{k}", X_WO=X_WO))
    return scene_of(*items)
