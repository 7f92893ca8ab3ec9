"""Newton, from the mjcf build through the loader of the target `newton`."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

from simfoundry.runtime.plugins import import_file
from simfoundry.verify.readback import Session

_session = import_file(Path(__file__).with_name("session.py"))

_OWN = ":surface"
"""How the names of numbers end that give the surfaces of a link's colliders, four for each, friction first."""


def open_build(folder: Path, loader: ModuleType) -> Session:
    """The model of ``scene.xml`` in the state of its keyframe."""
    _session.quiet()
    model = loader.load()
    root = ET.parse(folder / "scene.xml").getroot()
    joints = {str(joint.get("name")) for joint in root.iterfind("worldbody//joint")}
    own = dict(_own_friction(root))
    names = _session.Names(_last, _collider, lambda label: _joint(label, joints), {}, own_friction=own)
    session: Session = _session.NewtonSession(model, names)
    return session


def _own_friction(root: ET.Element) -> Iterator[tuple[str, dict[str | None, float]]]:
    """By link those of its colliders: one that is said is meant of all, more are in the order of the geoms."""
    bodies = {str(body.get("name")): body for body in root.iterfind("worldbody//body")}
    for numeric in root.iterfind("custom/numeric"):
        link, said = str(numeric.get("name")), [float(v) for v in str(numeric.get("data")).split()][::4]
        if link.endswith(_OWN):
            link = link.removesuffix(_OWN)
            felt = (_collider(str(geom.get("name"))) for geom in bodies[link].findall("geom"))
            names = [named[1] for named in felt if named is not None]
            yield link, dict(zip(names, said * len(names) if len(said) == 1 else said, strict=True))


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
