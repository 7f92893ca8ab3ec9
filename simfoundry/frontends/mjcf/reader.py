"""Read MJCF files, which MuJoCo compiles so that defaults, includes and frames are interpreted correctly."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, CompiledName, ImportOptions, JointDraft, LinkDraft, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import Element, FileSearch, NotFoundError, missing_file, read_xml
from simfoundry.frontends.mass_repair import feather_link, inertia_of_moments, repair_masses
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.mjcf.axes import common_anchor
from simfoundry.frontends.mjcf.compiled import BACKGROUND, custom_fields, restore, take_robots
from simfoundry.frontends.mjcf.elements import add_elements
from simfoundry.frontends.mjcf.geoms import MjcfGeoms, MjcfSource
from simfoundry.frontends.mjcf.native import NativeReader
from simfoundry.frontends.names import free_name
from simfoundry.geometry.frames import IDENTITY, Pose

# Maximum number of included files, which stops infinite chains; public models include at most a tenth of that.
MAX_INCLUDES = 100

# Model fields that the importer reads and that must be finite; MuJoCo accepts NaN in most of them.
_NUMBERS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "geom_pos", "geom_quat",
    "geom_size", "geom_user", "geom_friction", "geom_rgba", "geom_solref", "mat_rgba", "mesh_vert", "mesh_pos",
    "mesh_quat", "mesh_texcoord", "jnt_pos", "jnt_axis", "jnt_range", "jnt_actfrcrange", "jnt_stiffness",
    "qpos0", "qpos_spring", "key_qpos", "key_ctrl", "dof_damping", "dof_frictionloss", "dof_armature",
    "actuator_gainprm", "actuator_biasprm",
    "actuator_forcerange", "actuator_gear", "cam_pos", "cam_quat", "cam_fovy", "cam_intrinsic", "cam_sensorsize",
    "light_pos", "light_dir", "light_diffuse", "light_cutoff",
)  # fmt: skip

# Element kinds by field prefix, for prefixes that differ from the name of the kind.
_KINDS = {"jnt": "joint", "mat": "material", "cam": "camera"}

# Minimum length of vectors with a direction; MuJoCo normalizes all longer vectors.
NO_LENGTH = 1e-9

# Products of inertia below this fraction of the trace are rounding noise from rotating the axes.
NOISE = 1e-12


def read_mjcf(path: Path, options: ImportOptions) -> ModelDraft:
    """Read the scene in an MJCF file.

    Raises:
        ImportRefusedError: If the file cannot be imported. If MuJoCo rejects the file, the error includes MuJoCo's
            message.
    """
    import mujoco

    if options.density is not None:
        message = "`--density` does not apply to MJCF, because every geom has a density; MuJoCo provides a default"
        hint = "remove `--density`, and add `<default><geom density=…/></default>` to the file instead"
        raise ImportRefusedError(path, message, 0, hint)
    roots = _checked_files(path, options.packages)
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise ImportRefusedError(path, f"MuJoCo rejects the file: {reason[:300]}") from None
    _check_numbers(path, mujoco, model, roots)
    return _MjcfReader(path, mujoco, model, roots).read()


def _checked_files(path: Path, packages: Mapping[str, Path]) -> list[Element]:
    """Return the XML roots of a file and of the files that it includes.

    All referenced files must be in the model's folders.
    """
    search = FileSearch(path, packages)
    roots: list[Element] = []
    waiting = [path]
    while waiting:
        file = waiting.pop()
        if len(roots) > MAX_INCLUDES:
            raise ImportRefusedError(path, f"the model includes more than {MAX_INCLUDES} files")
        root = read_xml(file)
        roots.append(root)
        includes = (element for element in root.walk() if element.tag == "include")
        waiting += [search.need(e.need("file"), file, e.line, path.resolve().parent) for e in includes]
    elements = [element for root in roots for element in root.walk()]
    names = {e.get(name) for e in elements for name in ("assetdir", "meshdir", "texturedir")}
    folders = [Path(), *(Path(name) for name in names if name)]
    for element in elements:
        if element.tag in ("mesh", "texture", "hfield", "skin", "model", "flexcomp") and element.get("file"):
            _check_file(search, path, element, folders)
        elif element.tag == "plugin":
            raise element.refused("the model requires a plugin, which would execute code", "remove this element")
    return roots


def _check_file(search: FileSearch, path: Path, element: Element, folders: list[Path]) -> None:
    """Raise an error if a referenced file is missing or outside the allowed folders."""
    reference, missing = element.need("file"), NotFoundError("does not exist")
    beside = dict.fromkeys((path.resolve().parent, element.file.resolve().parent))  # MuJoCo searches both
    for here, folder in itertools.product(beside, folders):
        try:
            search.find((folder / reference).as_posix(), here)
            return
        except NotFoundError as error:
            if "outside" in str(error):
                missing = error
                break
    raise missing_file(element.file, element.line, reference, missing)


def _check_numbers(path: Path, mujoco: Any, model: Any, roots: list[Element]) -> None:
    """Raise an error if the model contains non-finite numbers, or rotations or axes of zero length."""
    for field in _NUMBERS:
        rows = np.asarray(getattr(model, field), dtype=np.float64)
        rows = rows.reshape(len(rows), math.prod(rows.shape[1:]))
        bad, problem = ~np.isfinite(rows).all(axis=1), "is not finite"
        if field.endswith("quat"):
            bad, problem = bad | (np.linalg.norm(rows, axis=1) < NO_LENGTH), "is not a valid rotation"
        elif field == "jnt_axis":
            moves = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)))
            bad, problem = bad | (moves & (np.linalg.norm(rows, axis=1) < NO_LENGTH)), "is not a valid direction"
        if bad.any():
            number = int(np.argmax(bad))
            prefix, _, word = field.partition("_")
            kind = getattr(mujoco.mjtObj, f"mjOBJ_{_KINDS.get(prefix, prefix).upper()}", None)
            name = None if kind is None else mujoco.mj_id2name(model, kind, number)
            line = next((e.line for root in roots for e in root.walk() if name and e.get("name") == name), 0)
            what = f"`{name}`" if name else f"number {number + 1}"
            shown = " ".join(f"{v:g}" for v in rows[number, :4])
            message = f"the {word or 'value'} of {_KINDS.get(prefix, prefix)} {what} {problem}: {shown}"
            raise ImportRefusedError(path, message, line, "check its numbers")


class _MjcfReader:
    """A converter from a compiled model to a draft."""

    def __init__(self, path: Path, mujoco: Any, model: Any, roots: list[Element]) -> None:
        self.path, self.mujoco, self.roots = path, mujoco, roots
        name = roots[0].get("model") or path.stem
        self.draft = ModelDraft(name if name != "MuJoCo Model" else path.stem, "MJCF")
        self.own = custom_fields(mujoco, model)
        self.model = model = model if self.own is None else take_robots(self.draft, path, mujoco, model, self.own)
        self.data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, self.data, 0)
            mujoco.mj_normalizeQuat(model, self.data.qpos)  # turns a zero quaternion into the identity
            free = model.jnt_qposadr[model.jnt_type == mujoco.mjtJoint.mjJNT_FREE] if self.own is not None else []
            for start in free:  # in compiled files, the pose of a free body can be edited at the body
                self.data.qpos[start : start + 7] = model.qpos0[start : start + 7]
        mujoco.mj_kinematics(model, self.data)
        self.source = MjcfSource(mujoco, model, self.data, self.draft, self.own is not None)
        self.geoms = MjcfGeoms(self.source)
        self.native = NativeReader(self.source, roots) if self.own is None else None
        self.free_joints: dict[str, str] = {}  # names of free joints, by body name
        self.taken: dict[str, set[str]] = {}
        self.names = {"body": self.element_names("body", model.nbody), "joint": self.element_names("joint", model.njnt)}

    def element_names(self, kind: str, count: int) -> list[str]:
        """Return a unique name for each element of a kind.

        Unnamed elements are named after their kind and number.
        """
        own = [self.source.name(kind, k) for k in range(count)]
        self.taken[kind] = set(own)
        return [name or self.new_name(kind, f"{kind}_{k}") for k, name in enumerate(own)]

    def new_name(self, kind: str, wish: str) -> str:
        """Return and reserve a unique name based on ``wish`` for an additional link or joint."""
        name = free_name(wish, self.taken[kind])
        self.taken[kind].add(name)
        return name

    def read(self) -> ModelDraft:
        model = self.model
        self.draft.gravity = tuple(model.opt.gravity.tolist())
        self.world()
        for body in range(1, model.nbody):
            if model.body_parentid[body] == 0:
                self.root(body)
            else:
                draft, parent, X_BL = self.source.owners[int(model.body_parentid[body])]
                X_LB = X_BL.inverse() @ Pose.of(model.body_pos[body], model.body_quat[body])
                self.chain(draft, body, parent, X_LB, self.joints_of(body))
        if not self.draft.bodies:
            raise ImportRefusedError(self.path, "the model has no bodies and no geoms")
        add_elements(self.source, self.native)
        if self.own is not None:
            poses = {self.names["body"][b]: self.body_pose(b) for b in range(1, model.nbody)}
            restore(self.draft, self.own, poses, self.free_joints)
        if self.native is None:
            repair_masses(self.draft, str(self.path))
            return self.draft
        given = {link: self.measured(link) for body in self.draft.bodies for link in body.links.values()}
        repair_masses(self.draft, str(self.path))
        for body, (owner, name, _) in self.source.owners.items():
            link = owner.links[name]
            if given[link] != self.measured(link) and "massless" not in link.native:
                link.native.get("exact", {}).pop("inertial", None)
                link.native["inertial"] = self.native.inertial(body)
        self.draft.native = self.native.read(self.roots)
        return self.draft

    @staticmethod
    def measured(link: LinkDraft) -> tuple[Any, ...]:
        """Return the mass properties of a link for comparison."""
        arrays = (link.com, link.inertia)
        return (link.mass, *(None if array is None else tuple(array.ravel().tolist()) for array in arrays))

    def world(self) -> None:
        """Convert each geom in the world body to a fixed object, and a compiled scene's background to a mesh."""
        model = self.model
        background = []
        for geom in np.flatnonzero(model.geom_bodyid == 0).tolist():
            name = self.source.name("geom", geom)
            if self.own is not None and name.startswith(BACKGROUND):
                background.append(self.geoms.baked(geom))
                continue
            if (part := self.geoms.part(geom)) is None:
                continue
            X_WG, part.X_LG = part.X_LG, Pose.of()
            name = name or part.name
            unique = name if name == self.draft.free_name(name) else f"{name}_{geom}"
            link = LinkDraft("base", [part])
            if self.native is not None:
                link.native["merge"] = True
                self.native.geom(geom, part)
                self.native.places["geom", geom] = CompiledName("geom", unique, part)
            self.draft.bodies.append(BodyDraft(unique, "base", {"base": link}, [], True, X_WG))
        if background:
            self.draft.background = mesh_of_parts(background, "background")

    def root(self, body: int) -> None:
        """Convert a child of the world body, which may be free, fixed, or connected to a static base by joints."""
        model, name, joints = self.model, self.names["body"][body], self.joints_of(body)
        unique = name if name == self.draft.free_name(name) else f"{name}_body"
        free = [model.jnt_type[j] for j in joints] == [self.mujoco.mjtJoint.mjJNT_FREE]
        if not joints or free:
            draft = BodyDraft(unique, name, {}, fixed=not free, X_WO=self.body_pose(body))
            self.draft.bodies.append(draft)
            if free:
                self.free_joints[name] = self.names["joint"][joints[0]]
                self.note_free_dynamics(joints[0])
            self.add_link(draft, body)
            if free and self.native is not None and (kept := self.native.free_joint(joints[0])):
                draft.links[name].native["freejoint"] = kept
            if int(model.body_mocapid[body]) >= 0:
                self.draft.changed(f"mocap body `{name}`", "mocap bodies are not supported, so the body is fixed")
            return
        base = self.base_name(body)
        X_WB = Pose.of(model.body_pos[body], model.body_quat[body])
        root = LinkDraft(base, mass=0.0)
        if self.native is not None:
            root = feather_link(base, float(model.body_subtreemass[body]))
            root.native["merge"] = True
        draft = BodyDraft(unique, base, {base: root}, fixed=True, X_WO=X_WB)
        self.draft.bodies.append(draft)
        self.chain(draft, body, base, Pose.of(), joints)

    def note_free_dynamics(self, joint: int) -> None:
        """Record a free joint's damping, friction and armature as dropped.

        Free bodies in documents have no joint that could have these properties.
        """
        what = f"free joint `{self.names['joint'][joint]}`"
        for field, word in (("armature", "armature"), ("damping", "damping"), ("frictionloss", "friction")):
            value = float(getattr(self.model.jnt(joint), field).flat[0])
            if value:
                self.draft.dropped(f"{word} of {what}", "free bodies have no joint", f"{value:.4g}")

    def base_name(self, body: int) -> str:
        """Return a name for the base link below the world body that differs from the names of all descendants."""
        below = {name for b, name in enumerate(self.names["body"]) if b and self.model.body_rootid[b] == body}
        return next((wish for wish in ("base", "mount") if wish not in below), "") or self.new_name("body", "base")

    def chain(self, draft: BodyDraft, body: int, parent: str, X_PB: Pose, joints: list[int]) -> None:
        """Convert a body and its joints.

        Several joints become the axes of one joint. If they do not intersect, or if one of them is a ball joint, links
        with negligible mass are inserted between them.
        """
        model, name = self.model, self.names["body"][body]
        if not joints:
            self.add_link(draft, body)
            draft.joints.append(JointDraft(self.new_name("joint", f"{name}_mount"), "fixed", parent, name, X_PB))
            return
        if len(joints) > 1 and (anchor := common_anchor(self.mujoco, model, joints)) is not None:
            X_PL = X_PB @ Pose.of(anchor)
            for joint in joints:
                drafted = self.joint(joint, parent, name, X_PL)
                draft.joints.append(drafted)
                self.source.joints[joint] = (draft, drafted)
                X_PL = Pose.of()
            self.add_link(draft, body, Pose.of(anchor))
            return
        anchor = np.zeros(3)
        for k, joint in enumerate(joints):
            X_PL = X_PB @ Pose.of(model.jnt_pos[joint] - anchor)
            is_last = k == len(joints) - 1
            link = name if is_last else self.new_name("body", f"{name}_{k + 1}_of_{len(joints)}")
            drafted = self.joint(joint, parent, link, X_PL)
            draft.joints.append(drafted)
            self.source.joints[joint] = (draft, drafted)
            anchor, parent, X_PB = model.jnt_pos[joint], link, Pose.of()
            if not is_last:
                draft.links[link] = feather = feather_link(link, float(model.body_subtreemass[body]))
                feather.native |= {} if self.native is None else {"merge": True}
                why = "a link can have only one parent joint, so a link with negligible mass was inserted"
                self.draft.assumed(f"link `{link}`", why, f"{feather.mass:.3g} kg")
        self.add_link(draft, body, Pose.of(model.jnt_pos[joints[-1]]))

    def joint(self, joint: int, parent: str, child: str, X_PL: Pose) -> JointDraft:
        """Convert a joint without changing its coordinate.

        Positions are the same as in MuJoCo, even with `ref`.
        """
        model, kinds = self.model, self.mujoco.mjtJoint
        kind, name, source = model.jnt_type[joint], self.names["joint"][joint], model.jnt(joint)
        axis = np.array(source.axis, dtype=np.float64)
        out = JointDraft(name, "revolute", parent, child, X_PL, axis, damping=float(source.damping.flat[0]))
        out.friction, out.armature = float(source.frictionloss[0]), float(source.armature[0])
        is_limited, qpos = bool(source.limited), self.data.joint(joint).qpos
        out.native = {} if self.native is None else self.native.joint(joint, is_limited)
        if kind == kinds.mjJNT_BALL:
            out.type = "ball"
            out.motion = Pose.of(q=source.qpos0).inverse() @ Pose.of(q=qpos)
            if is_limited and self.native is None:
                self.draft.inexpressible(f"limit of ball joint `{name}`")
            return out
        if model.jnt_actfrclimited[joint]:
            out.effort = self.effort(name, model.jnt_actfrcrange[joint])
        out.position = float(qpos[0])
        out.limits = tuple(source.range.tolist()) if is_limited else None
        reference = float(source.qpos0[0])
        axis /= np.linalg.norm(axis)
        if kind == kinds.mjJNT_SLIDE:
            out.type = "prismatic"
            out.X_PC = X_PL @ Pose.of(-reference * axis)
            if not is_limited:
                out.limits = self.draft.unlimited_slide(f"joint `{name}`")
        else:
            out.type = "revolute" if is_limited else "continuous"
            out.X_PC = X_PL @ Pose.about(axis, -reference)
        return out

    def effort(self, joint: str, bounds: Any) -> float | None:
        """Return the effort limit [N or N m] for a range of forces. Documents have one limit for both directions."""
        low, high = abs(float(bounds[0])), abs(float(bounds[1]))
        if not math.isclose(low, high):
            what, why = f"`actuatorfrcrange` of joint `{joint}`", "a joint has one effort limit for both directions"
            self.draft.changed(what, why, f"{max(low, high):.4g} instead of {min(low, high):.4g}")
        return max(low, high) or None

    def joints_of(self, body: int) -> list[int]:
        return [int(joint) for joint in np.flatnonzero(self.model.jnt_bodyid == body)]

    def body_pose(self, body: int) -> Pose:
        return Pose.of(self.data.xpos[body], self.data.xquat[body])

    def add_link(self, draft: BodyDraft, body: int, X_BL: Pose = IDENTITY) -> None:
        """Add a body's link to ``draft``.

        ``X_BL`` is the pose of the link frame in the body frame.
        """
        model, X_LB, name = self.model, X_BL.inverse(), self.names["body"][body]
        link = draft.links[name] = LinkDraft(name, mass=float(model.body_mass[body]))
        link.gravity_compensation = min(max(float(model.body_gravcomp[body]), 0.0), 1.0)
        self.source.owners[body] = (draft, name, X_BL)
        for geom in np.flatnonzero(model.geom_bodyid == body).tolist():
            if (part := self.geoms.part(geom)) is not None:
                part.X_LG = X_LB @ part.X_LG
                link.parts.append(part)
                if self.native is not None:
                    self.native.geom(geom, part)
        if self.native is not None:
            self.native.body(body, link, X_LB)
            if not link.mass:
                feather = feather_link(name, float(model.body_subtreemass[model.body_rootid[body]]))
                link.mass, link.com, link.inertia = feather.mass, feather.com, feather.inertia
                link.assumed, link.native["massless"] = "import", True
                return
        if link.mass:
            link.com = X_LB.apply(np.array(model.body_ipos[body]))
            axes = (X_LB @ Pose.of(q=model.body_iquat[body])).rotation
            link.inertia = inertia_of_moments(model.body_inertia[body], axes, NOISE)
