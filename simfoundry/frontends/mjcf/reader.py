"""MJCF in: read and compiled by MuJoCo itself, so that defaults, includes and frames mean what they mean there."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, Draft, JointDraft, LinkDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.file_search import NotFoundError, Search, refused
from simfoundry.frontends.mass_repair import feather_link, make_sound
from simfoundry.frontends.meshes import mesh_of_parts
from simfoundry.frontends.mjcf.compiled import BACKGROUND, restore, said
from simfoundry.frontends.mjcf.compiled_robots import take_robots
from simfoundry.frontends.mjcf.elements import (
    add_actuators,
    add_cameras,
    add_contacts,
    add_equalities,
    add_lights,
    count_left_out,
)
from simfoundry.frontends.mjcf.geoms import Geoms
from simfoundry.frontends.xmltree import Element, read_xml
from simfoundry.geometry.frames import Array, Pose

FAR = 1000.0
"""Limit [m] of a slide that has none."""

MAX_INCLUDES = 100

_NUMBERS = (
    "body_pos", "body_quat", "body_ipos", "body_iquat", "body_mass", "body_inertia", "geom_pos", "geom_quat",
    "geom_size", "geom_user", "geom_friction", "geom_rgba", "geom_solref", "mat_rgba", "mesh_vert", "mesh_pos",
    "mesh_quat", "mesh_texcoord", "jnt_pos", "jnt_axis", "jnt_range", "jnt_stiffness", "qpos0", "qpos_spring",
    "key_qpos", "key_ctrl",
    "dof_damping", "dof_frictionloss", "dof_armature", "actuator_gainprm", "actuator_biasprm", "actuator_forcerange",
    "actuator_gear", "cam_pos", "cam_quat", "cam_fovy", "cam_intrinsic", "cam_sensorsize", "light_pos", "light_dir",
    "light_diffuse", "light_cutoff",
)  # fmt: skip
"""What of a model is read, and has to be finite: MuJoCo takes NaN for most of it."""

_KINDS = {"jnt": "joint", "mat": "material", "cam": "camera"}
"""Kinds of elements by the prefixes of fields of a model, where these are not the same."""

NO_LENGTH = 1e-9
"""Vectors shorter than this have no direction; MuJoCo normalizes all others."""


def read_mjcf(path: Path, packages: Mapping[str, Path] | None = None) -> Draft:
    """The scene of an MJCF file; raises :class:`ImportRefusedError` with MuJoCo's own reason where it is none."""
    import mujoco

    roots = _checked(path, packages or {})
    try:
        model = mujoco.MjModel.from_xml_path(str(path))
    except ValueError as error:
        reason = " ".join(str(error).removeprefix("Error: ").split())
        raise ImportRefusedError(path, f"MuJoCo refuses it: {reason[:300]}") from None
    _check_numbers(path, mujoco, model, roots)
    return _Mjcf(path, mujoco, model, roots).read()


def _checked(path: Path, packages: Mapping[str, Path]) -> list[Element]:
    """The XML of a file and of what it includes, none of which names a file elsewhere."""
    search = Search(path, packages)
    roots: list[Element] = []
    todo = [path]
    while todo:
        file = todo.pop()
        if len(roots) > MAX_INCLUDES:
            raise ImportRefusedError(path, f"it includes more than {MAX_INCLUDES} files")
        root = read_xml(file)
        roots.append(root)
        for element in root.walk():
            if element.tag == "include":
                reference = element.need("file")
                try:
                    todo.append(search.find(reference, path.resolve().parent))
                except NotFoundError as error:
                    raise refused(file, element.line, reference, error) from None
    folders = {e.get(name) for root in roots for e in root.walk() for name in ("assetdir", "meshdir", "texturedir")}
    for root in roots:
        for element in root.walk():
            if element.tag in ("mesh", "texture", "hfield", "skin", "model", "flexcomp") and element.get("file"):
                _check_file(search, path, element, [Path(folder) for folder in folders if folder])
            elif element.tag == "plugin":
                raise element.refused("it asks for a plugin, which is code", "remove it")
    return roots


