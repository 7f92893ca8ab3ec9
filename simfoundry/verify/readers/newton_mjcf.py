"""Newton, from the mjcf build; keyframe and gravity, which its importer leaves out, are brought in here."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

import newton
import numpy as np

from simfoundry.verify.readers import Session
from simfoundry.verify.readers.newton_session import Names, NewtonSession, quiet


def open_build(folder: Path) -> Session:
    """The model of ``scene.xml`` in the state of its keyframe."""
    quiet()
    builder = newton.ModelBuilder()
    builder.add_mjcf(str(folder / "scene.xml"))
    root = ET.parse(folder / "scene.xml").getroot()
    apply_keyframe(builder, _floats(root.find("keyframe/key"), "qpos"))
    model = builder.finalize(device="cpu")
    model.set_gravity(tuple(_floats(root.find("option"), "gravity")))
    return NewtonSession(model, Names(_last, _collider, _joint, {}))


def apply_keyframe(builder: newton.ModelBuilder, qpos: list[float]) -> None:
    """Write MuJoCo's positions into Newton's, which keeps the order of the joints but turns quaternions to xyzw."""
    if len(qpos) != len(builder.joint_q):
        raise ValueError(f"the keyframe has {len(qpos)} positions and the model {len(builder.joint_q)}")
    q = np.array(qpos)
    for kind, start in zip(builder.joint_type, builder.joint_q_start, strict=True):
        if kind in (newton.JointType.FREE, newton.JointType.BALL):
            at = start + (3 if kind == newton.JointType.FREE else 0)
            q[at : at + 4] = q[[at + 1, at + 2, at + 3, at]]
    builder.joint_q = q.tolist()


def _floats(element: ET.Element | None, attribute: str) -> list[float]:
    return [] if element is None else [float(v) for v in element.get(attribute, "").split()]


def _last(label: str) -> str:
    return label.rpartition("/")[2]


def _collider(label: str) -> tuple[str, str] | None:
    name = _last(label)
    link, _, collider = name.rpartition(".")
    return (link, collider) if ":" not in name else None


def _joint(label: str) -> str | None:
    """A joint that moves is ``object.joint``; those that the importer adds end in ``_joint`` or are free."""
    name = _last(label)
    return name if "." in name and not name.endswith("_joint") else None
