"""Read what only MJCF knows of a model, and the sites, actuators and sensors, into a draft.

All values come from the compiled model, so that defaults, classes and units are resolved. A value is kept if it differs
from MuJoCo's default and the language has no word for it.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from simfoundry.frontends.draft import AttachmentDraft, CompiledName, LinkDraft, PartDraft
from simfoundry.frontends.files import Element
from simfoundry.frontends.mjcf.geoms import HIDDEN_GROUP, MjcfSource
from simfoundry.frontends.names import NameTable
from simfoundry.geometry.frames import Pose

# A model with one element of each kind, whose values are MuJoCo's defaults.
_DEFAULTS = """<mujoco><worldbody><body name="b"><joint name="j"/><geom size="1"/><site name="s"/></body></worldbody>
<tendon><fixed name="t"><joint joint="j" coef="1"/></fixed></tendon><actuator><general joint="j"/></actuator>
<sensor><clock/></sensor><equality><joint joint1="j"/></equality></mujoco>"""

# Attributes by the model field that contains them.
_GEOM = {name: f"geom_{name}" for name in ("contype", "conaffinity", "condim", "priority", "solmix", "solref", "solimp",
                                           "margin", "gap")}  # fmt: skip
_JOINT = {"solreflimit": "jnt_solref", "solimplimit": "jnt_solimp", "margin": "jnt_margin", "group": "jnt_group",
          "actuatorgravcomp": "jnt_actgravcomp"}  # fmt: skip
_DOF = {"solreffriction": "dof_solref", "solimpfriction": "dof_solimp"}
_FREE = {"damping": "dof_damping", "frictionloss": "dof_frictionloss", "armature": "dof_armature"}
_SITE = {"group": "site_group", "rgba": "site_rgba"}
_TENDON = {"group": "tendon_group", "margin": "tendon_margin", "stiffness": "tendon_stiffness",
           "springlength": "tendon_lengthspring", "damping": "tendon_damping", "frictionloss": "tendon_frictionloss",
           "armature": "tendon_armature", "solreflimit": "tendon_solref_lim", "solimplimit": "tendon_solimp_lim",
           "solreffriction": "tendon_solref_fri", "solimpfriction": "tendon_solimp_fri", "width": "tendon_width",
           "rgba": "tendon_rgba"}  # fmt: skip
_OPTION = ("tolerance", "ls_iterations", "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations",
           "ccd_tolerance", "sdf_iterations", "sdf_initpoints", "sleep_tolerance", "impratio", "wind", "magnetic",
           "density", "viscosity", "o_margin", "o_solref", "o_solimp", "o_friction")  # fmt: skip

# The names of types in XML, by the field and the prefix of the enum.
_ENUMS = {"integrator": "Integrator", "cone": "Cone", "jacobian": "Jacobian", "solver": "Solver"}
_SITE_TYPES = ("sphere", "capsule", "ellipsoid", "cylinder", "box")

# Sensors whose names in XML differ from those of their types.
_SENSOR_TAGS = {"jointactfrc": "jointactuatorfrc", "tendonactfrc": "tendonactuatorfrc", "geomdist": "distance",
                "geomnormal": "normal", "geomfromto": "fromto"}  # fmt: skip

# The words of sensors in documents, by the names in XML.
_SENSOR_WORDS = {n: n for n in ("touch", "accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer")} | {
    "rangefinder": "rangefinder", "jointpos": "joint_position", "jointvel": "joint_velocity", "framepos": "position",
    "framequat": "orientation", "framelinvel": "linear_velocity", "frameangvel": "angular_velocity",
}  # fmt: skip

Data = dict[str, Any]


def plain(value: Any) -> Any:
    """Return a value of a model as a number or a tuple of numbers."""
    array = np.asarray(value)
    if array.size == 1:
        value = array.reshape(-1)[0].item()
        return float(value) if isinstance(value, float) else value
    return tuple(array.reshape(-1).tolist())


class NativeReader:
    """A reader of the attributes and elements of a model that the language has no words for."""

    def __init__(self, source: MjcfSource) -> None:
        self.source, self.mujoco, self.model = source, source.mujoco, source.model
        self.usual = source.mujoco.MjModel.from_xml_string(_DEFAULTS)
        self.data: Data = {}
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

    # -- attributes ----------------------------------------------------------------------------------------------------

    def geom(self, geom: int, part: PartDraft) -> None:
        """Keep the attributes of a geom."""
        model, kinds = self.model, self.mujoco.mjtGeom
        native = self.differing(_GEOM, geom)
        group = int(model.geom_group[geom])
        if group != (HIDDEN_GROUP if part.use == "collision" else 0):
            native["group"] = group
        if part.use == "visual":
            native = {key: value for key, value in native.items() if key not in ("contype", "conaffinity")}
        friction = tuple(model.geom_friction[geom].tolist())
        written = (part.contact.get("torsional_friction") or 0.005, part.contact.get("rolling_friction") or 0.0001)
        condim = native.get("condim", 3)
        if part.collides and (friction[1:] != written or condim == 1):
            native["friction"] = friction
        if part.contact.get("torsional_friction") or part.contact.get("rolling_friction"):
            native["condim"] = condim
        fluid = model.geom_fluid[geom]
        if fluid[0] > 0:
            native |= {"fluidshape": "ellipsoid", "fluidcoef": tuple(fluid[1:6].tolist())}
        if (kind := kinds(model.geom_type[geom])) in (kinds.mjGEOM_PLANE, kinds.mjGEOM_ELLIPSOID):
            native["type"] = "plane" if kind == kinds.mjGEOM_PLANE else "ellipsoid"
            native["size"] = tuple(model.geom_size[geom].tolist())
        part.native = native
        owner = self.source.owners.get(int(model.geom_bodyid[geom]))
        if owner is not None:  # the world has no owner
            self.places["geom", geom] = CompiledName("geom", owner[0].name, part)

    def joint(self, joint: int, is_limited: bool) -> Data:
        """Return the attributes of a joint with one axis or a ball joint."""
        model = self.model
        native = self.differing(_JOINT, joint) | self.differing(_DOF, int(model.jnt_dofadr[joint]))
        low, high = model.jnt_actfrcrange[joint].tolist()
        if model.jnt_actfrclimited[joint] and low != -high:
            native["actuatorfrcrange"] = (low, high)
        is_ball = model.jnt_type[joint] == self.mujoco.mjtJoint.mjJNT_BALL
        if is_ball and is_limited:
            native["range"] = plain(model.jnt_range[joint])
        if not is_ball and (reference := float(model.jnt(joint).qpos0[0])):
            native["ref"] = reference
        if model.jnt_type[joint] == self.mujoco.mjtJoint.mjJNT_SLIDE and not is_limited:
            native["limited"] = False
        if is_ball and (stiffness := float(np.ravel(model.jnt_stiffness[joint])[0])):
            native["stiffness"] = stiffness
        return native

    def free_joint(self, joint: int) -> Data:
        """Return the attributes of a free joint."""
        native = self.differing(_FREE | _DOF, int(self.model.jnt_dofadr[joint]))
        native = {key: value[0] if key in _FREE and isinstance(value, tuple) else value for key, value in native.items()}
        if stiffness := float(np.ravel(self.model.jnt_stiffness[joint])[0]):
            native["stiffness"] = stiffness
        return native

    def body(self, body: int, link: LinkDraft, X_LB: Pose) -> None:
        """Keep the attributes of a body whose frame has the pose ``X_LB`` in the link."""
        model = self.model
        if any(X_LB.p):
            link.native["pos"] = tuple(X_LB.p.tolist())
        if model.body_gravcomp[body]:
            link.native["gravcomp"] = float(model.body_gravcomp[body])
        if model.body_mocapid[body] >= 0:
            link.native["mocap"] = True

    # -- elements ------------------------------------------------------------------------------------------------------

    def read(self, roots: list[Element]) -> Data:
        """Add the attachments to the draft, and return the native data of the scene."""
        self._bodies_and_joints()
        self._options(roots)
        self._sites()
        self._pairs()
        self._tendons()
        self._equalities()
        self._actuators()
        self._sensors()
        self._custom()
        self._keyframes()
        return self.data

    def add(self, section: str, tag: str, **attributes: Any) -> None:
        """Add an element to a section; attributes that are None are omitted."""
        element = {tag: {key: value for key, value in attributes.items() if value is not None}}
        self.data.setdefault(section, []).append(element)

    def ref(self, kind: str, number: int) -> Any:
        """Return how native data refers to an element."""
        return "world" if kind == "body" and number == 0 else self.places[kind, number]

    def _bodies_and_joints(self) -> None:
        source = self.source
        for body, (owner, link, _) in source.owners.items():
            self.places["body", body] = CompiledName("body", owner.name, link)
        for joint, (owner, draft) in source.joints.items():
            self.places["joint", joint] = CompiledName("joint", owner.name, draft.name)
        for joint in np.flatnonzero(self.model.jnt_type == self.mujoco.mjtJoint.mjJNT_FREE).tolist():
            owner, link, _ = source.owners[int(self.model.jnt_bodyid[joint])]
            self.places["joint", joint] = CompiledName("body", owner.name, link)  # it has the name of the object
        for k in range(self.model.ncam):
            name = self.source.name("camera", k) or f"camera_{k}"
            if any(camera.name == name for camera in self.source.draft.cameras):
                self.places["camera", k] = CompiledName("camera", "", name)

    def _options(self, roots: list[Element]) -> None:
        option, usual = self.model.opt, self.usual.opt
        self.source.draft.options["timestep"] = float(option.timestep)
        if option.iterations != usual.iterations:
            self.source.draft.options["solver_iterations"] = int(option.iterations)
        found: Data = {}
        for name, enum in _ENUMS.items():
            if (value := getattr(option, name)) != getattr(usual, name):
                prefix = {"integrator": "mjINT_", "cone": "mjCONE_", "jacobian": "mjJAC_", "solver": "mjSOL_"}[name]
                text = getattr(self.mujoco, f"mjt{enum}")(value).name.removeprefix(prefix)
                found[name] = {"NEWTON": "Newton"}.get(text, text if name in ("integrator", "solver") else text.lower())
                if name == "integrator" and text not in ("RK4",):
                    found[name] = {"EULER": "Euler"}.get(text, text.lower())
        found |= {n: plain(getattr(option, n)) for n in _OPTION if hasattr(option, n)
                  and not np.array_equal(getattr(option, n), getattr(usual, n))}  # fmt: skip
        if option.disableactuator:
            found["actuatorgroupdisable"] = tuple(k for k in range(31) if option.disableactuator >> k & 1)
        flags: Data = {}
        for prefix, field, state in (("mjDSBL_", "disableflags", False), ("mjENBL_", "enableflags", True)):
            kinds = self.mujoco.mjtDisableBit if prefix == "mjDSBL_" else self.mujoco.mjtEnableBit
            changed = int(getattr(option, field)) ^ int(getattr(usual, field))
            for bit in (kind for kind in kinds.__members__.values() if kind.name.startswith(prefix)):
                if changed & bit.value:
                    flags[bit.name.removeprefix(prefix).lower()] = state is bool(getattr(option, field) & bit.value)
        given: Data = {}
        for element in (e for root in roots for e in root.walk() if e.tag == "statistic"):
            given |= {key: _numbers(text) for key, text in element.attributes.items()}
        self.data |= {k: v for k, v in (("option", found), ("flag", flags), ("statistic", given)) if v}
        if self.model.nuserdata:
            self.data["size"] = {"nuserdata": int(self.model.nuserdata)}

    def _sites(self) -> None:
        model = self.model
        for k, body in enumerate(model.site_bodyid.tolist()):
            name = self.source.name("site", k) or f"site_{k}"
            native = self.differing(_SITE, k)
            kind = self.mujoco.mjtGeom(model.site_type[k]).name.removeprefix("mjGEOM_").lower()
            if kind != "sphere" and kind in _SITE_TYPES:
                native["type"] = kind
            size = tuple(model.site_size[k].tolist())
            if size != tuple(self.usual.site_size[0].tolist()):
                native["size"] = size
            X_BS = Pose.of(model.site_pos[k], model.site_quat[k])
            if body == 0:
                called = self.names["site"].name(name)
                pos, quat = tuple(X_BS.p.tolist()), tuple(X_BS.q.tolist())
                self.add("worldbody", "site", name=called, pos=pos, quat=quat, **native)
                self.places["site", k] = called
                continue
            owner, link, X_BL = self.source.owners[body]
            data: Data = _posed(X_BL.inverse() @ X_BS) | _native(native)
            owner.sites.append(AttachmentDraft(name, data, "link", link))
            self.places["site", k] = CompiledName("site", owner.name, name)

    def _pairs(self) -> None:
        model = self.model
        for k in range(model.npair):
            friction, reference = tuple(model.pair_friction[k].tolist()), plain(model.pair_solreffriction[k])
            ends = {f"geom{n}": self.places.get(("geom", int(getattr(model, f"pair_geom{n}")[k]))) for n in (1, 2)}
            if None in ends.values():
                self.source.draft.dropped(f"contact pair {self.source.label('pair', k)}", "its geom is not imported")
                continue
            self.add("contact", "pair", **ends, condim=int(model.pair_dim[k]), friction=friction,
                     margin=float(model.pair_margin[k]), gap=float(model.pair_gap[k]), solref=plain(model.pair_solref[k]),
                     solimp=plain(model.pair_solimp[k]), solreffriction=reference if any(reference) else None)  # fmt: skip

        for one, two in self.excluded:
            self.add("contact", "exclude", body1=self.ref("body", one), body2=self.ref("body", two))

    def exclude(self, one: int, two: int) -> None:
        """Keep a pair of bodies that do not collide."""
        self.excluded.append((one, two))

    def _tendons(self) -> None:
        model, wraps = self.model, self.mujoco.mjtWrap
        for k in range(model.ntendon):
            name = self.places["tendon", k] = self.names["tendon"].name(self.source.name("tendon", k) or f"tendon_{k}")
            path: list[Data] = []
            is_fixed = False
            for w in range(int(model.tendon_adr[k]), int(model.tendon_adr[k] + model.tendon_num[k])):
                kind, target, value = model.wrap_type[w], int(model.wrap_objid[w]), float(model.wrap_prm[w])
                if kind == wraps.mjWRAP_JOINT:
                    is_fixed = True
                    path.append({"joint": {"joint": self.ref("joint", target), "coef": value}})
                elif kind == wraps.mjWRAP_SITE:
                    path.append({"site": {"site": self.ref("site", target)}})
                elif kind == wraps.mjWRAP_PULLEY:
                    path.append({"pulley": {"divisor": value}})
                else:
                    side = {"sidesite": self.ref("site", round(value))} if value >= 0 else {}
                    path.append({"geom": {"geom": self.ref("geom", target)} | side})
            native = self.differing(_TENDON, k)
            if is_fixed:
                native = {key: value for key, value in native.items() if key not in ("width", "rgba")}
            if "stiffness" in native:
                native["stiffness"] = float(np.ravel(model.tendon_stiffness[k])[0])
            if "damping" in native:
                native["damping"] = float(np.ravel(model.tendon_damping[k])[0])
            native["springlength"] = plain(model.tendon_lengthspring[k])
            if model.tendon_limited[k]:
                native |= {"limited": True, "range": plain(model.tendon_range[k])}
            if model.tendon_actfrclimited[k]:
                native |= {"actuatorfrclimited": True, "actuatorfrcrange": plain(model.tendon_actfrcrange[k])}
            self.add("tendon", "fixed" if is_fixed else "spatial", name=name, **native, path=path)

    def _equalities(self) -> None:
        model, kinds, objects = self.model, self.mujoco.mjtEq, self.mujoco.mjtObj
        order: list[Any] = []
        for k in range(model.neq):
            kind, data = kinds(model.eq_type[k]), model.eq_data[k]
            one, two = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            native = self.differing({"solref": "eq_solref", "solimp": "eq_solimp"}, k)
            if kind == kinds.mjEQ_JOINT and one in self.source.joints:
                owner, draft = self.source.joints[one]
                if k in self.source.mimics:
                    draft.native |= {"equality": native} if native else {}
                    order.append(CompiledName("joint", owner.name, draft.name))
                    continue
            name = self.source.name("equality", k) or f"equality_{k}"
            given: Data = {"name": name} | ({} if model.eq_active0[k] else {"active": False}) | native
            order.append(name)
            tag = kind.name.removeprefix("mjEQ_").lower()
            if tag in ("joint", "tendon"):
                ends = {f"{tag}1": self.ref(tag, one), f"{tag}2": self.ref(tag, two) if two >= 0 else None}
                self.add("equality", tag, **given, **ends, polycoef=tuple(data[:5].tolist()))
                continue
            if tag not in ("connect", "weld"):
                self.source.draft.dropped(f"{tag} equality `{name}`", "flexible bodies are not imported")
                order.pop()
                continue
            place = "body" if model.eq_objtype[k] == objects.mjOBJ_BODY else "site"
            given |= {f"{place}1": self.ref(place, one), f"{place}2": self.ref(place, two)}
            if place == "body":
                given["anchor"] = tuple(data[:3].tolist())
                if tag == "weld" and not (len(data) > 11 and data[11]):  # otherwise, it follows from the poses
                    given["relpose"] = tuple(data[3:10].tolist())
            if tag == "weld":
                given["torquescale"] = float(data[10])
            self.add("equality", tag, **given)
        self._keep_order("equality", order)

    def _keep_order(self, section: str, order: list[Any]) -> None:
        """Keep the order of a section if it contains both words and native elements, or elements of several objects."""
        words = [each for each in order if isinstance(each, CompiledName)]
        if words and order:
            self.data.setdefault("order", {})[section] = tuple(order)

    # -- actuators -----------------------------------------------------------------------------------------------------

    def _actuators(self) -> None:
        model, order, controls, outside = self.model, [], [], False
        for k in range(len(model.actuator_trntype)):
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
        self._keep_order("actuator", order)
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
        return word | _native({"group": group} if group else {})

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

    # -- sensors -------------------------------------------------------------------------------------------------------

    def _sensors(self) -> None:
        order: list[Any] = []
        for k in range(self.model.nsensor):
            name = self.source.name("sensor", k) or f"sensor_{k}"
            if not self._sensor(k, name):
                self.source.draft.dropped(f"sensor `{name}`", "its kind or its target is not imported")
                continue
            order.append(self.places["sensor", k])
        self._keep_order("sensor", order)

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
        if word is not None:
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
            _, link, X_BL = next(o for o in self.source.owners.values() if (o[0].name, o[1]) == (place.owner, place.element))
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
                out[attribute] = "world" if reference == "body" and number == 0 else self.places.get((reference, number))
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

    # -- other sections ------------------------------------------------------------------------------------------------

    def _custom(self) -> None:
        model = self.model
        for k in range(model.nnumeric):
            numeric = model.numeric(k)
            self.add("custom", "numeric", name=numeric.name, data=tuple(numeric.data.tolist()))

    def _keyframes(self) -> None:
        """Keep what the document does not say of the first keyframe, and all other keyframes."""
        model = self.model
        positions = {j: float(self.source.data.qpos[model.jnt_qposadr[j]]) for j in self.source.joints}
        if any(positions[j] != d.position for j, (_, d) in self.source.joints.items() if d.type != "ball"):
            self.data["initial"] = {"qpos": tuple(self.source.data.qpos.tolist())}  # a joint begins beyond its limits
        for k in range(model.nkey):
            state: Data = {"qpos": model.key_qpos[k], "qvel": model.key_qvel[k], "act": model.key_act[k],
                           "ctrl": model.key_ctrl[k], "mpos": model.key_mpos[k], "mquat": model.key_mquat[k]}  # fmt: skip
            found = {key: tuple(np.ravel(value).tolist()) for key, value in state.items() if np.size(value)}
            if k == 0:
                extra = {key: v for key, v in found.items() if key in ("qvel", "act") and any(v)}
                extra |= {key: v for key, v in found.items() if key in ("mpos", "mquat")}
                if extra:
                    self.data.setdefault("initial", {}).update(extra)
                continue
            name = self.source.name("key", k) or f"keyframe_{k}"
            self.add("keyframe", "key", name="initial_2" if name == "initial" else name, **self._time(k), **found)

    def _time(self, k: int) -> Data:
        return {"time": float(self.model.key_time[k])} if self.model.key_time[k] else {}


def _native(data: Data) -> Data:
    return {"native": {"mjcf": data}} if data else {}


def _posed(X_LS: Pose) -> Data:
    from simfoundry.frontends.documents import pose_data

    return {"pose": data} if (data := pose_data(X_LS)) else {}


def _numbers(text: str) -> Any:
    values = [float(word) for word in text.split()]
    return values[0] if len(values) == 1 else tuple(values)

