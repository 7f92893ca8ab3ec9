"""Ellipsoids, cones, open boxes and compounds: from MJCF and USD, and through an edited stage back to the document."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import pytest

from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.usd.compiled.reading import StageReading, read_spec
from simfoundry.geometry.shapes import Box, Cone, Ellipsoid, Mesh
from simfoundry.scene.lower import lower_file
from simfoundry.scene.meshfile import has_texture
from tests.frontends.conftest import Importing
from tests.frontends.usd.stages import OBJECTS

if TYPE_CHECKING:
    from pxr import Usd

NEW_SHAPES = Path(__file__).parents[1] / "scene" / "new_shapes.scene.yaml"

STAGE = """#usda 1.0
( defaultPrim = "World"; metersPerUnit = 1; upAxis = "Z" )
def Xform "World" {
  def Sphere "Egg" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"] ) {
    double radius = 2
    double3 xformOp:scale = (0.03, 0.02, 0.01)
    uniform token[] xformOpOrder = ["xformOp:scale"]
    float physics:mass = 0.1
  }
  def Cone "Hat" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI", "PhysicsMassAPI"] ) {
    double radius = 0.1
    double height = 0.2
    uniform token axis = "X"
    double3 xformOp:scale = (-1, 1, 1)
    uniform token[] xformOpOrder = ["xformOp:scale"]
    float physics:mass = 0.1
  }
}
"""


def test_an_ellipsoid_of_mujoco_stays_one(importing: Importing) -> None:
    text = """<mujoco><worldbody><body name="egg"><freejoint/>
    <geom type="ellipsoid" size="0.03 0.02 0.01" mass="0.1"/></body></worldbody></mujoco>"""
    report, scene = importing("egg.xml", text)
    geometry = scene.object("egg").root.colliders[0].geometry
    assert isinstance(geometry, Ellipsoid) and geometry.radii == pytest.approx([0.03, 0.02, 0.01])
    assert not [note for note in report.notes if "ellipsoid" in str(note)]


def test_scaled_spheres_and_mirrored_cones_of_usd_stay_primitives(importing: Importing) -> None:
    _, scene = importing("s.usda", STAGE)
    egg, hat = (scene.object(name).root.colliders[0] for name in ("egg", "hat"))
    assert isinstance(egg.geometry, Ellipsoid) and egg.geometry.radii == pytest.approx([0.06, 0.04, 0.02])
    assert hat.geometry == Cone(0.1, 0.2)
    tip = (scene.object("hat").X_WO @ hat.X_LG).rotation[:, 2]
    assert tip == pytest.approx([-1, 0, 0], abs=1e-8)  # the mirror image of a tip along x


@pytest.fixture
def stage(tmp_path: Path) -> Usd.Stage:
    from pxr import Usd

    document = tmp_path / "new_shapes.scene.yaml"
    document.write_bytes(NEW_SHAPES.read_bytes())
    compile_usd(lower_file(document)).write(tmp_path / "usd")
    return Usd.Stage.Open(str(tmp_path / "usd" / "scene.usda"))


def reading(stage: Usd.Stage) -> StageReading:
    found = read_spec(stage)
    assert found is not None
    return found


def resize(stage: Usd.Stage, name: str, *factors: float) -> None:
    from pxr import Gf, UsdGeom

    prim = UsdGeom.Xformable(stage.GetPrimAtPath(f"{OBJECTS}/{name}"))
    prim.AddScaleOp().Set(Gf.Vec3f(*factors))


def test_an_untouched_stage_has_no_edits(stage: Usd.Stage) -> None:
    found = reading(stage)
    assert found.data == found.before and not found.notes


@pytest.mark.parametrize(
    ("name", "factors", "shape"),
    [
        ("egg", (2, 1, 1), {"ellipsoid": (0.06, 0.03, 0.02)}),
        ("party_hat", (2, 2, 1), {"cone": {"radius": 0.1, "height": 0.12}}),
        ("bin", (2, 2, 2), {"open_box": {"size": (0.6, 0.4, 0.24), "wall": 0.02}}),
    ],
)
def test_scaled_objects_are_resized(
    stage: Usd.Stage, name: str, factors: tuple[float, float, float], shape: dict[str, Any]
) -> None:
    resize(stage, name, *factors)
    assert reading(stage).data["objects"][name]["shape"] == shape


def test_a_scaled_compound_scales_its_parts(stage: Usd.Stage) -> None:
    resize(stage, "hammer", 2, 2, 2)
    parts = reading(stage).data["objects"]["hammer"]["shape"]["compound"]
    assert parts["handle"]["shape"] == {"capsule": {"radius": 0.024, "height": 0.4}}
    assert parts["head"]["pose"]["xyz"] == (0, 0, 0.22) and parts["head"]["material"] == "rubber"


def test_what_the_shapes_cannot_say_is_told(stage: Usd.Stage) -> None:
    resize(stage, "bin", 2, 1, 1)
    resize(stage, "hammer", 1, 1, 2)
    found = reading(stage)
    assert found.data == found.before
    said = {note.prim.rpartition("/")[2]: note.message for note in found.notes}
    assert said["bin"].endswith("no longer an open_box") and said["hammer"].endswith("no longer a compound")


def test_a_part_of_a_compound_is_painted_on_its_own(stage: Usd.Stage) -> None:
    from pxr import Gf, UsdShade

    visual = stage.GetPrimAtPath(f"{OBJECTS}/table/base/Visuals/leg_1")
    material, _ = UsdShade.MaterialBindingAPI(visual).ComputeBoundMaterial()
    surface = stage.GetPrimAtPath(material.GetPath().AppendChild("Surface"))
    surface.GetAttribute("inputs:diffuseColor").Set(Gf.Vec3f(1, 0, 0))
    table = reading(stage).data["objects"]["table"]
    assert table["shape"]["compound"]["leg_1"]["color"] == (1.0, 0.0, 0.0)
    assert "color" not in table and "color" not in table["shape"]["compound"]["leg_2"]


def test_a_part_of_a_compound_that_is_moved_is_told(stage: Usd.Stage) -> None:
    from pxr import Gf

    leg = stage.GetPrimAtPath(f"{OBJECTS}/table/base/Visuals/leg_2")
    leg.GetAttribute("xformOp:translate").Set(Gf.Vec3d(0, 0, 0))
    found = reading(stage)
    assert found.data == found.before and [note.prim.rpartition("/")[2] for note in found.notes] == ["leg_2"]


def test_a_texture_on_a_primitive_of_mujoco_becomes_that_of_a_material(importing: Importing) -> None:
    text = """<mujoco><asset>
      <texture name="tiles" type="2d" builtin="checker" rgb1="1 0 0" rgb2="0 0 1" width="32" height="32"/>
      <material name="tiled" texture="tiles" texrepeat="4 4" texuniform="true" rgba="1 0.5 1 1"/></asset>
      <worldbody><geom name="floor" type="box" size="1 1 0.05" material="tiled" friction="0.8"/></worldbody></mujoco>"""
    report, scene = importing("floor.xml", text)
    (item,) = scene.objects
    (visual,) = item.root.visuals
    assert isinstance(visual.geometry, Mesh) and has_texture(visual.geometry)
    assert visual.geometry.uv is not None and visual.geometry.uv.max() == pytest.approx(2 / 0.25)
    assert visual.rgba == pytest.approx([1, 0.5, 1, 1])
    (collider,) = item.root.colliders
    assert isinstance(collider.geometry, Box) and collider.friction == pytest.approx(0.8)
    assert any("projected" in str(note) for note in report.notes)


def test_the_panorama_of_a_dome_is_kept(importing: Importing, tmp_path: Path) -> None:
    image = b"#?RADIANCE\n\n-Y 1 +X 1\n\x80\x80\x80\x80"
    (tmp_path / "source").mkdir()
    (tmp_path / "source" / "room.hdr").write_bytes(image)
    text = """#usda 1.0
( upAxis = "Z"; metersPerUnit = 1 )
def Sphere "Ball" ( prepend apiSchemas = ["PhysicsRigidBodyAPI", "PhysicsCollisionAPI"] )
{
  double radius = 0.1
}
def DomeLight "Sky"
{
  asset inputs:texture:file = @room.hdr@
  float inputs:intensity = 0.5
}
def DomeLight "Lost"
{
  asset inputs:texture:file = @absent.hdr@
}
"""
    report, scene = importing("s.usda", text)
    panoramas = {light.name: light.panorama for light in scene.lights}
    assert panoramas["sky"] is not None and panoramas["sky"].content == image and panoramas["lost"] is None
    notes = [str(note) for note in report.notes if "texture of light" in str(note)]
    assert len(notes) == 2 and "direction of x" in notes[0] and "could not be found" in notes[1]
