"""Every model of the corpora: imported, compiled and read back, against what the engines say of the original.

``python -m tests.corpora.imports [FOLDER]`` imports all URDF, MJCF and USD of ``../shared/data`` and every URDF of
pybullet_data that PyBullet itself loads. For each it compares what is kept, where the file gives it: the mass of each
link, limits of joints, poses of link frames at zero, by PyBullet, by MuJoCo, or by USD's own bounds. Exit code 1 below
98 %, or where anything differs without a note.
"""

from __future__ import annotations

import contextlib
import importlib.util
import math
import os
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.frontends.convert import Options, Report, import_file
from simfoundry.frontends.names import plain_name
from simfoundry.scene.frames import Pose, from_xyzw
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Mesh, Scene
from simfoundry.worlds.build import build

DATA = Path(__file__).parents[3] / "shared/data"
BAR = 0.98
MASS, LIMIT, POSE = 1e-6, 1e-5, 1e-5
"""Relative for masses; rad or m for limits and poses. PyBullet and MuJoCo read text, PyBullet in single precision."""


@dataclass
class Outcome:
    """What came of one file: refused and why, or how far the worst of each quantity is from the original."""

    corpus: str
    file: str
    refused: str = ""
    loads: bool = True
    compared: Counter[str] = field(default_factory=Counter)
    worst: dict[str, float] = field(default_factory=dict)
    differing: list[str] = field(default_factory=list)

    def compare(self, quantity: str, ours: float, theirs: float, bar: float, what: str) -> None:
        self.compared[quantity] += 1
        error = abs(ours - theirs)
        self.worst[quantity] = max(self.worst.get(quantity, 0.0), error)
        if not error <= bar:
            self.differing.append(f"{quantity} of {what}: {ours:.6g}, not {theirs:.6g}")


def corpora() -> Iterator[tuple[str, Path]]:
    """Every model file, with the corpus that it belongs to."""
    for corpus in ("scenes", "articulated", "robots"):
        for path in sorted((DATA / corpus).rglob("*")):
            included = path.parent.name == "common" or path.name in ("package.xml", "geometry.usda")
            if path.suffix in (".urdf", ".xml", ".usda", ".usd") and not included:
                yield corpus, path
    spec = importlib.util.find_spec("pybullet_data")
    assert spec is not None and spec.origin is not None
    for path in sorted(Path(spec.origin).parent.rglob("*.urdf")):
        yield "pybullet_data", path


@contextlib.contextmanager
def silent() -> Iterator[None]:
    """Engines print what they think of a file; here their numbers count."""
    keep = [os.dup(fd) for fd in (1, 2)]
    with Path(os.devnull).open("w") as null:
        for fd in (1, 2):
            os.dup2(null.fileno(), fd)
        try:
            yield
        finally:
            for fd, kept in zip((1, 2), keep, strict=True):
                os.dup2(kept, fd)
                os.close(kept)


def run(job: tuple[str, Path]) -> Outcome:
    """Import, compile and compare one file."""
    corpus, path = job
    outcome = Outcome(corpus, str(path))
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "thing.scene.yaml"
        try:
            with silent():
                original = _pybullet(path) if path.suffix == ".urdf" else None
                if corpus == "pybullet_data" and original is None:
                    outcome.loads = False
                    return outcome
                report = import_file(path, out, Options())
                scene = lower_file(out)
                if path.suffix == ".urdf" and original is not None:
                    build(scene, ["pybullet"], Path(folder))
                    ours = _pybullet(Path(folder) / "pybullet/thing.urdf", scene)
                    _compare_urdf(outcome, report, original, ours)
                elif path.suffix == ".xml":
                    build(scene, ["mjcf"], Path(folder))
                    _compare_mjcf(outcome, path, Path(folder) / "mjcf/scene.xml")
                elif path.suffix in (".usda", ".usd"):
                    _compare_usd(outcome, path, scene)
        except SimfoundryError as error:
            outcome.refused = str(error).removeprefix(str(path)).lstrip(":")
        except Exception as error:
            outcome.refused = outcome.file + " BROKE: " + repr(error)[:300]
            outcome.differing.append(outcome.refused)
    return outcome


@dataclass
class Side:
    """What an engine says of a model at zero: masses, frames, and limits of joints by the link that they move."""

    mass: dict[str, float]
    frame: dict[str, Pose]
    limits: dict[str, tuple[int, float, float]]