def _check_numbers(path: Path, mujoco: Any, model: Any, roots: list[Element]) -> None:
    """Refuse a model with numbers that are not finite, and rotations and axes without a length."""
    for field in _NUMBERS:
        rows = np.asarray(getattr(model, field), dtype=np.float64)
        rows = rows.reshape(len(rows), math.prod(rows.shape[1:]))
        bad = ~np.isfinite(rows).all(axis=1)
        problem = "is not finite"
        if field.endswith("_quat"):
            bad, problem = bad | (np.linalg.norm(rows, axis=1) < NO_LENGTH), "is no rotation"
        elif field == "jnt_axis":
            turns = np.isin(model.jnt_type, (int(mujoco.mjtJoint.mjJNT_SLIDE), int(mujoco.mjtJoint.mjJNT_HINGE)))
            bad, problem = bad | (turns & (np.linalg.norm(rows, axis=1) < NO_LENGTH)), "is no direction"
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


def _check_file(search: Search, path: Path, element: Element, folders: list[Path]) -> None:
    """Refuse a file outside the folders of the model; whether it exists is for MuJoCo to say."""
    reference = element.need("file")
    beside = dict.fromkeys((path.resolve().parent, element.file.resolve().parent))  # MuJoCo looks beside both
    for here, folder in itertools.product(beside, [Path(), *folders]):
        try:
            search.find((folder / reference).as_posix(), here)
            return
        except NotFoundError as error:
            if "outside" in str(error):
                raise refused(element.file, element.line, reference, error) from None
    raise refused(element.file, element.line, reference, NotFoundError("does not exist"))


