"""Newton, from the mjcf build; keyframe and gravity, which its importer leaves out, are set here."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path

import newton
import numpy as np

from simfoundry.verify.readers import Session
from simfoundry.verify.readers.newton_session import Names, NewtonSession, quiet

_OWN = ":surface"
"""How the names of numbers end that give the surfaces of a link's colliders, four for each, friction first."""


def open_build(folder: Path) -> Session:
    """The model of ``scene.xml`` in the state of its keyframe."""
    quiet()
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(folder / "scene.xml"))
    root = ET.parse(folder / "scene.xml").getroot()
    apply_keyframe(builder, _floats(root.find("keyframe/key"), "qpos"))
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(_floats(root.find("option"), "gravity")))
    joints = {str(joint.get("name")) for joint in root.iterfind("worldbody//joint")}
    controls = _floats(root.find("keyframe/key"), "ctrl")
    own = dict(_own_friction(root))
    names = Names(_last, _collider, lambda label: _joint(label, joints), {}, own_friction=own)
    return NewtonSession(model, names, controls)


def _own_friction(root: ET.Element) -> Iterator[tuple[str, dict[str | None, float]]]:
    """By link those of its colliders: one that is said is meant of all, more are in the order of the geoms."""
    bodies = {str(body.get("name")): body for body in root.iterfind("worldbody//body")}
    for numeric in root.iterfind("custom/numeric"):
        link, said = str(numeric.get("name")), _floats(numeric, "data")[::4]
        if link.endswith(_OWN):
            link = link.removesuffix(_OWN)
            felt = (_collider(str(geom.get("name"))) for geom in bodies[link].findall("geom"))
            names = [named[1] for named in felt if named is not None]
            yield link, dict(zip(names, said * len(names) if len(said) == 1 else said, strict=True))


def apply_keyframe(builder: newton.ModelBuilder, qpos: list[float]) -> None:
    """Write MuJoCo's positions into Newton's, which keeps the order of the joints but turns quaternions to xyzw."""
    ends = [*builder.joint_q_start[1:], len(builder.joint_q)]
    q, at, carried = np.array(builder.joint_q, dtype=np.float64), 0, set[int]()
    for kind, child, start, end in zip(
        builder.joint_type, builder.joint_child, builder.joint_q_start, ends, strict=True
    ):
        if child in carried:  # a loop that MuJoCo closes by an equality is a second joint of the same body here
            continue
        carried.add(child)
        count = end - start
        if at + count > len(qpos):
            raise ValueError(f"the keyframe has {len(qpos)} positions and the model more")
        values = np.array(qpos[at : at + count])
        if kind in (newton.JointType.FREE, newton.JointType.BALL):
            values[-4:] = values[[-3, -2, -1, -4]]
        q[start:end] = values
        at += count
    if at != len(qpos):
        raise ValueError(f"the keyframe has {len(qpos)} positions and the model {at}")
    builder.joint_q = q.tolist()


def _floats(element: ET.Element | None, attribute: str) -> list[float]:
    return [] if element is None else [float(v) for v in element.get(attribute, "").split()]


def _last(label: str) -> str:
    return label.rpartition("/")[2]


def _collider(label: str) -> tuple[str, str] | None:
    name = _last(label)
    link, _, collider = name.rpartition(".")
    return (link, collider) if ":" not in name else None


def _joint(label: str, joints: set[str]) -> str | None:
    """A joint of the file; any other was added by the importer."""
    name = _last(label)
    return name if name in joints else None
