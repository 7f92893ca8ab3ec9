"""COLLADA meshes: units and axes, nested nodes, materials, and files that mean harm."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.assets.errors import MeshError
from simfoundry.frontends.meshes import read_collada

HEAD = '<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1"><asset>'
MESH = """<library_geometries><geometry id="g"><mesh>
<source id="p"><float_array id="pa" count="12">0 0 0 1 0 0 0 2 0 0 0 3</float_array><technique_common>
<accessor source="#pa" count="4" stride="3"><param name="X" type="float"/><param name="Y" type="float"/>
<param name="Z" type="float"/></accessor></technique_common></source>
<source id="t"><float_array id="ta" count="6">0 0 1 0 0 1</float_array><technique_common>
<accessor source="#ta" count="3" stride="2"><param name="S" type="float"/><param name="T" type="float"/>
</accessor></technique_common></source>
<vertices id="v"><input semantic="POSITION" source="#p"/></vertices>{primitive}</mesh></geometry>
</library_geometries>"""
POLYGONS = """<polylist material="m" count="2"><input semantic="VERTEX" source="#v" offset="0"/>
<vcount>3 4</vcount><p>0 1 2 0 1 2 3</p></polylist>"""
LOOK = """<library_effects><effect id="e"><profile_COMMON><technique sid="c"><lambert><diffuse>
<color>1 0.5 0 1</color></diffuse></lambert></technique></profile_COMMON></effect></library_effects>
<library_materials><material id="red"><instance_effect url="#e"/></material></library_materials>"""
PLACED = """<instance_geometry url="#g"><bind_material><technique_common>
<instance_material symbol="m" target="#red"/></technique_common></bind_material></instance_geometry>"""


def collada(nodes: str, primitive: str = POLYGONS, asset: str = "", more: str = "") -> str:
    return (
        f"{HEAD}{asset}</asset>{LOOK}{MESH.format(primitive=primitive)}{more}"
        f'<library_visual_scenes><visual_scene id="s">{nodes}</visual_scene></library_visual_scenes>'
        '<scene><instance_visual_scene url="#s"/></scene></COLLADA>'
    )


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "thing.dae"


def test_units_axes_nodes_and_colors(path: Path) -> None:
    """A tetrahedron's corners in centimeters with y up, moved by two nodes of which one mirrors."""
    nodes = f'<node id="a"><translate>0 100 0</translate><node id="b"><scale>1 1 -1</scale>{PLACED}</node></node>'
    path.write_text(collada(nodes, asset='<unit meter="0.01"/><up_axis>Y_UP</up_axis>'))
    (part,) = read_collada(path, (1.0, 1.0, 2.0))
    assert sorted(part.vertices.tolist()) == [[0, 0, 2], [0, 0, 2.04], [0, 0.03, 2], [0.01, 0, 2]]
    assert len(part.faces) == 3 and part.rgba == (1.0, 0.5, 0.0, 1.0) and part.uv is None
    a, b, c = (part.vertices[part.faces[0, k]] for k in range(3))
    straight = np.cross(np.subtract((0.01, 0, 2), (0, 0, 2)), np.subtract((0, 0, 2.04), (0, 0, 2)))
    assert np.cross(b - a, c - a) @ straight < 0  # mirrored, so that the corners run the other way round


def test_a_texture_beside_the_file_is_taken_and_no_other(path: Path) -> None:
    Image.new("RGB", (2, 2), (9, 8, 7)).save(path.parent / "wood.png")
    triangles = """<triangles material="m" count="1"><input semantic="VERTEX" source="#v" offset="0"/>
    <input semantic="TEXCOORD" source="#t" offset="1"/><p>0 0 1 1 2 2</p></triangles>"""
    picture = """<diffuse><texture texture="sm" texcoord="UV"/></diffuse>"""
    params = """<newparam sid="su"><surface type="2D"><init_from>i</init_from></surface></newparam>
    <newparam sid="sm"><sampler2D><source>su</source></sampler2D></newparam><technique sid="c">"""
    for name, found in (("wood.png", True), ("../../../wood.png", True), ("/etc/hostname", False)):
        images = f'<library_images><image id="i"><init_from>{name}</init_from></image></library_images>'
        text = collada(f'<node id="a">{PLACED}</node>', triangles).replace('<technique sid="c">', params, 1)
        text = text.replace("<diffuse>\n<color>1 0.5 0 1</color></diffuse>", picture)
        path.write_text(text.replace("<library_effects>", f"{images}<library_effects>"))
        (part,) = read_collada(path, (1.0, 1.0, 1.0))
        assert (part.texture is not None) is found and part.uv is not None
        assert part.uv.tolist() == [[0, 0], [1, 0], [0, 1]]


def test_a_material_that_is_missing_leaves_the_surface_plain(path: Path) -> None:
    path.write_text(collada(f'<node id="a">{PLACED.replace("#red", "#gone")}</node>'))
    (part,) = read_collada(path, (1.0, 1.0, 1.0))
    assert len(part.faces) == 3 and part.rgba is None


def _doubling() -> str:
    """Nodes of which each names the next one twice, 40 times over."""
    nodes = "".join(
        f'<node id="n{k}"><instance_node url="#n{k + 1}"/><instance_node url="#n{k + 1}"/></node>' for k in range(40)
    )
    last = f'<node id="n40">{PLACED}</node>'
    return collada(
        '<node id="r"><instance_node url="#n0"/></node>', more=f"<library_nodes>{last}{nodes}</library_nodes>"
    )


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (_doubling(), "more than 10000 nodes"),
        (collada('<node id="a"/>'), "has no triangles"),
        (collada(f'<node id="a">{PLACED.replace("#g", "#h")}</node>'), "Geometry #h not found"),
        (collada(f'<node id="a">{PLACED}</node>', POLYGONS.replace("1 2 3<", "1 2 9<")), "could not be read as a mesh"),
        (collada(f'<node id="a">{PLACED}</node>', "<tristrips/>"), "`<tristrips>` is not supported"),
        (f'<!DOCTYPE a [<!ENTITY e "x">]>{collada("")}', "defines the entity `e`"),
        ("<COLLADA>", "not valid XML"),
    ],
)  # fmt: skip
def test_what_is_no_mesh_is_refused_with_its_reason(path: Path, text: str, words: str) -> None:
    path.write_text(text)
    with pytest.raises(MeshError, match=words):
        read_collada(path, (1.0, 1.0, 1.0))
