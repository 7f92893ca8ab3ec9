"""Broken URDFs: their names say how, their text follows from a seed."""

from __future__ import annotations

import re
from collections.abc import Iterator

import numpy as np

Rng = np.random.Generator

INERTIAL = (
    '<inertial><origin xyz="0 0 0.1"/><mass value="2"/>'
    '<inertia ixx="0.02" iyy="0.03" izz="0.04" ixy="0" ixz="0" iyz="0"/></inertial>'
)
BOX = '<visual><geometry><box size="0.1 0.2 0.3"/></geometry></visual>'
BOX += '<collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>'


def link(name: str, inside: str = INERTIAL + BOX) -> str:
    return f'<link name="{name}">{inside}</link>'


def joint(name: str, parent: str, child: str, kind: str = "revolute", inside: str = "") -> str:
    limits = '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="5" velocity="1"/>'
    ends = f'<parent link="{parent}"/><child link="{child}"/><origin xyz="0 0 0.3"/>'
    return f'<joint name="{name}" type="{kind}">{ends}{inside or limits}</joint>'


def robot(*parts: str) -> str:
    return f'<?xml version="1.0"?>\n<robot name="thing">\n{chr(10).join(parts)}\n</robot>\n'


SOUND = robot(link("a"), link("b"), link("c"), joint("j", "a", "b"), joint("k", "b", "c", "prismatic"))
LAUGHS = '<!DOCTYPE r [<!ENTITY a "ha"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'
MESH = '<collision><geometry><mesh filename="{}"/></geometry></collision>'


