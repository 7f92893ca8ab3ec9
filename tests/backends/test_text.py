"""The writers of text: what they write is read back by those whose format it is."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET

import pytest

from simfoundry.backends.artifact import json_text, number, numbers
from simfoundry.backends.usd.prims import Prim, usda
from simfoundry.backends.xmltext import xml_text

ODD = (
    "plain",
    'a "quoted" word',
    "it's",
    "both \" and '",
    "back\\slash",
    "tab\tbell\x07",
    "two\nlines 'and' \"quotes\"",
    "é",
)


def test_xml_is_what_elementtree_reads() -> None:
    root = ET.Element("mujoco", model="a & b < c > d")
    for text in ODD:
        ET.SubElement(ET.SubElement(root, "body"), "geom", name=text.replace("\x07", ""))
    read = ET.fromstring(xml_text(root))
    names = [geom.get("name") for geom in read.iter("geom")]
    assert names == [text.replace("\x07", "") for text in ODD]
    assert read.get("model") == "a & b < c > d"


def test_json_has_a_line_for_each_thing() -> None:
    data = {"gravity": [0, 0, -9.81], "objects": {"cup": {"p": [1.5, 0]}, "böwl": {}}, "none": {}}
    text = json_text(data)
    assert json.loads(text) == data
    assert len(text.decode().splitlines()) == 8


@pytest.mark.parametrize(
    ("value", "text"), [(-0.0, "0"), (1e-300, "0"), (0.1 + 0.2, "0.3"), (-1e-9, "-1e-09"), (3, "3")]
)
def test_numbers_have_twelve_digits(value: float, text: str) -> None:
    assert number(value) == text
    assert numbers((value, 1.0)) == f"{text} 1"


def test_usda_is_what_usd_reads() -> None:
    from pxr import Sdf

    world = Prim("World", "Xform", "/World", kind="assembly", custom_data={"simfoundry": {"lines": list(ODD)}})
    thing = world.define("thing", "Xform", ["PhysicsRigidBodyAPI"])
    for k, text in enumerate(ODD):
        thing.attribute(f"simfoundry:text{k}", "string", text)
    thing.attribute("size", "double3", (1.0, -0.5, 1e-9))
    thing.attribute("turn", "quatd", (1.0, 0.0, 0.25, 0.0))
    thing.attribute("on", "bool", True)
    thing.attribute("words", "token[]", ["a", "b"], uniform=True)
    thing.relate("simfoundry:to", [world, "/World/other"])
    thing.connect("outputs:out", "token", "/World/thing.on")
    for name in ("red", "blue"):
        world.variant(name).define("lid", "Sphere").attribute("radius", "double", 0.5)
    world.selected = "red"
    layer = Sdf.Layer.CreateAnonymous(".usda")
    assert layer.ImportFromString(usda(world, {"simfoundry": {"about": ODD[6]}}).decode())
    read = layer.GetPrimAtPath("/World/thing")
    assert [read.attributes[f"simfoundry:text{k}"].default for k in range(len(ODD))] == list(ODD)
    assert list(layer.GetPrimAtPath("/World").customData["simfoundry"]["lines"]) == list(ODD)
    assert layer.customLayerData == {"simfoundry": {"about": ODD[6]}}
    assert list(read.attributes["size"].default) == [1.0, -0.5, 1e-9]
    assert read.attributes["turn"].default.GetImaginary()[1] == 0.25
    assert read.attributes["on"].default is True
    assert list(read.attributes["words"].default) == ["a", "b"]
    assert read.attributes["words"].variability == Sdf.VariabilityUniform
    assert [str(p) for p in read.relationships["simfoundry:to"].targetPathList.explicitItems] == [
        "/World",
        "/World/other",
    ]
    assert list(read.attributes["outputs:out"].connectionPathList.explicitItems) == [Sdf.Path("/World/thing.on")]
    assert layer.GetObjectAtPath("/World{variant=blue}lid.radius").default == 0.5
    assert layer.GetPrimAtPath("/World").variantSelections["variant"] == "red"
