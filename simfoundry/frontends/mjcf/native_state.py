"""The state and the tools of reading a model, shared by the readers of its kinds of elements."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.backends.artifact import exact
from simfoundry.frontends.document_data import Data
from simfoundry.frontends.draft import CompiledName
from simfoundry.frontends.files import Element
from simfoundry.frontends.mjcf.geoms import MjcfSource
from simfoundry.frontends.names import NameTable

# A model with one element of each kind, whose values are MuJoCo's defaults.
_DEFAULTS = """<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/><site name="s"/></body></worldbody>
<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon><actuator><general joint="j"/></actuator>
<sensor><clock/></sensor><equality><joint joint1="j"/></equality></mujoco>"""


def plain(value: Any) -> Any:
    """Return a value of a model as a number or a tuple of numbers."""
    array = np.asarray(value)
    if array.size == 1:
        value = array.reshape(-1)[0].item()
        return float(value) if isinstance(value, float) else value
    return tuple(array.reshape(-1).tolist())


def exact_values(**values: Any) -> Data:
    """Return the values as native data, except for those that documents and MJCF state to the last bit anyway."""
    kept = {key: plain(value) for key, value in values.items() if not _is_stated(key, np.ravel(value).tolist())}
    return {"exact": kept} if kept else {}


def _is_stated(key: str, values: list[float]) -> bool:
    if key in ("quat", "axis") and not {abs(v) for v in values} <= {0.0, 1.0}:  # documents have angles and unit vectors
        return False
    return all(float(exact(v)) == v == float(f"{v:.12g}") for v in values)  # longer ones change if poses are combined


def is_angle_stated(angle: float) -> bool:
    """Return True if an angle [rad] is the same after it was written in degrees."""
    return math.radians(float(exact(math.degrees(angle)))) == angle == float(exact(angle))


def mesh_inertia_modes(roots: list[Element]) -> dict[str, str]:
    """Return how MuJoCo computes the inertial frame of each mesh whose file specifies it, by the name of the mesh."""
    meshes = [element for root in roots for element in root.walk() if element.tag == "mesh"]
    usual = next((m.get("inertia") for m in meshes if m.get("inertia") and not (m.get("file") or m.get("name"))), "")
    named = {m.get("name") or Path(m.get("file") or "").stem: m.get("inertia") or usual for m in meshes}
    return {name: mode for name, mode in named.items() if name and mode}


class NativeState:
    """The native data read from a model so far, and the names by which it refers to elements."""

    def __init__(self, source: MjcfSource, roots: list[Element]) -> None:
        self.source, self.mujoco, self.model = source, source.mujoco, source.model
        self.usual = source.mujoco.MjModel.from_xml_string(_DEFAULTS)
        self.data: Data = {}
        self.mesh_inertia = mesh_inertia_modes(roots)
        self.excluded: list[tuple[int, int]] = []  # pairs of bodies that documents cannot exclude
        self.places: dict[tuple[str, int], Any] = {}  # how native data refers to elements, by kind and number
        self.names = {kind: NameTable(kind) for kind in ("site", "tendon", "actuator", "sensor", "camera")}

    def differing(self, fields: dict[str, str], number: int) -> Data:
        """Return the attributes of an element that differ from MuJoCo's defaults."""
        found: Data = {}
        for attribute, name in fields.items():
            if hasattr(self.model, name):
                value = getattr(self.model, name)[number]
                if not np.array_equal(value, getattr(self.usual, name)[0]):
                    found[attribute] = plain(value)
        return found

    def add(self, section: str, tag: str, **attributes: Any) -> None:
        """Add an element to a section; attributes that are None are omitted."""
        element = {tag: {key: value for key, value in attributes.items() if value is not None}}
        self.data.setdefault(section, []).append(element)

    def ref(self, kind: str, number: int) -> Any:
        """Return how native data refers to an element."""
        return "world" if kind == "body" and number == 0 else self.places[kind, number]

    def keep_order(self, section: str, order: list[Any]) -> None:
        """Keep the order of a section if it contains both words and native elements, or elements of several objects."""
        words = [each for each in order if isinstance(each, CompiledName)]
        if words and order:
            self.data.setdefault("order", {})[section] = tuple(order)
