"""Read what only MJCF knows of a model, and the sites, actuators and sensors, into a draft.

All values come from the compiled model, so that defaults, classes and units are resolved. A value is kept if it differs
from MuJoCo's default and the language has no word for it.
"""

from __future__ import annotations

from typing import Any

import numpy as np

from simfoundry.backends.artifact import NOISE
from simfoundry.frontends.document_data import Data
from simfoundry.frontends.draft import BodyDraft, CompiledName, JointDraft, LinkDraft, PartDraft
from simfoundry.frontends.files import Element
from simfoundry.frontends.mjcf.actuators import ActuatorReader
from simfoundry.frontends.mjcf.constraints import ConstraintReader
from simfoundry.frontends.mjcf.geoms import HIDDEN_GROUP, height_field_extents
from simfoundry.frontends.mjcf.native_state import exact_values, is_angle_stated, plain
from simfoundry.frontends.mjcf.sensors import SensorReader
from simfoundry.geometry.frames import Pose

# Attributes by the model field that contains them.
_GEOM = {name: f"geom_{name}" for name in ("contype", "conaffinity", "condim", "priority", "solmix", "solref", "solimp",
                                           "margin", "gap")}  # fmt: skip
_JOINT = {"solreflimit": "jnt_solref", "solimplimit": "jnt_solimp", "margin": "jnt_margin", "group": "jnt_group",
          "actuatorgravcomp": "jnt_actgravcomp"}  # fmt: skip
_DOF = {"solreffriction": "dof_solref", "solimpfriction": "dof_solimp"}
_FREE = {"damping": "dof_damping", "frictionloss": "dof_frictionloss", "armature": "dof_armature"}
_OPTION = ("tolerance", "ls_iterations", "ls_tolerance", "noslip_iterations", "noslip_tolerance", "ccd_iterations",
           "ccd_tolerance", "sdf_iterations", "sdf_initpoints", "sleep_tolerance", "impratio", "wind", "magnetic",
           "density", "viscosity", "o_margin", "o_solref", "o_solimp", "o_friction")  # fmt: skip

# The names of types in XML, by the field and the prefix of the enum.
_ENUMS = {"integrator": "Integrator", "cone": "Cone", "jacobian": "Jacobian", "solver": "Solver"}


