"""The lights of a scene as nodes, which light the view as they light pictures of the scene."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.geometry.frames import Pose
from simfoundry.scene.model import LightType, Scene
from simfoundry.studio.session import StudioSession
from simfoundry.studio.view.contents import LightContent, LinesContent, SurfaceContent
from simfoundry.studio.view.lights import dome_radiance, lamp_glyphs, light_nodes, panorama_nodes
from tests.studio.conftest import SCENE

LIGHTS = """\
lights:
  sun: {type: distant, intensity: 0.5, color: [1, 0.5, 0], direction: [1, 0, -1]}
  lamp: {type: point, intensity: 2, xyz: [0.1, 0.2, 1.5]}
"""


def surroundings(path: Path, text: str) -> Scene:
    """The surroundings of a scene with a text."""
    path.write_text(text)
    scene = StudioSession(path).scene
    assert scene is not None
    return scene.surroundings


def content(scene: Scene, name: str) -> LightContent:
    found = light_nodes(scene)[f"/lights/{name}"].content
    assert isinstance(found, LightContent)
    return found


def test_a_scene_without_lights_is_lit_evenly(desk: Path) -> None:
    scene = surroundings(desk, SCENE)
    assert light_nodes(scene) == lamp_glyphs(scene) == panorama_nodes(scene) == {}


def test_lamps_shine_from_where_they_are(desk: Path) -> None:
    scene = surroundings(desk, SCENE + LIGHTS)
    nodes = light_nodes(scene, casts_shadows=True)
    sun, lamp = nodes["/lights/sun"], nodes["/lights/lamp"]
    assert sun.content == LightContent(LightType.DISTANT, (0.5, 0.25, 0.0), casts_shadows=True)
    assert sun.X_PN.p / np.linalg.norm(sun.X_PN.p) == pytest.approx([-(0.5**0.5), 0, 0.5**0.5])
    assert lamp.content == LightContent(LightType.POINT, (2.0, 2.0, 2.0)) and lamp.X_PN.p.tolist() == [0.1, 0.2, 1.5]
    assert content(scene, "sky").rgb == pytest.approx([0.189, 0.205, 0.22], abs=1e-3)  # as in pictures
    glyphs = lamp_glyphs(scene)
    drawn = glyphs["/light_lines/sun"]
    assert glyphs.keys() == {"/light_lines/sun", "/light_lines/lamp"} and isinstance(drawn.content, LinesContent)
    start, end = (drawn.X_PN.apply(np.array(point)) for point in drawn.content.points[0])
    assert (end - start) / np.linalg.norm(end - start) == pytest.approx([0.5**0.5, 0, -(0.5**0.5)])


def test_a_panorama_lights_from_above_and_below_and_is_around_the_scene(desk: Path) -> None:
    picture = np.zeros((16, 32, 3), dtype=np.uint8)
    picture[:8], picture[8:] = (0, 0, 255), (255, 0, 0)  # a blue sky above red ground
    picture[:, 16:] //= 3
    Image.fromarray(picture).save(desk.with_name("sky.png"))
    dome = "lights: {sky_dome: {type: dome, intensity: 0.5, texture: sky.png}}\n"
    scene = surroundings(desk, SCENE + dome)
    mean = 0.5 * (1 + ((85 / 255 + 0.055) / 1.055) ** 2.4) / 2
    assert dome_radiance(scene.lights[0]) == pytest.approx(np.array([[0, 0, mean], [mean, 0, 0]]), abs=1e-3)
    assert content(scene, "sky").below == pytest.approx([mean / 2, 0, 0], abs=1e-3)
    key = light_nodes(scene)["/lights/key"]
    upward = key.X_PN.p[2] / np.linalg.norm(key.X_PN.p)  # a surface that faces up is as bright as before
    assert content(scene, "key").rgb[2] * upward + content(scene, "sky").rgb[2] == pytest.approx(mean, abs=1e-3)
    sphere = panorama_nodes(scene)["/panorama"].content
    assert isinstance(sphere, SurfaceContent)
    ((mesh, _, _),) = sphere.pieces
    corner = mesh.vertices[mesh.faces]  # type: ignore[union-attr]
    normals = np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])
    assert ((normals * corner.mean(axis=1)).sum(axis=1) <= 1e-9).all()  # seen from inside
    uv = mesh.uv[np.argmax(mesh.vertices[:, 0])]  # type: ignore[union-attr,index]
    assert uv == pytest.approx([0.5, 0.5])  # the center of the picture is in the direction of x
    uv = mesh.uv[np.argmax(mesh.vertices[:, 1])]  # type: ignore[union-attr,index]
    assert uv == pytest.approx([0.25, 0.5])
    length = struct.unpack_from("<I", sphere.glb, 12)[0]
    document = json.loads(sphere.glb[20 : 20 + length])
    assert document["materials"][0]["extensions"] == {"KHR_materials_unlit": {}}
    assert panorama_nodes(scene)["/panorama"].X_PN.q.tolist() == Pose.of().q.tolist()


def test_an_unreadable_panorama_and_many_lights_are_no_problem(desk: Path) -> None:
    many = "lights:\n" + "".join(f"  lamp_{k}: {{type: point, intensity: 0}}\n" for k in range(100))
    scene = surroundings(desk, SCENE + many)
    assert len(light_nodes(scene)) == 8 + 1 and len(lamp_glyphs(scene)) == 8
