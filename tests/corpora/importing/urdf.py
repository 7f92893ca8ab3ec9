"""URDF: what PyBullet and MuJoCo say of the original and of the URDF that is compiled from the import."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.frontends.files import read_xml
from simfoundry.frontends.importer import ImportReport
from simfoundry.geometry.frames import Pose, from_xyzw
from tests.corpora.importing.dynamics import STATES, TOLD, mass_matrix
from tests.corpora.importing.outcome import LIMIT, MASS, POSE, Outcome


@dataclass
class Side:
    """What PyBullet says of a model at zero: masses, frames, and limits of joints by the link that they move."""

    mass: dict[str, float]
    frame: dict[str, Pose]
    limits: dict[str, tuple[int, float, float]]


def read_side(path: Path) -> Side | None:
    """What PyBullet says of a URDF; None where it does not load it."""
    import pybullet as p

    client = p.connect(p.DIRECT)
    try:
        p.setAdditionalSearchPath(str(path.parent), physicsClientId=client)
        body = p.loadURDF(str(path), flags=p.URDF_USE_INERTIA_FROM_FILE, physicsClientId=client)
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


def compare_urdf(outcome: Outcome, report: ImportReport, theirs: Side, original: Path, compiled: Path) -> None:
    """Masses, frames and limits by PyBullet, mass matrices by MuJoCo."""
    ours = read_side(compiled)
    if ours is None:
        outcome.differing.append("PyBullet does not load what we compiled")
        return
    renamed = {old.partition("/")[2]: new for old, new in report.names if "/" in old}
    noted = {note.what for note in report.notes}
    stated = _stated(original)
    called = {name: renamed.get(name, name) for name in theirs.mass}
    if len(theirs.mass) == len(ours.mass) == 1:  # a body of one shape is written without its link
        called = dict(zip(theirs.mass, ours.mass, strict=True))
    roots = next(iter(theirs.mass)), next(iter(ours.mass))
    for name in theirs.mass:
        link, joined = called[name], f"link `{name}`" in noted
        if link not in ours.mass:
            if not joined:
                outcome.differing.append(f"link {name} is gone without a note")
            continue
        if name in stated and not joined and (name, link) != roots:
            outcome.compare("mass", ours.mass[link] / stated[name], 1.0, MASS, f"link {name} (of {stated[name]:g} kg)")
        X = theirs.frame[roots[0]].inverse() @ theirs.frame[name]
        Y = ours.frame[roots[1]].inverse() @ ours.frame[link]
        outcome.compare("position", float(np.linalg.norm(X.p - Y.p)), 0.0, POSE, f"link {name}")
        outcome.compare("angle", X.angle_to(Y), 0.0, POSE * 10, f"link {name}")
    continuous = _continuous(original)  # PyBullet keeps limits there, which URDF gives no meaning
    for name, (kind, low, high) in theirs.limits.items():
        link = called[name]
        if link not in ours.limits or not low < high or name in continuous:
            continue
        outcome.compare("limit", ours.limits[link][1], low, LIMIT * max(1, abs(low)), f"the joint of {name}")
        outcome.compare("limit", ours.limits[link][2], high, LIMIT * max(1, abs(high)), f"the joint of {name}")
        if ours.limits[link][0] != kind:
            outcome.differing.append(f"the joint of {name} is of another kind")
    told = [n.what for n in report.notes if n.what.startswith(TOLD)]
    _compare_dynamics(outcome, renamed, original, compiled, told)


def _stated(path: Path) -> dict[str, float]:
    """The masses that a URDF gives, by link: PyBullet makes up the others."""
    out = {}
    for link in read_xml(path).all("link"):
        inertial = link.first("inertial")
        mass = inertial.first("mass") if inertial is not None else None
        if mass is not None and mass.number("value") > 0:
            out[link.need("name")] = mass.number("value")
    return out


def _continuous(path: Path) -> set[str]:
    """The links that continuous joints move."""
    joints = (j for j in read_xml(path).all("joint") if j.get("type") == "continuous")
    return {child.need("link") for j in joints for child in j.all("child")}


def _compare_dynamics(
    outcome: Outcome, renamed: dict[str, str], original: Path, compiled: Path, told: list[str]
) -> None:
    """Mass matrices at random joint states, by MuJoCo on the links and joints alone; of what it takes."""
    import mujoco

    try:
        theirs = _bare_model(original)
    except ValueError:
        outcome.compared["mass matrices that MuJoCo cannot give of the original"] += 1
        return
    ours = _bare_model(compiled)
    names = [mujoco.mj_id2name(theirs, mujoco.mjtObj.mjOBJ_JOINT, j) for j in range(theirs.njnt)]
    there = {mujoco.mj_id2name(ours, mujoco.mjtObj.mjOBJ_JOINT, j): j for j in range(ours.njnt)}
    moving = {j: renamed.get(name, name) for j, name in enumerate(names) if theirs.jnt_type[j] in (2, 3)}
    gone = [names[j] for j, called in moving.items() if called not in there]
    if gone:
        locked = [n for n in gone if theirs.jnt_range[names.index(n), 0] == theirs.jnt_range[names.index(n), 1]]
        where = outcome.told if len(locked) == len(gone) else outcome.differing
        where.append(f"joints {', '.join(gone[:4])} are gone")
        return
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        sampled = rng.uniform(-1.0, 1.0, len(moving))
        mine = _mass_matrix(ours, [there[called] for called in moving.values()], sampled)
        original_matrix = _mass_matrix(theirs, list(moving), sampled)
        outcome.compare_matrices(mine, original_matrix, [names[j] for j in moving], ", ".join(told[:3]))


def _mass_matrix(model: Any, joints: list[int], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """The mass matrix of some joints at some positions."""
    import mujoco

    data = mujoco.MjData(model)
    data.qpos[model.jnt_qposadr[joints]] = values
    dofs = model.jnt_dofadr[joints]
    return mass_matrix(model, data)[np.ix_(dofs, dofs)]


def _bare_model(path: Path) -> Any:
    """A URDF without its shapes, in MuJoCo; raises ValueError."""
    import mujoco

    text = path.read_text(encoding="utf-8", errors="replace")
    text = re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL)
    text = re.sub(r"<(visual|collision|transmission|gazebo|mujoco)\b(?:[^>]*/>|.*?</\1\s*>)", "", text, flags=re.DOTALL)
    return mujoco.MjModel.from_xml_string(text)