def _pybullet(path: Path, scene: Scene | None = None) -> Side | None:
    """What PyBullet says of a URDF; None where it does not load it."""
    import pybullet as p

    client = p.connect(p.DIRECT)
    try:
        file = path
        if scene is not None:
            file = next(f for f in path.parent.glob("*.urdf"))
        p.setAdditionalSearchPath(str(file.parent), physicsClientId=client)
        body = p.loadURDF(str(file), flags=p.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
        base = p.getBodyInfo(body, physicsClientId=client)[0].decode()
        side = Side({}, {}, {})
        info = p.getDynamicsInfo(body, -1, physicsClientId=client)
        X_WI = Pose.of(*_pose(p.getBasePositionAndOrientation(body, physicsClientId=client)))
        X_WB = X_WI @ Pose.of(*_pose((info[3], info[4]))).inverse()
        side.mass[base], side.frame[base] = info[0], Pose.of()
        for k in range(p.getNumJoints(body, physicsClientId=client)):
            joint = p.getJointInfo(body, k, physicsClientId=client)
            link = joint[12].decode()
            side.mass[link] = p.getDynamicsInfo(body, k, physicsClientId=client)[0]
            if joint[2] in (p.JOINT_REVOLUTE, p.JOINT_PRISMATIC):
                p.resetJointState(body, k, 0.0, physicsClientId=client)
                side.limits[link] = (joint[2], joint[8], joint[9])
        for k in range(p.getNumJoints(body, physicsClientId=client)):
            state = p.getLinkState(body, k, computeForwardKinematics=1, physicsClientId=client)
            link = p.getJointInfo(body, k, physicsClientId=client)[12].decode()
            side.frame[link] = X_WB.inverse() @ Pose.of(*_pose((state[4], state[5])))
        return side
    except p.error:
        return None
    finally:
        p.disconnect(client)


def _pose(values: tuple[Any, Any]) -> tuple[Any, Any]:
    return values[0], from_xyzw(values[1])


def _stated(path: Path) -> dict[str, float]:
    """The masses that a URDF gives, by link: PyBullet makes up the others."""
    from simfoundry.frontends.xmltree import read_xml

    out = {}
    for link in read_xml(path).all("link"):
        inertial = link.first("inertial")
        mass = inertial.first("mass") if inertial is not None else None
        if mass is not None and mass.number("value") > 0:
            out[link.need("name")] = mass.number("value")
    return out


def _continuous(path: Path) -> set[str]:
    """The links that continuous joints move."""
    from simfoundry.frontends.xmltree import read_xml

    joints = (j for j in read_xml(path).all("joint") if j.get("type") == "continuous")
    return {child.need("link") for j in joints for child in j.all("child")}


def _compare_urdf(outcome: Outcome, report: Report, theirs: Side, ours: Side | None) -> None:
    assert ours is not None, "PyBullet does not load what we compiled"
    renamed = {old.partition("/")[2]: new for old, new in report.names if "/" in old}
    noted = {note.what for note in report.notes}
    stated = _stated(Path(outcome.file))
    called = {name: renamed.get(name, name) for name in theirs.mass}
    if len(theirs.mass) == len(ours.mass) == 1:  # a body of one shape is written without its link
        called = dict(zip(theirs.mass, ours.mass, strict=True))
    roots = next(iter(theirs.mass)), next(iter(ours.mass))
    for name in theirs.mass:
        link = called[name]
        joined = f"link `{name}`" in noted
        if link not in ours.mass:
            if not joined:
                outcome.differing.append(f"link {name} is gone without a note")
            continue
        if name in stated and not joined:
            outcome.compare("mass", ours.mass[link] / stated[name], 1.0, MASS, f"link {name} (of {stated[name]:g} kg)")
        X = theirs.frame[roots[0]].inverse() @ theirs.frame[name]
        Y = ours.frame[roots[1]].inverse() @ ours.frame[link]
        outcome.compare("position", float(np.linalg.norm(X.p - Y.p)), 0.0, POSE, f"link {name}")
        outcome.compare("angle", X.angle_to(Y), 0.0, POSE * 10, f"link {name}")
    total = sum(stated.values())
    absorbed = sum(m for n, m in stated.items() if called.get(n) not in ours.mass)
    kept = sum(ours.mass[called[n]] for n in stated if called[n] in ours.mass)
    if total and not absorbed:
        outcome.compare("total mass", kept / total, 1.0, MASS, "all links")
    continuous = _continuous(Path(outcome.file))  # PyBullet keeps limits there, which URDF gives no meaning
    for name, (kind, low, high) in theirs.limits.items():
        link = called[name]
        if link not in ours.limits or not low < high or name in continuous:
            continue
        outcome.compare("limit", ours.limits[link][1], low, LIMIT * max(1, abs(low)), f"the joint of {name}")
        outcome.compare("limit", ours.limits[link][2], high, LIMIT * max(1, abs(high)), f"the joint of {name}")
        if ours.limits[link][0] != kind:
            outcome.differing.append(f"the joint of {name} is of another kind")


def _compare_mjcf(outcome: Outcome, original: Path, compiled: Path) -> None:
    """Masses, limits and world poses of every body of the same name, at the state of the scene."""
    import mujoco

    a, b = (mujoco.MjModel.from_xml_path(str(p)) for p in (original, compiled))
    states = [mujoco.MjData(a), mujoco.MjData(b)]
    if a.nkey:
        mujoco.mj_resetDataKeyframe(a, states[0], 0)
    if b.nkey:
        mujoco.mj_resetDataKeyframe(b, states[1], 0)
    _start_inside(a, states[0])
    for model, state in zip((a, b), states, strict=True):
        mujoco.mj_kinematics(model, state)
        mujoco.mj_comPos(model, state)
    moving = [k for k in range(1, a.nbody) if a.body_weldid[k] != 0]
    ours = {int(i): mujoco.mj_id2name(b, mujoco.mjtObj.mjOBJ_BODY, i) or "" for i in range(1, b.nbody)}
    feathers = sum(float(b.body_mass[i]) for i in ours if "_of_" in ours[i] and b.body_mass[i] < 2e-6)
    total = sum(float(b.body_mass[i]) for i in ours if b.body_weldid[i] != 0) - feathers
    wanted = sum(float(a.body_mass[k]) for k in moving)
    if wanted:
        outcome.compare("total mass", total / wanted, 1.0, MASS, "what moves")
    ends = {name.rpartition(".")[2]: i for i, name in ours.items()}
    for k in moving:
        name = plain_name(mujoco.mj_id2name(a, mujoco.mjtObj.mjOBJ_BODY, k) or f"body_{k}", "link")
        if name not in ends or [n.rpartition(".")[2] for n in ours.values()].count(name) > 1:
            continue
        i = ends[name]
        if a.body_mass[k]:
            outcome.compare("mass", float(b.body_mass[i] / a.body_mass[k]), 1.0, MASS, f"body {name}")
            error = float(np.linalg.norm(states[0].xipos[k] - states[1].xipos[i]))
            outcome.compare("position", error, 0.0, POSE, f"centre of mass of body {name}")
        angle = Pose.of(q=states[0].xquat[k]).angle_to(Pose.of(q=states[1].xquat[i]))
        outcome.compare("angle", angle, 0.0, POSE * 10, f"body {name}")
    joints = {(mujoco.mj_id2name(b, mujoco.mjtObj.mjOBJ_JOINT, j) or "").rpartition(".")[2]: j for j in range(b.njnt)}
    for j in range(a.njnt):
        name = plain_name(mujoco.mj_id2name(a, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}", "joint")
        if not a.jnt_limited[j] or int(a.jnt_type[j]) not in (2, 3) or name not in joints:
            continue
        for end in (0, 1):
            mine, theirs = float(b.jnt_range[joints[name], end]), float(a.jnt_range[j, end])
            outcome.compare("limit", mine, theirs, LIMIT * max(1, abs(theirs)), f"joint {name}")


def _start_inside(model: Any, state: Any) -> None:
    for j in range(model.njnt):
        if model.jnt_limited[j] and int(model.jnt_type[j]) in (2, 3):
            at = int(model.jnt_qposadr[j])
            state.qpos[at] = np.clip(state.qpos[at], *model.jnt_range[j])


def _compare_usd(outcome: Outcome, path: Path, scene: Scene) -> None:
    """The bounds of all that is seen, and the mass of all bodies that give one."""
    from pxr import Usd, UsdGeom, UsdPhysics

    stage = Usd.Stage.Open(str(path))
    to_m = UsdGeom.GetStageMetersPerUnit(stage)
    y_up = UsdGeom.GetStageUpAxis(stage) == "Y"
    low, high = np.full(3, np.inf), np.full(3, -np.inf)
    cache = UsdGeom.XformCache()
    masses: list[float] = []
    for prim in Usd.PrimRange.Stage(stage, Usd.TraverseInstanceProxies()):
        if prim.HasAPI(UsdPhysics.RigidBodyAPI):
            masses.append(float(UsdPhysics.MassAPI(prim).GetMassAttr().Get() or 0.0))
        if prim.IsA(UsdGeom.Mesh) and UsdGeom.Imageable(prim).ComputeVisibility() != "invisible":
            if UsdGeom.Imageable(prim).ComputePurpose() not in ("default", "render"):
                continue
            points = np.array(UsdGeom.Mesh(prim).GetPointsAttr().Get() or [], dtype=float).reshape(-1, 3)
            used = np.unique(np.array(UsdGeom.Mesh(prim).GetFaceVertexIndicesAttr().Get() or [], dtype=int))
            if not len(used):
                continue
            X = np.array(cache.GetLocalToWorldTransform(prim)).T
            world = (points[used] @ X[:3, :3].T + X[:3, 3]) * to_m
            world = np.column_stack([world[:, 0], -world[:, 2], world[:, 1]]) if y_up else world
            low, high = np.minimum(low, world.min(axis=0)), np.maximum(high, world.max(axis=0))
    if len(masses) and all(masses):
        to_kg = UsdPhysics.GetStageKilogramsPerUnit(stage)
        links = [link for o in scene.objects for link in o.links if not (o.fixed and link.name == "base")]
        outcome.compare("total mass", sum(k.mass for k in links) / (sum(masses) * to_kg), 1.0, MASS, "all bodies")
    corners = []
    for item in scene.objects:
        poses = link_poses(item)
        for link in item.links:
            for visual in link.visuals:
                if isinstance(visual.geometry, Mesh):
                    X_WG = item.X_WO @ poses[link.name] @ visual.X_LG
                    corners.append(X_WG.apply(visual.geometry.vertices))
    if corners and np.isfinite(low).all():
        points = np.concatenate(corners)
        for k, axis in enumerate("xyz"):
            outcome.compare(
                "position", float(points[:, k].min()), float(low[k]), 1e-4, f"the lowest {axis} of all meshes"
            )
            outcome.compare(
                "position", float(points[:, k].max()), float(high[k]), 1e-4, f"the highest {axis} of all meshes"
            )


def main(arguments: list[str]) -> int:
    """Run every file, print a line for each corpus, each refusal and each difference."""
    if not DATA.is_dir():
        print(f"{DATA} is not here; only pybullet_data is run")
    jobs = [job for job in corpora() if not arguments or any(a in str(job[1]) for a in arguments)]
    started = time.perf_counter()
    with ProcessPoolExecutor(max_workers=2) as pool:
        outcomes = list(pool.map(run, jobs, chunksize=4))
    bad = 0
    for corpus in dict.fromkeys(corpus for corpus, _ in jobs):
        mine = [o for o in outcomes if o.corpus == corpus and o.loads]
        done = [o for o in mine if not o.refused]
        counts: Counter[str] = sum((o.compared for o in done), Counter())
        worst = {q: max(o.worst.get(q, 0.0) for o in done) for q in counts}
        figures = ", ".join(f"{counts[q]} x {q} within {worst[q]:.1e}" for q in counts)
        print(f"{corpus:<14}{len(done):>5} of {len(mine)} imported ({len(done) / max(1, len(mine)):.1%}); {figures}")
        for o in mine:
            if o.refused:
                print(f"  refused {Path(o.file).parent.name}/{Path(o.file).name}: {o.refused[:260]}")
            for text in o.differing[:4]:
                print(f"  DIFFERS {Path(o.file).parent.name}/{Path(o.file).name}: {text}")
            bad += bool(o.differing)
    loaded = [o for o in outcomes if o.loads]
    share = sum(not o.refused for o in loaded) / max(1, len(loaded))
    print(f"{share:.2%} of {len(loaded)} imported (bar {BAR:.0%}), {bad} differ, {time.perf_counter() - started:.0f} s")
    return int(share < BAR or bad > 0 or math.isnan(share))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
