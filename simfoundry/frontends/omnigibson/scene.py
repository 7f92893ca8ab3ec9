"""Read scenes from the release that accompanies the SimFoundry paper.

Each scene consists of an OmniGibson scene JSON, an object list and URDF folders. In this format, quaternions have w
last, masses are specified only in the URDF, friction coefficients are in the object list, joint positions have no
names, and the table is an infinite plane.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, ImportOptions, LinkDraft, MeshDraft, ModelDraft, PartDraft, RobotDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.files import read_json
from simfoundry.frontends.mass_repair import repair_masses
from simfoundry.frontends.shapes import primitive
from simfoundry.frontends.urdf.reader import read_urdf
from simfoundry.geometry.frames import Pose, from_xyzw
from simfoundry.spec.models.shapes import BoxShape, CapsuleShape, CylinderShape, SphereShape

# Size [m] of the box whose top represents the ground plane; it is larger than a robot's reach.
TABLE = (4.0, 4.0, 0.04)

# Known robots, by the names of the corresponding robots in the release.
ROBOTS = {"FrankaPanda": "franka_panda", "FrankaMounted": "franka_panda", "YAM": "yam"}

# Number of parent folders to search for assets; scenes are four levels below the root of the release.
LEVELS = 5


def read_omnigibson(path: Path, options: ImportOptions) -> ModelDraft:
    """Read the scene in a JSON file from the release that accompanies the SimFoundry paper.

    Raises:
        ImportRefusedError: If the file is invalid.
    """
    return _SceneReader(path, options).read()


class _SceneReader:
    """A reader for a single scene file."""

    def __init__(self, path: Path, options: ImportOptions) -> None:
        self.path, self.options, self.packages = path, options, options.packages
        self.data = read_json(path)
        self.draft = ModelDraft(path.stem, "OmniGibson", density=options.density)
        self.infos = self.at(self.data, "objects_info", "init_info")
        self.states = self.at(self.data, "state", "registry", "object_registry")
        self.listed = self.object_list()

    def at(self, data: Any, *keys: str) -> dict[str, Any]:
        """Return the mapping at ``keys`` in ``data``.

        Raises:
            ImportRefusedError: If there is no such mapping.
        """
        for key in keys:
            data = data.get(key) if isinstance(data, dict) else None
        if not isinstance(data, dict):
            raise ImportRefusedError(self.path, f"the file has no `{'.'.join(keys)}`, so it is not an OmniGibson scene")
        return data

    def object_list(self) -> dict[str, dict[str, Any]]:
        """Return the entries in `scene_objects_info.json`, keyed by object name."""
        here = self.path.resolve().parent
        places = [folder / sub for folder in (here, *here.parents[:2]) for sub in ("", "s10_sim")]
        for place in [*places, *self.packages.values()]:
            file = place / "scene_objects_info.json"
            if file.is_file():
                listed = read_json(file)
                entries = listed.values() if isinstance(listed, dict) else []
                return {str(e["name"]): e for e in entries if isinstance(e, dict) and "name" in e}
        why = "scene_objects_info.json was not found; 0.5 is assumed, as in the release's evaluation"
        self.draft.assumed("friction of the objects", why)
        return {}

    def read(self) -> ModelDraft:
        for name, info in self.infos.items():
            args, state = info.get("args") or {}, self.states.get(name) or {}
            kind = str(info.get("class_name", ""))
            if "robots" in str(info.get("class_module", "")):
                self.robot(name, kind, args, state)
            elif kind in ("DatasetObject", "USDObject") and "background" not in name:
                self.object(name, args, state)
            else:
                self.draft.dropped(f"`{name}`", "only objects and robots are supported", kind)
        self.plane()
        if not self.draft.bodies:
            raise ImportRefusedError(self.path, "the scene has no objects")
        repair_masses(self.draft, str(self.path))
        return self.draft

    def pose(self, name: str, state: dict[str, Any]) -> Pose:
        root = state.get("root_link") or {}
        position, rotation = root.get("pos"), root.get("ori")
        try:
            p, q = np.array(position, dtype=np.float64).reshape(3), np.array(rotation, dtype=np.float64).reshape(4)
            if not (np.isfinite(p).all() and np.isfinite(q).all()):
                raise ValueError
            X_WO = Pose.of(p, from_xyzw(q))
        except (TypeError, ValueError):
            message = f"the state of `{name}` has no usable `root_link.pos` and `ori`"
            raise ImportRefusedError(self.path, message) from None
        speeds = [float(v) for key in ("lin_vel", "ang_vel") for v in root.get(key) or ()]
        if any(abs(v) > 1e-3 for v in speeds):
            self.draft.dropped(f"velocity of `{name}`", "scenes always start at rest")
        return X_WO

    def object(self, name: str, args: dict[str, Any], state: dict[str, Any]) -> None:
        """Add an object from its URDF.

        The friction and the pose come from the other files.
        """
        category, model = str(args.get("category") or name), str(args.get("model") or "")
        entry = self.listed.get(name, {})
        draft = read_urdf(self.urdf(name, category, model, args), self.options)
        body = draft.bodies[0]
        self.draft.notes += draft.notes
        body.name = self.draft.free_name(category if name.startswith("iter_") and name[5:].isdigit() else name)
        body.category, body.note = category, f"`{name}` of the release"
        body.fixed = bool(args.get("fixed_base"))
        body.X_WO = self.pose(name, state)
        self.scale(name, body, args.get("scale"))
        self.friction(body, entry, args)
        self.joints(name, body, state)
        for word in ("mass", "joint_limits"):
            if args.get(word):
                why = "this entry is for information only; the URDF contains the actual values"
                self.draft.dropped(f"`{word}` of `{name}` in the scene", why)
        if args.get("visual_only"):
            for link in body.links.values():
                link.collision = "none"
        self.draft.bodies.append(body)

    def urdf(self, name: str, category: str, model: str, args: dict[str, Any]) -> Path:
        """Find the URDF of an object in the folders of the release."""
        parts = Path(str(args.get("usd_path") or "")).parts
        if "objects" in parts and len(parts) >= parts.index("objects") + 3:
            k = parts.index("objects")
            category, model = parts[k + 1], parts[k + 2]
        if any(not part.replace("_", "").replace("-", "").isalnum() for part in (category, model)):
            raise ImportRefusedError(self.path, f"`{name}` has no usable category and model: `{category}`, `{model}`")
        inside = Path("objects") / category / model / "urdf" / f"{model}.urdf"
        here = self.path.resolve().parent
        dataset = str(args.get("dataset_name") or "real2sim-assets")
        folders = [f / sub for f in (here, *here.parents[:LEVELS]) for sub in ("", "s10_sim", "assets")]
        named = [self.packages[dataset]] if dataset in self.packages else list(self.packages.values())
        for folder in [*named, *folders]:
            if (folder / inside).is_file():
                return folder / inside
        hint = f"specify the folder that contains `objects` with `--package {dataset}=PATH`"
        raise ImportRefusedError(self.path, f"could not find the URDF of `{name}`: {inside.as_posix()}", hint=hint)

    def scale(self, name: str, body: BodyDraft, scale: Any) -> None:
        """Scale a body uniformly.

        As in OmniGibson, a mass that is specified in the file does not change.
        """
        factors = [float(v) for v in scale] if isinstance(scale, list) else [float(scale or 1.0)] * 3
        if all(abs(f - 1) < 1e-9 for f in factors):
            return
        s = factors[0]
        if not s > 0 or any(abs(f - s) > 1e-6 * s for f in factors):
            hint = "only uniform scales are supported"
            raise ImportRefusedError(self.path, f"`{name}` is scaled by {factors}", hint=hint)
        self.draft.changed(f"scale of `{name}`", "the object's parts are scaled, but its mass is unchanged", f"{s:g}")
        for joint in body.joints:
            joint.X_PC = Pose.of(joint.X_PC.p * s, joint.X_PC.q)
            if joint.type == "prismatic" and joint.limits is not None:
                joint.limits = (joint.limits[0] * s, joint.limits[1] * s)
        for link in body.links.values():
            link.com = None if link.com is None else link.com * s
            link.inertia = None if link.inertia is None else link.inertia * s**2
            link.parts = [_scaled(part, s) for part in link.parts]

    def friction(self, body: BodyDraft, entry: dict[str, Any], args: dict[str, Any]) -> None:
        own, materials = entry.get("friction"), args.get("link_physics_materials") or {}
        for link in body.links.values():
            found = materials.get(link.name)
            material = found if isinstance(found, dict) else {}
            for friction in (own, material.get("dynamic_friction", material.get("static_friction"))):
                if isinstance(friction, int | float) and friction >= 0:
                    link.contact["friction"] = float(friction)

    def joints(self, name: str, body: BodyDraft, state: dict[str, Any]) -> None:
        """Set the joint positions, which the file lists without names in PhysX's breadth-first order."""
        listed = [float(v) for v in state.get("joint_pos") or ()]
        order, todo = [], [body.root]
        while todo:
            level = [j for link in todo for j in body.joints if j.parent == link]
            order += [j for j in level if j.type in ("revolute", "continuous", "prismatic")]
            todo = [j.child for j in level]
        if not any(abs(v) > 1e-6 for v in listed):
            return
        if len(listed) != len(order):
            why = "the file lists them without names, and their number differs from the number of joints in the URDF"
            self.draft.dropped(f"joint positions of `{name}`", why, f"{len(listed)} instead of {len(order)}")
            return
        for joint, value in zip(order, listed, strict=True):
            joint.position = value
        if len(order) > 1:
            why = "the file lists them without names; breadth-first order from the root is assumed"
            self.draft.assumed(f"joint positions of `{name}`", why)

    def robot(self, name: str, kind: str, args: dict[str, Any], state: dict[str, Any]) -> None:
        if (model := ROBOTS.get(kind)) is None:
            self.draft.dropped(f"robot `{name}`", "this robot model is unknown", kind)
            return
        if model == "franka_panda" and "robotiq" in str(args.get("end_effector", "")):
            model = "franka_robotiq"
        if state.get("joint_pos"):
            why = "the joint positions have no names, so the robot starts in its home posture"
            self.draft.changed(f"posture of robot `{name}`", why)
        self.draft.robots.append(RobotDraft(name, model, self.pose(name, state)))

    def plane(self) -> None:
        """Add the infinite ground plane as a box."""
        scene = (self.data.get("init_info") or {}).get("args") or {}
        info = self.data.get("ground_plane_info") or {}
        if scene.get("use_floor_plane") is False and not info:
            return
        height = float((info.get("position") or (0, 0, 0))[2])
        if info:
            why = "the table is placed at this height, although OmniGibson itself does not restore the height"
            self.draft.changed("`ground_plane_info`", why)
        part = PartDraft("table", BoxShape(box=TABLE))
        X_WO = Pose.of([0, 0, height - TABLE[2] / 2])
        self.draft.bodies.append(BodyDraft("table", "base", {"base": LinkDraft("base", [part])}, fixed=True, X_WO=X_WO))
        why = f"the plane is represented by a box of {TABLE[0]:g} x {TABLE[1]:g} m"
        self.draft.changed("the infinite plane that serves as the table", why)


def _scaled(part: PartDraft, s: float) -> PartDraft:
    part.X_LG = Pose.of(part.X_LG.p * s, part.X_LG.q)
    match part.geometry:
        case MeshDraft():
            part.geometry = replace(part.geometry, scale=part.geometry.scale * s)
        case BoxShape():
            part.geometry = primitive("box", *(v * s for v in part.geometry.box))
        case SphereShape():
            part.geometry = primitive("sphere", part.geometry.sphere * s)
        case CylinderShape(cylinder=size):
            part.geometry = primitive("cylinder", size.radius * s, size.height * s)
        case CapsuleShape(capsule=size):
            part.geometry = primitive("capsule", size.radius * s, size.height * s)
    return part