def named() -> Iterator[tuple[str, str]]:
    """Faults that people and exporters make, and some that mean harm."""
    yield "cyclic", robot(link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a"))
    yield "cyclic_apart", robot(link("r"), link("a"), link("b"), joint("j", "a", "b"), joint("k", "b", "a"))
    yield "its_own_parent", robot(link("a"), joint("j", "a", "a"))
    yield "two_parents", robot(link("a"), link("b"), link("c"), joint("j", "a", "c"), joint("k", "b", "c"))
    yield "two_roots", robot(link("a"), link("b"))
    yield "names_twice", robot(link("a"), link("a"), joint("j", "a", "a"))
    yield "joint_to_nowhere", robot(link("a"), joint("j", "a", "nowhere"))
    yield "joint_from_nowhere", robot(link("a"), joint("j", "nowhere", "a"))
    yield "no_links", robot()
    yield "no_name", SOUND.replace(' name="b"', "")
    yield "joint_of_no_kind", SOUND.replace('type="revolute"', 'type="wobbly"')
    yield "mimics_itself", SOUND.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="j"/>', 1)
    yield "mimics_nobody", SOUND.replace('<axis xyz="0 0 1"/>', '<axis xyz="0 0 1"/><mimic joint="q"/>', 1)
    yield "axis_without_direction", SOUND.replace('xyz="0 0 1"', 'xyz="0 0 0"')
    yield "limits_the_wrong_way", SOUND.replace('lower="-1"', 'lower="2"')
    yield "limit_not_a_number", SOUND.replace('lower="-1"', 'lower="nan"')
    yield "mass_not_a_number", SOUND.replace('value="2"', 'value="nan"')
    yield "mass_infinite", SOUND.replace('value="2"', 'value="inf"')
    yield "mass_negative", SOUND.replace('value="2"', 'value="-2"')
    yield "mass_zero", SOUND.replace('value="2"', 'value="0"')
    yield "mass_beyond_all", SOUND.replace('value="2"', 'value="1e308"')
    yield "inertia_of_no_body", SOUND.replace('ixx="0.02"', 'ixx="2000"')
    yield "inertia_negative", SOUND.replace('ixx="0.02"', 'ixx="-1"')
    yield "box_of_nothing", SOUND.replace("0.1 0.2 0.3", "0 0 0")
    yield "box_negative", SOUND.replace("0.1 0.2 0.3", "0.1 -0.2 0.3")
    yield "box_of_two_numbers", SOUND.replace("0.1 0.2 0.3", "0.1 0.2")
    yield "box_of_words", SOUND.replace("0.1 0.2 0.3", "a b c")
    yield "box_of_the_world", SOUND.replace("0.1 0.2 0.3", "1e30 1e30 1e30")
    yield "origin_far_away", SOUND.replace('xyz="0 0 0.3"', 'xyz="1e300 0 0"')
    yield "no_geometry", SOUND.replace('<box size="0.1 0.2 0.3"/>', "")
    yield "mesh_missing", robot(link("a", INERTIAL + MESH.format("nowhere.stl")))
    yield "mesh_elsewhere", robot(link("a", INERTIAL + MESH.format("/etc/passwd")))
    yield "mesh_above", robot(link("a", INERTIAL + MESH.format("../../../../etc/passwd")))
    yield "mesh_is_the_urdf", robot(link("a", INERTIAL + MESH.format("mesh_is_the_urdf.urdf")))
    yield "mesh_of_no_package", robot(link("a", INERTIAL + MESH.format("package://none/a.stl")))
    yield "entities", LAUGHS + SOUND.split("\n", 1)[1].replace("thing", "&b;")
    yield "outside_entity", '<!DOCTYPE r [<!ENTITY a SYSTEM "file:///etc/passwd">]>' + SOUND.split("\n", 1)[1]
    yield "deep", robot(link("a"), "<x>" * 5000 + "</x>" * 5000)
    yield (
        "long_chain",
        robot(*(link(f"l{k}") for k in range(1500)), *(joint(f"j{k}", f"l{k}", f"l{k + 1}") for k in range(1499))),
    )
    yield "many_links", robot(*(link(f"l{k}", "") for k in range(20_000)))
    yield "not_xml", "simfoundry: scene/1\n"
    yield "another_root", "<sdf/>"
    yield "empty", ""
    yield "nul", SOUND.replace("thing", "th\0ing")
    yield "odd_encoding", SOUND.replace('version="1.0"', 'version="1.0" encoding="klingon"')
    yield "long_name", SOUND.replace('"b"', f'"{"b" * 100_000}"')


def damaged(rng: Rng, count: int) -> Iterator[tuple[str, bytes]]:
    """A sound URDF with random damage: cut, bytes overwritten, elements dropped or doubled, numbers replaced."""
    odd = ("nan", "inf", "-1e308", "1e-320", "", "0x10", "1,5", "--", "9" * 400)
    for k in range(count):
        text = SOUND
        kind = ("cut", "bytes", "dropped", "doubled", "numbers", "attributes")[k % 6]
        tags = list(re.finditer(r"<[a-z]+[^<]*/>|<(link|joint|inertial|visual).*?</\1>", text))
        tag = tags[int(rng.integers(len(tags)))]
        if kind == "cut":
            text = text[: int(rng.integers(1, len(text)))]
        elif kind == "dropped":
            text = text[: tag.start()] + text[tag.end() :]
        elif kind == "doubled":
            text = text[: tag.end()] + tag.group() + text[tag.end() :]
        elif kind == "numbers":
            found = list(re.finditer(r"-?\d+\.?\d*", text[40:]))
            number = found[int(rng.integers(len(found)))]
            text = text[: 40 + number.start()] + odd[int(rng.integers(len(odd)))] + text[40 + number.end() :]
        elif kind == "attributes":
            text = re.sub(r'(\w+)="', lambda m: f'{m[1]}x="' if rng.random() < 0.05 else m[0], text)
        data = np.frombuffer(text.encode(), dtype=np.uint8).copy()
        if kind == "bytes":
            some = rng.random(len(data)) < 0.01
            data[some] = rng.integers(256, size=int(some.sum()), dtype=np.uint8)
        yield f"{kind}_{k}", data.tobytes()
