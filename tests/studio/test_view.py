"""What is sent to the browser: everything once, and afterwards only what changed."""

from __future__ import annotations

import json
import re
import struct
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

import simfoundry as sf
from simfoundry.geometry.frames import Pose
from simfoundry.geometry.shapes import Box, Cylinder, closed_mesh
from simfoundry.render.glb import glb_of
from simfoundry.studio.acts.move import MoveObject
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.export import scene_html
from simfoundry.studio.server import StudioServer
from simfoundry.studio.session import StudioSession
from simfoundry.studio.view.canvas import Canvas
from simfoundry.studio.view.contents import FrustumContent, SurfaceContent
from simfoundry.studio.view.nodes import DisplayOptions, scene_nodes
from simfoundry.studio.view.panels.adding import AddPanel
from tests.studio.conftest import SCENE

viser = pytest.importorskip("viser")


@pytest.fixture(scope="module")
def canvas() -> Iterator[Canvas]:
    """A canvas on a real server, without a browser."""
    server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    yield Canvas(server.scene)
    server.stop()


def test_a_glb_file_is_read_by_trimesh(tmp_path: Path) -> None:
    import trimesh

    triangle = closed_mesh(np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0.5]]), np.array([[0, 1, 2]]))
    box = (Box(np.array([0.2, 0.4, 0.6])), Pose.of((1, 2, 3)), (1.0, 0.5, 0.0, 1.0))
    data = glb_of([box, (Cylinder(0.1, 0.3), Pose.of(), (0.0, 0.0, 1.0, 0.5)), (triangle, Pose.of(), (1, 1, 1, 1))])
    assert data == glb_of(
        [box, (Cylinder(0.1, 0.3), Pose.of(), (0.0, 0.0, 1.0, 0.5)), (triangle, Pose.of(), (1, 1, 1, 1))]
    )
    (tmp_path / "a.glb").write_bytes(data)
    scene = trimesh.load(tmp_path / "a.glb")
    assert len(scene.geometry) == 3
    boxes = [g for g in scene.geometry.values() if np.allclose(g.extents, [0.2, 0.4, 0.6], atol=1e-6)]
    assert len(boxes) == 1 and boxes[0].bounds.mean(axis=0) == pytest.approx([1, 2, 3])
    length, kind = struct.unpack_from("<I4s", data, 12)
    document = json.loads(data[20 : 20 + length])
    assert kind == b"JSON" and len(document["materials"]) == 3
    assert document["materials"][0]["pbrMetallicRoughness"]["baseColorFactor"] == [1.0, 0.214041, 0.0, 1.0]
    assert document["materials"][1]["alphaMode"] == "BLEND" and document["materials"][2]["doubleSided"]
    assert glb_of([]).startswith(b"glTF")


def test_only_what_changed_is_sent(desk: Path, canvas: Canvas) -> None:
    session = StudioSession(desk)

    def sent() -> int:
        before = canvas.sent
        assert session.scene is not None
        canvas.show(scene_nodes(session.scene.scene, DisplayOptions()))
        return canvas.sent - before

    assert sent() == len(canvas.nodes) == 4 * 2 + 1
    assert sent() == 0
    session.apply(MoveObject("mug", Pose.of((0.3, 0.2, 0.3))))
    assert sent() == 1  # its frame
    session.apply(SetProperties("mug", {"mass": 1.0}))
    assert sent() == 0
    session.apply(SetProperties("mug", {"color": (1.0, 0.0, 0.0)}))
    assert sent() == 2  # its surface, without the old one
    session.apply(SetProperties("tray", {"color": (1.0, 0.0, 0.0)}))
    session.undo()
    session.undo()
    assert sent() == 2
    canvas.show({})
    assert canvas.nodes == {}


def test_the_nodes_show_what_is_asked_for(desk: Path) -> None:
    session = StudioSession(desk)
    assert session.scene is not None
    scene = session.scene.scene
    plain = scene_nodes(scene, DisplayOptions())
    assert plain["/objects/mug"].selects == "objects.mug"
    assert plain["/objects/mug"].X_PN.p == pytest.approx([0.2, 0.1, 0.0501], abs=1e-4)
    frustum = plain["/cameras/front"].content
    assert isinstance(frustum, FrustumContent) and frustum.fov == pytest.approx(np.radians(50))
    everything = scene_nodes(scene, DisplayOptions(colliders=True, joints=True, names=True, frames=True))
    assert {n for n in everything if n.startswith("/objects/tray/")} == {
        "/objects/tray/base", "/objects/tray/base_colliders", "/objects/tray/name",
    }  # fmt: skip
    tray = everything["/objects/tray/base_colliders"].content
    assert isinstance(tray, SurfaceContent) and len(tray.pieces) == 5  # the walls and the floor of the box


def test_a_window_without_editing_has_no_panel_that_edits(desk: Path) -> None:
    with StudioServer(desk, port=0, is_editable=False) as server:
        server.window.select("objects.mug")
        server.window.refresh()
        panels = server.window._panels
        assert panels and not any(panel.edits for panel in panels)
        assert server.window.gizmo.size == 0.0 and "/objects/mug/selection" in server.window.canvas.nodes
        desk.write_text(SCENE.replace("mass: 0.3", "mass: 0.31"))
        end = time.monotonic() + 10
        while "0.31" not in server.session.text:
            assert time.monotonic() < end
            time.sleep(0.02)


def test_a_page_contains_everything_and_is_the_same_each_time(desk: Path) -> None:
    document = sf.load(desk)
    page = scene_html(document.lower())
    assert page == scene_html(document.lower())
    assert "<!-- Generated by SimFoundry: desk -->" in page[:200]
    fetched = re.findall(r'(?:src|href)="(https?:[^"]*)"', page)
    assert fetched == [] and "__VISER_EMBED_DATA__" in page
    shown = document._repr_html_()
    assert shown is not None and shown.startswith('<iframe srcdoc="&lt;!doctype html&gt;')
    document.objects["mug"].place = {"on": "desk", "xy": [9, 9]}
    assert document._repr_html_() is None  # it cannot be lowered


def test_new_assets_are_offered_when_a_page_is_opened(desk: Path) -> None:
    with StudioServer(desk, port=0) as server:
        panel = server.window.panel(AddPanel)
        assert "things/cup.obj" not in panel._kind.options
        panel._kind.value = "cone"
        (desk.parent / "things").mkdir()
        (desk.parent / "things" / "cup.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
        panel._search()
        assert "things/cup.obj" in panel._kind.options and panel._kind.value == "cone"
