"""The authors' release in: an OmniGibson scene JSON with its object list and URDF folders, as a scene.

Its traps are handled and said: quaternions have w last, masses stand in the URDF only, frictions in the object list,
joint positions have no names, and the table is a plane without an end.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, Draft, LinkDraft, MeshDraft, PartDraft, RobotDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.mass_repair import make_sound
from simfoundry.frontends.urdf import read_urdf
from simfoundry.geometry.frames import Pose, from_xyzw
from simfoundry.spec.models.base import BoxShape, CapsuleShape, CylinderShape, Round, SphereShape

MAX_BYTES = 100_000_000
TABLE = (4.0, 4.0, 0.04)
"""Size [m] of the box that stands for the plane on which everything lies; its top is the plane."""

ROBOTS = {"FrankaPanda": "franka_panda", "FrankaMounted": "franka_panda", "YAM": "yam"}
"""Robots of the release and what they are called here."""

LEVELS = 5


def read_omnigibson(path: Path, packages: Mapping[str, Path] | None = None, density: float | None = None) -> Draft:
    """The scene of a JSON file of the release; raises :class:`ImportRefusedError`.

    ``density`` [kg/m^3] is for links that state no mass.
    """
    return _Scene(path, packages or {}, density).read()


def read_json(path: Path) -> Any:
    """The content of a JSON file of bounded size."""
    try:
        data = path.open("rb").read(MAX_BYTES + 1)
        if len(data) > MAX_BYTES:
            raise ImportRefusedError(path, f"it is larger than {MAX_BYTES // 1_000_000} MB")
        return json.loads(data)
    except OSError as error:
        raise ImportRefusedError(path, f"it cannot be read: {error.strerror}") from None
    except json.JSONDecodeError as error:
        raise ImportRefusedError(path, f"it is not JSON: {error.msg}", error.lineno) from None
    except (UnicodeDecodeError, RecursionError):
        raise ImportRefusedError(path, "it is not JSON") from None


class _Scene:
    """One scene file while it is read."""

    def __init__(self, path: Path, packages: Mapping[str, Path], density: float | None) -> None:
        self.path, self.packages = path, packages
        self.data = read_json(path)
        self.draft = Draft(path.stem, "OmniGibson", density=density)
        self.infos = self.at(self.data, "objects_info", "init_info")
        self.states = self.at(self.data, "state", "registry", "object_registry")
        self.listed = self.object_list()

    def at(self, data: Any, *keys: str) -> dict[str, Any]:
        """A mapping inside the file."""
        for key in keys:
            data = data.get(key) if isinstance(data, dict) else None
        if not isinstance(data, dict):
            raise ImportRefusedError(self.path, f"it has no `{'.'.join(keys)}`: it is no scene of OmniGibson")
        return data

    def object_list(self) -> dict[str, dict[str, Any]]:
        """What `scene_objects_info.json` says, by name of the object."""
        here = self.path.resolve().parent
        places = [folder / sub for folder in (here, *here.parents[:2]) for sub in ("", "s10_sim")]
        for place in [*places, *self.packages.values()]:
            file = place / "scene_objects_info.json"
            if file.is_file():
                listed = read_json(file)
                entries = listed.values() if isinstance(listed, dict) else []
                return {str(e["name"]): e for e in entries if isinstance(e, dict) and "name" in e}
        self.draft.assumed(
            "friction of the objects", "scene_objects_info.json is not found; 0.5, as the evaluation takes it"
        )
        return {}

    def read(self) -> Draft:
        for name, info in self.infos.items():
            args, state = info.get("args") or {}, self.states.get(name) or {}
            kind = str(info.get("class_name", ""))
            if "robots" in str(info.get("class_module", "")):
                self.robot(name, kind, args, state)
            elif kind in ("DatasetObject", "USDObject") and "background" not in name:
                self.object(name, args, state)
            else:
                self.draft.dropped(f"`{name}`", "only objects and robots are read", kind)
        self.plane()
        if not self.draft.bodies:
            raise ImportRefusedError(self.path, "it has no object")
        make_sound(self.draft, str(self.path))
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
            raise ImportRefusedError(
                self.path, f"the state of `{name}` has no usable `root_link.pos` and `ori`"
            ) from None
        speeds = [float(v) for key in ("lin_vel", "ang_vel") for v in root.get(key) or ()]
        if any(abs(v) > 1e-3 for v in speeds):
            self.draft.dropped(f"velocity of `{name}`", "a scene starts at rest")
        return X_WO

    def object(self, name: str, args: dict[str, Any], state: dict[str, Any]) -> None:
        """An object from its URDF, with the friction and pose that stand elsewhere."""
        category, model = str(args.get("category") or name), str(args.get("model") or "")
        entry = self.listed.get(name, {})
        draft = read_urdf(self.urdf(name, category, model, args), self.packages, self.draft.density)
        body = draft.bodies[0]
        self.draft.notes += draft.notes
        generic = name.startswith("iter_") and name[5:].isdigit()
        taken = {made.name for made in self.draft.bodies}
        wished = category if generic else name
        body.name = next(n for k in range(1, 100_000) if (n := wished if k == 1 else f"{wished}_{k}") not in taken)
        body.category, body.note = category, f"`{name}` of the release"
        body.fixed = bool(args.get("fixed_base"))
        body.X_WO = self.pose(name, state)
        self.scale(name, body, args.get("scale"))
        self.friction(body, entry, args)
        self.joints(name, body, state)
        for word in ("mass", "joint_limits"):
            if args.get(word):
                self.draft.dropped(
                    f"`{word}` of `{name}` in the scene", "it is a record; what counts stands in the URDF"
                )
        if args.get("visual_only"):
            for link in body.links.values():
                link.collision = "none"
        self.draft.bodies.append(body)

    def urdf(self, name: str, category: str, model: str, args: dict[str, Any]) -> Path:
        """The URDF of an object, in the folders of the release."""
        usd = str(args.get("usd_path") or "")
        parts = Path(usd).parts
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
        hint = f"name the folder that holds `objects`: `--package {dataset}=PATH`"
        raise ImportRefusedError(self.path, f"the URDF of `{name}` is not found: {inside.as_posix()}", hint=hint)

    def scale(self, name: str, body: BodyDraft, scale: Any) -> None:
        """Scale a body evenly; its mass stays, as in OmniGibson, where the file gives it."""
        factors = [float(v) for v in scale] if isinstance(scale, list) else [float(scale or 1.0)] * 3
        if all(abs(f - 1) < 1e-9 for f in factors):
            return
        s = factors[0]
        if not s > 0 or any(abs(f - s) > 1e-6 * s for f in factors):
            raise ImportRefusedError(self.path, f"`{name}` is scaled by {factors}", hint="only even scales can be said")
        self.draft.changed(f"scale of `{name}`", "its parts are scaled; its mass stays", f"{s:g}")
        for joint in body.joints:
            joint.X_PC = Pose.of(joint.X_PC.p * s, joint.X_PC.q)
            if joint.type == "prismatic" and joint.limits is not None:
                joint.limits = (joint.limits[0] * s, joint.limits[1] * s)
        for link in body.links.values():
            link.com = None if link.com is None else link.com * s
            link.inertia = None if link.inertia is None else link.inertia * s**2
            link.parts = [_scaled(part, s) for part in link.parts]

    def friction(self, body: BodyDraft, entry: dict[str, Any], args: dict[str, Any]) -> None:
        own = entry.get("friction")
        materials = args.get("link_physics_materials") or {}
        for link in body.links.values():
            if isinstance(own, int | float) and own >= 0:
                link.friction = float(own)
            said = materials.get(link.name)
            value = said.get("dynamic_friction", said.get("static_friction")) if isinstance(said, dict) else None
            if isinstance(value, int | float) and value >= 0:
                link.friction = float(value)

    def joints(self, name: str, body: BodyDraft, state: dict[str, Any]) -> None:
        """Joint positions, which the file lists without names: PhysX counts joints level by level from the root."""
        listed = [float(v) for v in state.get("joint_pos") or ()]
        order, todo = [], [body.root]
        while todo:
            level = [j for link in todo for j in body.joints if j.parent == link]
            order += [j for j in level if j.type in ("revolute", "continuous", "prismatic")]
            todo = [j.child for j in level]
        if not any(abs(v) > 1e-6 for v in listed):
            return
        if len(listed) != len(order):
            why = "the file lists them without names, and another number of them than the URDF has joints"
            self.draft.dropped(f"joint positions of `{name}`", why, f"{len(listed)}, not {len(order)}")
            return
        for joint, value in zip(order, listed, strict=True):
            joint.position = value
        if len(order) > 1:
            self.draft.assumed(
                f"joint positions of `{name}`", "the file lists them without names; level by level from the root"
            )

    def robot(self, name: str, kind: str, args: dict[str, Any], state: dict[str, Any]) -> None:
        model = ROBOTS.get(kind)
        if model is None:
            self.draft.dropped(f"robot `{name}`", "it is not among the known ones", kind)
            return
        if model == "franka_panda" and "robotiq" in str(args.get("end_effector", "")):
            model = "franka_robotiq"
        if state.get("joint_pos"):
            self.draft.changed(f"posture of robot `{name}`", "its joint positions have no names; it starts at home")
        self.draft.robots.append(RobotDraft(name, model, self.pose(name, state)))

    def plane(self) -> None:
        """The plane that carries everything, as a thing with an edge."""
        scene = (self.data.get("init_info") or {}).get("args") or {}
        info = self.data.get("ground_plane_info") or {}
        if scene.get("use_floor_plane") is False and not info:
            return
        height = float((info.get("position") or (0, 0, 0))[2])
        if info:
            self.draft.changed(
                "`ground_plane_info`", "the table stands at that height; OmniGibson itself does not restore it"
            )
        part = PartDraft("table", BoxShape(box=TABLE))
        X_WO = Pose.of([0, 0, height - TABLE[2] / 2])
        self.draft.bodies.append(BodyDraft("table", "base", {"base": LinkDraft("base", [part])}, fixed=True, X_WO=X_WO))
        why = f"a box of {TABLE[0]:g} x {TABLE[1]:g} m stands for it"
        self.draft.changed("the plane without an end that is the table", why)


def _scaled(part: PartDraft, s: float) -> PartDraft:
    part.X_LG = Pose.of(part.X_LG.p * s, part.X_LG.q)
    match part.geometry:
        case MeshDraft():
            part.geometry = MeshDraft(part.geometry.files, part.geometry.scale * s, part.geometry.source)
        case BoxShape():
            x, y, z = (v * s for v in part.geometry.box)
            part.geometry = BoxShape(box=(x, y, z))
        case SphereShape():
            part.geometry = SphereShape(sphere=part.geometry.sphere * s)
        case CylinderShape(cylinder=size):
            part.geometry = CylinderShape(cylinder=Round(radius=size.radius * s, height=size.height * s))
        case CapsuleShape(capsule=size):
            part.geometry = CapsuleShape(capsule=Round(radius=size.radius * s, height=size.height * s))
    return part
