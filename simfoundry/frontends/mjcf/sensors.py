"""Read the sensors of a model, in the words of documents where these suffice."""

from __future__ import annotations

from typing import Any

import numpy as np

from simfoundry.frontends.document_data import Data
from simfoundry.frontends.draft import AttachmentDraft, CompiledName
from simfoundry.frontends.mjcf.native_state import NativeState

# Sensors whose names in XML differ from those of their types.
_SENSOR_TAGS = {"jointactfrc": "jointactuatorfrc", "tendonactfrc": "tendonactuatorfrc", "geomdist": "distance",
                "geomnormal": "normal", "geomfromto": "fromto"}  # fmt: skip

# The words of sensors in documents, by the names in XML.
_SENSOR_WORDS = {n: n for n in ("touch", "accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer")} | {
    "rangefinder": "rangefinder", "jointpos": "joint_position", "jointvel": "joint_velocity", "framepos": "position",
    "framequat": "orientation", "framelinvel": "linear_velocity", "frameangvel": "angular_velocity",
}  # fmt: skip


class SensorReader(NativeState):
    """A reader of sensors."""

    def read_sensors(self) -> None:
        """Add the sensors to the draft or to the native data."""
        order: list[Any] = []
        for k in range(self.model.nsensor):
            name = self.source.name("sensor", k) or f"sensor_{k}"
            if not self._sensor(k, name):
                self.source.draft.dropped(f"sensor `{name}`", "its kind or its target is not imported")
                continue
            order.append(self.places["sensor", k])
        self.keep_order("sensor", order)

    def _sensor(self, k: int, name: str) -> bool:
        """Add a sensor, and return True unless its kind or its target is not imported."""
        model, mujoco = self.model, self.mujoco
        kind = mujoco.mjtSensor(model.sensor_type[k]).name.removeprefix("mjSENS_").lower()
        tag = _SENSOR_TAGS.get(kind, kind)
        target, other = (int(getattr(model, f"sensor_{n}id")[k]) for n in ("obj", "ref"))
        objects = {n: mujoco.mjtObj(getattr(model, f"sensor_{n}type")[k]).name.removeprefix("mjOBJ_").lower()
                   for n in ("obj", "ref")}  # fmt: skip
        values: Data = {n: float(getattr(model, f"sensor_{n}")[k]) for n in ("noise", "cutoff")}
        values = {key: value for key, value in values.items() if value}
        what = "body" if objects["obj"] == "xbody" else objects["obj"]
        place = self.places.get((what, target))
        word = self._sensor_word(k, tag, objects, place)
        if word is not None and place is not None:
            owner = next(body for body in self.source.draft.bodies if body.name == place.owner)
            owner.sensors.append(AttachmentDraft(name, {"type": _SENSOR_WORDS[tag], **values}, word, place.element))
            self.places["sensor", k] = CompiledName("sensor", owner.name, name)
            return True
        out: Data = values | self._sensor_history(k)
        if tag in ("tactile", "plugin"):
            return False
        if tag == "user":
            data = mujoco.mjtDataType(model.sensor_datatype[k]).name.removeprefix("mjDATATYPE_").lower()
            stage = mujoco.mjtStage(model.sensor_needstage[k]).name.removeprefix("mjSTAGE_").lower()
            out |= {"dim": int(model.sensor_dim[k]), "datatype": data, "needstage": stage}
            if target >= 0:
                out |= {"objtype": objects["obj"], "objname": place}
        elif tag == "contact":
            out |= self._contact_sensor(k, target, other, objects)
        elif tag in ("distance", "normal", "fromto"):
            for n, (key, number) in enumerate((("obj", target), ("ref", other)), 1):
                out[f"{objects[key]}{n}"] = self.places.get((objects[key], number))
        elif tag.startswith("frame") or tag == "insidesite":
            out |= {"objtype": objects["obj"], "objname": place}
            if tag == "insidesite":
                out["site"] = self.places.get(("site", other))
            elif other >= 0:
                reference = "body" if objects["ref"] == "xbody" else objects["ref"]
                out |= {"reftype": objects["ref"], "refname": self.places.get((reference, other))}
        elif tag == "camprojection":
            out |= {"site": place, "camera": self.places.get(("camera", other))}
        elif tag == "rangefinder":
            out |= {what: place} | self._bits(k, "mjRAYDATA_", ("dist", "dir", "origin", "point", "normal", "depth"), 1)
        elif target >= 0 and tag not in ("clock", "e_potential", "e_kinetic"):
            out[what] = place
        if None in out.values():
            return False
        self.places["sensor", k] = called = self.names["sensor"].name(name)
        self.add("sensor", tag, name=called, **out)
        return True

    def _sensor_word(self, k: int, tag: str, objects: dict[str, str], place: Any) -> str | None:
        """Return the key that names the target of a sensor in documents, or None if they cannot express the sensor."""
        model = self.model
        if tag not in _SENSOR_WORDS or not isinstance(place, CompiledName) or self._sensor_history(k):
            return None
        if place.kind == "body":
            _, link, X_BL = next(
                o for o in self.source.owners.values() if (o[0].name, o[1]) == (place.owner, place.element)
            )
            suits = objects["obj"] == "xbody" and X_BL.is_identity and link == place.element
        else:
            suits = place.kind in ("site", "joint") and not (tag == "rangefinder" and model.sensor_intprm[k][0] > 1)
        suits &= not (tag.startswith("frame") and model.sensor_refid[k] >= 0)
        return {"body": "link"}.get(place.kind, place.kind) if suits else None

    def _sensor_history(self, k: int) -> Data:
        out: Data = {}
        for attribute in ("delay", "interval"):
            values = getattr(self.model, f"sensor_{attribute}", None)
            if values is not None and (value := float(np.ravel(values[k])[0])):
                out[attribute] = value
        history = getattr(self.model, "sensor_history", None)
        if history is not None and history[k][0] > 0:
            out |= {"nsample": int(history[k][0]), "interp": ("zoh", "linear", "cubic")[int(history[k][1])]}
        return out

    def _contact_sensor(self, k: int, target: int, other: int, objects: dict[str, str]) -> Data:
        out: Data = {}
        for n, (key, number) in enumerate((("obj", target), ("ref", other)), 1):
            kind = objects[key]
            if number >= 0 and kind != "unknown":
                reference = "body" if kind in ("xbody", "body") else kind
                attribute = {"xbody": f"subtree{n}", "body": f"body{n}", "geom": f"geom{n}", "site": "site"}[kind]
                out[attribute] = (
                    "world" if reference == "body" and number == 0 else self.places.get((reference, number))
                )
        reduce = int(self.model.sensor_intprm[k][1])
        out["reduce"] = ("none", "mindist", "maxforce", "netforce")[reduce]
        words = ("found", "force", "torque", "dist", "pos", "normal", "tangent")
        out |= self._bits(k, "mjCONDATA_", words, 1)
        sizes = {"found": 1, "force": 3, "torque": 3, "dist": 1, "pos": 3, "normal": 3, "tangent": 3}
        size = sum(sizes[word] for word in str(out.get("data", "found")).split())
        return out | {"num": int(self.model.sensor_dim[k]) // size}

    def _bits(self, k: int, prefix: str, words: tuple[str, ...], default: int) -> Data:
        bits = int(self.model.sensor_intprm[k][0])
        return {} if bits in (0, default) else {"data": " ".join(w for n, w in enumerate(words) if bits >> n & 1)}
