"""Shapes, materials, cameras and lights of a stage."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pytest

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Box, Mesh
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import (
    Camera,
    LightType,
    Scene,
    SceneObject,
    pair_friction,
)
from tests.backends.usd_stages import links_of
from tests.scenes import wedge_mesh

if TYPE_CHECKING:
    from pxr import Usd


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