class NativeReader(ActuatorReader, SensorReader, ConstraintReader):
    """A reader of the attributes and elements of a model that the language has no words for."""

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
        if kind == kinds.mjGEOM_HFIELD:
            native |= {"type": "hfield", "hfield": self._height_field(int(model.geom_dataid[geom]))}
            native["top"] = height_field_extents(model, int(model.geom_dataid[geom]))[2]
        if kind in (kinds.mjGEOM_MESH, kinds.mjGEOM_SDF):
            native["mesh_inertia"] = self.mesh_inertia.get(
                self.source.name("mesh", int(model.geom_dataid[geom])), "legacy"
            )
        elif part.use != "visual":  # MuJoCo moves meshes, and parts that are only visible have no effect
            is_plane = kind == kinds.mjGEOM_PLANE
            size = {} if is_plane or "size" in native else {"size": self._size(geom)}
            native |= exact_values(pos=model.geom_pos[geom], quat=model.geom_quat[geom], **size)
        part.native = native
        owner = self.source.owners.get(int(model.geom_bodyid[geom]))
        if owner is not None:  # the world has no owner
            self.places["geom", geom] = CompiledName("geom", owner[0].name, part)

    def _height_field(self, field: int) -> str:
        """Keep the heights of a height field, and return its name."""
        model, name = self.model, self.source.name("hfield", field) or f"hfield_{field}"
        start, shape = int(model.hfield_adr[field]), (int(model.hfield_nrow[field]), int(model.hfield_ncol[field]))
        heights = model.hfield_data[start : start + shape[0] * shape[1]]
        if not any(element["hfield"]["name"] == name for element in self.data.get("asset", ())):
            # MuJoCo's files list the rows from the last to the first; a flat field needs no list.
            rows = tuple(heights.reshape(shape)[::-1].ravel().tolist()) if heights.any() else None
            size = tuple(model.hfield_size[field].tolist())
            self.add("asset", "hfield", name=name, nrow=shape[0], ncol=shape[1], size=size, elevation=rows)
        return name

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
        native |= self._exact_joint(joint)
        if not is_ball and (reference := float(model.jnt(joint).qpos0[0])):
            native["ref"] = reference
        if model.jnt_type[joint] == self.mujoco.mjtJoint.mjJNT_SLIDE and not is_limited:
            native["limited"] = False
        if is_ball and (stiffness := float(np.ravel(model.jnt_stiffness[joint])[0])):
            native["stiffness"] = stiffness
        return native

    def inertial(self, body: int) -> Data:
        """Return the attributes of a body's inertia."""
        fields = {"mass": "mass", "pos": "ipos", "quat": "iquat", "diaginertia": "inertia"}
        return {key: plain(getattr(self.model, f"body_{field}")[body]) for key, field in fields.items()}

    def _size(self, geom: int) -> Any:
        """Return the sizes that a primitive has."""
        kinds = self.mujoco.mjtGeom
        counts = {kinds.mjGEOM_SPHERE: 1, kinds.mjGEOM_CAPSULE: 2, kinds.mjGEOM_CYLINDER: 2}
        return self.model.geom_size[geom][: counts.get(kinds(self.model.geom_type[geom]), 3)]

    def _exact_joint(self, joint: int) -> Data:
        """Return the exact values of a joint, except for those that the document states to the last bit."""
        model, dof, kinds = self.model, int(self.model.jnt_dofadr[joint]), self.mujoco.mjtJoint
        kind, limits = model.jnt_type[joint], model.jnt_range[joint]
        values = {"pos": model.jnt_pos[joint]} | {key: np.ravel(getattr(model, f"dof_{key}")[dof])[0] for key in _FREE}
        if kind in (kinds.mjJNT_HINGE, kinds.mjJNT_SLIDE):
            values["axis"] = model.jnt_axis[joint]
        found = exact_values(**values)
        if model.jnt_limited[joint] and kind == kinds.mjJNT_SLIDE:
            found = exact_values(**values, range=limits)
        elif model.jnt_limited[joint] and kind == kinds.mjJNT_HINGE and not all(map(is_angle_stated, limits.tolist())):
            found = {"exact": found.get("exact", {}) | {"range": plain(limits)}}
        return found

    def free_joint(self, joint: int) -> Data:
        """Return the attributes of a free joint."""
        native = self.differing(_FREE | _DOF, int(self.model.jnt_dofadr[joint]))
        native = {
            key: value[0] if key in _FREE and isinstance(value, tuple) else value for key, value in native.items()
        }
        if stiffness := float(np.ravel(self.model.jnt_stiffness[joint])[0]):
            native["stiffness"] = stiffness
        return native

    def body(self, body: int, link: LinkDraft, X_LB: Pose) -> None:
        """Keep the attributes of a body whose frame has the pose ``X_LB`` in the link."""
        model = self.model
        if any(X_LB.p):
            link.native["pos"] = tuple(X_LB.p.tolist())
        found = exact_values(pos=model.body_pos[body], quat=model.body_quat[body]).get("exact", {})
        inertial = self.inertial(body)
        if link.mass and exact_values(**inertial):
            found["inertial"] = inertial
        link.native |= {"exact": found} if found else {}
        if model.body_gravcomp[body] != link.gravity_compensation:  # beyond the range of documents
            link.native["gravcomp"] = float(model.body_gravcomp[body])
        if model.body_mocapid[body] >= 0:
            link.native["mocap"] = True

    def read(self, roots: list[Element]) -> Data:
        """Add the attachments to the draft, and return the native data of the scene."""
        self._bodies_and_joints()
        self._options(roots)
        self.read_sites()
        self.read_pairs()
        self.read_tendons()
        self.read_equalities()
        self.read_actuators()
        self.read_sensors()
        self._custom()
        self._keyframes()
        return self.data

    def read_attachments(self) -> None:
        """Add the sites, actuators and sensors of a compiled file to the draft, and record others as dropped."""
        self._bodies_and_joints()
        self.read_sites()
        self.read_actuators()
        self.read_sensors()
        for section in ("worldbody", "actuator", "sensor"):
            for element in self.data.get(section, ()):
                ((tag, attributes),) = element.items()
                self.source.draft.inexpressible(f"{tag} `{attributes['name']}`")

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

    def _custom(self) -> None:
        model = self.model
        for k in range(model.nnumeric):
            numeric = model.numeric(k)
            self.add("custom", "numeric", name=numeric.name, data=tuple(numeric.data.tolist()))

    def _keyframes(self) -> None:
        """Keep what the document does not say of the first keyframe, and all other keyframes."""
        model = self.model
        positions = {j: float(self.source.data.qpos[model.jnt_qposadr[j]]) for j in self.source.joints}
        joints = {j: (owner, d) for j, (owner, d) in self.source.joints.items() if d.type != "ball"}
        if any(not _is_written(owner, d, positions[j]) for j, (owner, d) in joints.items()):
            self.data["initial"] = {"qpos": tuple(self.source.data.qpos.tolist())}
        for k in range(model.nkey):
            names = ("qpos", "qvel", "act", "ctrl", "mpos", "mquat")
            state = {name: getattr(model, f"key_{name}")[k] for name in names}
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


def _is_written(owner: BodyDraft, joint: JointDraft, position: float) -> bool:
    """Return False if a document places the joint elsewhere, at its limit or where it follows its leader."""
    if joint.mimic is None:
        return joint.position == position
    leader = next(j for j in owner.joints if j.name == joint.mimic.joint)
    return leader.mimic is None and abs(joint.mimic.position(leader.position) - position) < NOISE


def _numbers(text: str) -> Any:
    values = [float(word) for word in text.split()]
    return values[0] if len(values) == 1 else tuple(values)
