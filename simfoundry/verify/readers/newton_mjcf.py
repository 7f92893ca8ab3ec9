"""Newton, from the mjcf build through the loader of the target `newton`."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path

from simfoundry.verify.readers import LOADERS, Session, load_module
from simfoundry.verify.readers.newton_session import Names, NewtonSession, quiet


def open_build(folder: Path) -> Session:
    """The model of ``scene.xml`` in the state of its keyframe."""
    quiet()
    model = load_module(LOADERS / "newton_load.py").load(scene=folder / "scene.xml")
    root = ET.parse(folder / "scene.xml").getroot()
    joints = {str(joint.get("name")) for joint in root.iterfind("worldbody//joint")}
    return NewtonSession(model, Names(_last, _collider, lambda label: _joint(label, joints), {}))


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
