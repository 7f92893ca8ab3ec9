"""Read the actuators of a model, in the words of documents where these suffice."""

from __future__ import annotations

import math

import numpy as np

from simfoundry.frontends.document_data import Data, native_data
from simfoundry.frontends.draft import AttachmentDraft, CompiledName
from simfoundry.frontends.mjcf.native_state import NativeState, plain


class ActuatorReader(NativeState):
    """A reader of actuators."""

    def read_actuators(self) -> None:
        """Add the actuators to the draft or to the native data."""
        model, order, controls, outside = self.model, [], [], False
        for k in range(len(model.actuator_trntype)):
            if self.source.is_drive(k):
                continue
            name = self.source.name("actuator", k) or f"actuator_{k}"
            control = float(self.source.data.ctrl[k]) if k < model.nu else 0.0
            controls.append(control)
            word = self._actuator_word(k)
            joint = int(model.actuator_trnid[k, 0])
            if word is not None:
                owner, draft = self.source.joints[joint]
                low, high = word.get("control_range", (-math.inf, math.inf))
                if not low <= control <= high:
                    outside = True
                    control = min(max(control, low), high)
                data = word | ({"control": control} if control else {})
                owner.actuators.append(AttachmentDraft(name, data, "joint", draft.name))
                self.places["actuator", k] = CompiledName("actuator", owner.name, name)
            else:
                self.places["actuator", k] = called = self.names["actuator"].name(name)
                self.add("actuator", "general", name=called, **self._general(k))
            order.append(self.places["actuator", k])
        self.keep_order("actuator", order)
        if outside or any(c for c, place in zip(controls, order, strict=True) if isinstance(place, str)):
            self.data.setdefault("initial", {})["ctrl"] = tuple(controls)

    def _actuator_word(self, k: int) -> Data | None:
        """Return an actuator in the words of documents, or None if they do not suffice."""
        model, mujoco = self.model, self.mujoco
        joint, gear = int(model.actuator_trnid[k, 0]), model.actuator_gear[k]
        is_simple = (
            model.actuator_trntype[k] == mujoco.mjtTrn.mjTRN_JOINT
            and joint in self.source.joints
            and self.source.joints[joint][1].type != "ball"
            and model.actuator_dyntype[k] == mujoco.mjtDyn.mjDYN_NONE
            and model.actuator_gaintype[k] == mujoco.mjtGain.mjGAIN_FIXED
            and mujoco.mjtBias(model.actuator_biastype[k]) in (mujoco.mjtBias.mjBIAS_NONE, mujoco.mjtBias.mjBIAS_AFFINE)
            and not (gear[1:].any() or model.actuator_gainprm[k][1:].any() or model.actuator_actlimited[k])
            and not self._modern(k)
        )
        if not is_simple:
            return None
        gain, bias = float(model.actuator_gainprm[k][0]), model.actuator_biasprm[k]
        affine = model.actuator_biastype[k] == mujoco.mjtBias.mjBIAS_AFFINE
        kp, kv = -float(bias[1]), -float(bias[2])
        if not affine and gain == 1:
            word: Data = {"type": "motor"}
        elif affine and bias[0] == 0 and gain == kp > 0 and kv >= 0:
            word = {"type": "position", "kp": kp} | ({"kv": kv} if kv else {})
        elif affine and bias[0] == 0 and kp == 0 and gain == kv > 0:
            word = {"type": "velocity", "kv": kv}
        else:
            return None
        if gear[0] != 1:
            word["gear"] = float(gear[0])
        for key, field in (("control_range", "ctrl"), ("force_range", "force")):
            if getattr(model, f"actuator_{field}limited")[k]:
                word[key] = plain(getattr(model, f"actuator_{field}range")[k])
        group = int(model.actuator_group[k])
        return word | native_data({"group": group} if group else {})

    def _modern(self, k: int) -> Data:
        """Return the attributes of an actuator that newer versions of MuJoCo have."""
        out: Data = {}
        for attribute, name in (("armature", "actuator_armature"), ("damping", "actuator_damping"),
                                ("delay", "actuator_delay")):  # fmt: skip
            if hasattr(self.model, name) and (value := float(np.ravel(getattr(self.model, name)[k])[0])):
                out[attribute] = value
        history = getattr(self.model, "actuator_history", None)
        if history is not None and history[k][0] > 0:
            out |= {"nsample": int(history[k][0]), "interp": ("zoh", "linear", "cubic")[int(history[k][1])]}
        return out

    def _general(self, k: int) -> Data:
        """Return the attributes of an actuator of any kind."""
        model, mujoco = self.model, self.mujoco
        kind, (one, two) = mujoco.mjtTrn(model.actuator_trntype[k]), model.actuator_trnid[k].tolist()
        tag = kind.name.removeprefix("mjTRN_").lower()
        out: Data = {}
        if tag == "slidercrank":
            out = {"cranksite": self.ref("site", one), "slidersite": self.ref("site", two),
                   "cranklength": float(model.actuator_cranklength[k])}  # fmt: skip
        elif tag == "site":
            out = {"site": self.ref("site", one), "refsite": self.ref("site", two) if two >= 0 else None}
        elif tag in ("joint", "jointinparent", "tendon", "body"):
            out = {tag: self.ref("joint" if tag == "jointinparent" else tag, one)}
        for field, default in (("dyn", "none"), ("gain", "fixed"), ("bias", "none")):
            enum = getattr(mujoco, f"mjt{field.capitalize()}")(getattr(model, f"actuator_{field}type")[k])
            text = enum.name.rpartition("_")[2].lower()
            values = np.trim_zeros(getattr(model, f"actuator_{field}prm")[k], "b").tolist() or [0.0]
            out |= {} if text == default else {f"{field}type": text}
            if values != ([0.0] if field == "bias" else [1.0]):
                out[f"{field}prm"] = tuple(values)
        gear = np.trim_zeros(model.actuator_gear[k], "b").tolist() or [0.0]
        out |= {} if gear == [1.0] else {"gear": tuple(gear)}
        for field in ("ctrl", "force", "act"):
            if getattr(model, f"actuator_{field}limited")[k]:
                out |= {f"{field}limited": True, f"{field}range": plain(getattr(model, f"actuator_{field}range")[k])}
        if model.actuator_lengthrange[k].any():
            out["lengthrange"] = plain(model.actuator_lengthrange[k])
        if "user" in (out.get("dyntype"),):
            out["actdim"] = int(model.actuator_actnum[k])
        if model.actuator_actearly[k]:
            out["actearly"] = True
        if group := int(model.actuator_group[k]):
            out["group"] = group
        return out | self._modern(k)