class _Mjcf:
    """A compiled model on its way into a draft."""

    def __init__(self, path: Path, mujoco: Any, model: Any, roots: list[Element]) -> None:
        self.path, self.mujoco, self.roots = path, mujoco, roots
        name = roots[0].get("model") or path.stem
        self.draft = Draft(name if name != "MuJoCo Model" else path.stem, "MJCF")
        self.own = said(mujoco, model)
        self.model = model = model if self.own is None else take_robots(self.draft, path, mujoco, model, self.own)
        self.data = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, self.data, 0)
        mujoco.mj_kinematics(model, self.data)
        self.geoms = Geoms(mujoco, model, self.draft, own=self.own is not None)
        self.free: dict[str, str] = {}
        """By body, the name of its free joint."""
        self.owner: dict[int, tuple[BodyDraft, str, Pose]] = {}
        """By body id: what it belongs to, its link, and the pose of the link's frame in the body's."""
        self.joint_owner: dict[int, tuple[BodyDraft, JointDraft]] = {}
        self.names = {kind: self.element_names(kind) for kind in ("body", "joint")}
        self.taken = {kind: set(names) for kind, names in self.names.items()}

    def element_names(self, kind: str) -> list[str]:
        """A name for each element of a kind, its own or what it is with its number; no two are alike."""
        m, model = self.mujoco, self.model
        count = {"body": model.nbody, "joint": model.njnt}[kind]
        own = [m.mj_id2name(model, getattr(m.mjtObj, f"mjOBJ_{kind.upper()}"), k) or "" for k in range(count)]
        taken = set(own)
        return [name or _free_name(f"{kind}_{k}", taken) for k, name in enumerate(own)]

    def name(self, kind: str, number: int) -> str:
        """The name of a body or joint, or what it is with its number."""
        return self.names[kind][number]

    def new_name(self, kind: str, wish: str) -> str:
        """A name like ``wish`` for a link or joint that the file does not have; nothing else is called so."""
        return _free_name(wish, self.taken[kind])

    def read(self) -> Draft:
        model = self.model
        x, y, z = (float(v) for v in model.opt.gravity)
        self.draft.gravity = (x, y, z)
        self.world()
        for body in range(1, model.nbody):
            if model.body_parentid[body] == 0:
                self.root(body)
            else:
                self.link(body)
        if not self.draft.bodies:
            raise ImportRefusedError(self.path, "it has no body and no geom")
        add_equalities(self.draft, self.mujoco, model, self.joint_owner)
        add_actuators(self.draft, self.mujoco, model, self.data, self.joint_owner)
        add_contacts(self.draft, self.mujoco, model, self.owner, self.own is not None)
        add_cameras(self.draft, self.mujoco, model, self.owner)
        add_lights(self.draft, self.mujoco, model)
        if self.own is None:
            count_left_out(self.draft, self.mujoco, model, self.roots)
        else:
            bodies = range(1, model.nbody)
            restore(self.draft, self.own, {self.name("body", b): self.body_pose(b) for b in bodies}, self.free)
        make_sound(self.draft, str(self.path))
        return self.draft

    def world(self) -> None:
        """The geoms of the world body, each a fixed thing of its own; what is seen around our scenes as one mesh."""
        model = self.model
        around = []
        for geom in range(model.ngeom):
            if model.geom_bodyid[geom] != 0:
                continue
            name = self.mujoco.mj_id2name(model, self.mujoco.mjtObj.mjOBJ_GEOM, geom)
            if self.own is not None and name is not None and name.startswith(BACKGROUND):
                around.append(self.geoms.baked(geom))
                continue
            part = self.geoms.part(geom)
            if part is None:
                continue
            name = name or part.name
            X_WG, part.X_LG = part.X_LG, Pose.of()
            link = LinkDraft("base", [part])
            taken = {body.name for body in self.draft.bodies}
            unique = name if name not in taken else f"{name}_{geom}"
            self.draft.bodies.append(BodyDraft(unique, "base", {"base": link}, fixed=True, X_WO=X_WG))
        if around:
            self.draft.background = mesh_of_parts(around, "background")

    def root(self, body: int) -> None:
        """A child of the world: free, fixed, or carried by a base that stands still."""
        model, name = self.model, self.name("body", body)
        joints = self.joints_of(body)
        kinds = [int(model.jnt_type[j]) for j in joints]
        free = kinds == [int(self.mujoco.mjtJoint.mjJNT_FREE)]
        taken = {draft.name for draft in self.draft.bodies}
        unique = name if name not in taken else f"{name}_body"
        if not joints or free:
            draft = BodyDraft(unique, name, {}, fixed=not free, X_WO=self.body_pose(body))
            self.draft.bodies.append(draft)
            if free:
                self.free[name] = self.name("joint", joints[0])
                self.note_free_dynamics(joints[0])
            draft.links[name] = self.new_link(body, name, Pose.of())
            self.owner[body] = (draft, name, Pose.of())
            if int(model.body_mocapid[body]) >= 0:
                self.draft.changed(f"mocap body `{name}`", "nothing moves it by hand here; it is fixed")
            return
        base = self.root_name(body)
        X_WB = Pose.of(model.body_pos[body], model.body_quat[body])
        draft = BodyDraft(unique, base, {base: LinkDraft(base, mass=0.0)}, fixed=True, X_WO=X_WB)
        self.draft.bodies.append(draft)
        self.chain(draft, body, base, Pose.of(), joints)

    def note_free_dynamics(self, joint: int) -> None:
        """Note what resists a free joint: what is free has no joint here that could say it."""
        dof, what = int(self.model.jnt_dofadr[joint]), f"free joint `{self.name('joint', joint)}`"
        for field, word in (("dof_armature", "armature"), ("dof_damping", "damping"), ("dof_frictionloss", "friction")):
            value = float(np.ravel(getattr(self.model, field)[dof])[0])
            if value:
                self.draft.dropped(f"{word} of {what}", "what is free moves without one", f"{value:.4g}")

    def root_name(self, body: int) -> str:
        """A name for the link that carries a body of the world: no body below it is called so."""
        below = {self.name("body", b) for b in range(1, self.model.nbody) if self.model.body_rootid[b] == body}
        return next((wish for wish in ("base", "mount") if wish not in below), "") or self.new_name("body", "base")

    def link(self, body: int) -> None:
        """A child of another body."""
        model, parent = self.model, int(self.model.body_parentid[body])
        draft, parent_link, X_BL = self.owner[parent]
        X_LB = X_BL.inverse() @ Pose.of(model.body_pos[body], model.body_quat[body])
        self.chain(draft, body, parent_link, X_LB, self.joints_of(body))

    def chain(self, draft: BodyDraft, body: int, parent: str, X_PB: Pose, joints: list[int]) -> None:
        """A body with its joints; each but the last carries a link of almost no mass."""
        model, name = self.model, self.name("body", body)
        if not joints:
            draft.links[name] = self.new_link(body, name, Pose.of())
            draft.joints.append(JointDraft(self.new_name("joint", f"{name}_mount"), "fixed", parent, name, X_PB))
            self.owner[body] = (draft, name, Pose.of())
            return
        anchor = np.zeros(3)
        for k, joint in enumerate(joints):
            X_PL = X_PB @ Pose.of(model.jnt_pos[joint] - anchor)
            last = k == len(joints) - 1
            link = name if last else self.new_name("body", f"{name}_{k + 1}_of_{len(joints)}")
            made = self.joint(joint, parent, link, X_PL)
            draft.joints.append(made)
            self.joint_owner[joint] = (draft, made)
            anchor, parent, X_PB = model.jnt_pos[joint], link, Pose.of()
            if not last:
                draft.links[link] = feather = feather_link(link, float(model.body_subtreemass[body]))
                why = "a body has one joint here; a link of almost no mass joins two joints of one body"
                self.draft.assumed(f"link `{link}`", why, f"{feather.mass:.3g} kg")
        X_BL = Pose.of(model.jnt_pos[joints[-1]])
        draft.links[name] = self.new_link(body, name, X_BL)
        self.owner[body] = (draft, name, X_BL)

    def joint(self, joint: int, parent: str, child: str, X_PL: Pose) -> JointDraft:
        """A joint with MuJoCo's coordinate: its zero is where that of the file is, whatever `ref` says."""
        model, kinds = self.model, self.mujoco.mjtJoint
        kind, name = int(model.jnt_type[joint]), self.name("joint", joint)
        dof, address = int(model.jnt_dofadr[joint]), int(model.jnt_qposadr[joint])
        made = JointDraft(name, "revolute", parent, child, X_PL, np.array(model.jnt_axis[joint], dtype=np.float64))
        made.damping = float(np.ravel(model.dof_damping[dof])[0])
        made.friction, made.armature = float(model.dof_frictionloss[dof]), float(model.dof_armature[dof])
        limits = tuple(float(v) for v in model.jnt_range[joint])
        limited = bool(model.jnt_limited[joint])
        if kind == int(kinds.mjJNT_BALL):
            made.type = "ball"
            turn, zero = (Pose.of(q=q[address : address + 4]) for q in (self.data.qpos, model.qpos0))
            made.motion = zero.inverse() @ turn
            if limited:
                self.draft.dropped(f"limit of ball joint `{name}`", "the language has no word for it")
            return made
        made.position = float(self.data.qpos[address])
        reference = float(model.qpos0[address])
        axis = made.axis / np.linalg.norm(made.axis)
        if kind == int(kinds.mjJNT_SLIDE):
            made.type = "prismatic"
            made.limits = (limits[0], limits[1]) if limited else (-FAR, FAR)
            made.X_PC = X_PL @ Pose.of(-reference * axis)
            if not limited:
                self.draft.changed(f"joint `{name}`", f"it has no limits; {FAR:g} m to either side stand for that")
        else:
            made.type = "revolute" if limited else "continuous"
            made.limits = (limits[0], limits[1]) if limited else None
            made.X_PC = X_PL @ Pose.of(q=(np.cos(-reference / 2), *(axis * np.sin(-reference / 2))))
        return made

    def joints_of(self, body: int) -> list[int]:
        first, count = int(self.model.body_jntadr[body]), int(self.model.body_jntnum[body])
        return list(range(first, first + count)) if count else []

    def body_pose(self, body: int) -> Pose:
        return Pose.of(self.data.xpos[body], self.data.xquat[body])

    def new_link(self, body: int, name: str, X_BL: Pose) -> LinkDraft:
        """The link of a body; its frame is at ``X_BL`` in the body's."""
        model, X_LB = self.model, X_BL.inverse()
        link = LinkDraft(name, mass=float(model.body_mass[body]))
        first, count = int(model.body_geomadr[body]), int(model.body_geomnum[body])
        for geom in range(first, first + count) if count else ():
            part = self.geoms.part(geom)
            if part is not None:
                part.X_LG = X_LB @ part.X_LG
                link.parts.append(part)
        if link.mass:
            link.com = X_LB.apply(np.array(model.body_ipos[body]))
            axes = (X_LB @ Pose.of(q=model.body_iquat[body])).rotation
            link.inertia = _symmetric(axes @ np.diag(model.body_inertia[body]) @ axes.T)
        return link


def _free_name(wish: str, taken: set[str]) -> str:
    """A wish, with a number behind it where the name is taken; it is taken from then on."""
    numbered = (f"{wish}_{k}" for k in itertools.count(2))
    name = wish if wish not in taken else next(n for n in numbered if n not in taken)
    taken.add(name)
    return name


def _symmetric(inertia: Array) -> Array:
    """Without the noise that turning leaves beside the diagonal."""
    inertia = (inertia + inertia.T) / 2
    return np.where(np.abs(inertia) < 1e-12 * np.trace(inertia), 0.0, inertia)
