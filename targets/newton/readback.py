"""The Newton session for MJCF builds, which opens a build with the loader of the ``newton`` target."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from pathlib import Path
from types import ModuleType

from simfoundry.runtime.plugins import import_file
from simfoundry.verify import readback as rb

_session = import_file(Path(__file__).with_name("session.py"))


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the model in ``scene.xml``, in the state of its keyframe."""
    _session.quiet()
    model = loader.load()
    root = ET.parse(folder / "scene.xml").getroot()
    joints = {str(joint.get("name")) for joint in root.iterfind("worldbody//joint")}
    axes = loader.several_axes(root)
    names = _session.Names(
        _last, _collider, lambda label: _joint(label, joints), {}, axes=lambda n: axes.get(_last(n), ())
    )
    session: rb.Session = _session.NewtonSession(model, names)
    return session


def _last(label: str) -> str:
    return label.rpartition("/")[2]


def _collider(label: str) -> tuple[str, str] | None:
    name = _last(label)
    link, _, collider = name.rpartition(".")
    return (link, collider) if ":" not in name else None


def _joint(label: str, joints: set[str]) -> str | None:
    """Return the name of a joint in the file, or None for a joint that the importer added."""
    name = _last(label)
    return name if name in joints else None
