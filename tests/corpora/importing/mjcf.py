"""MJCF: what MuJoCo says of the original and of the MJCF that is compiled from the import."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.frontends.importer import ImportReport
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Pose
from tests.corpora.importing.dynamics import STATES, TOLD, mass_matrix
from tests.corpora.importing.outcome import LIMIT, MASS, POSE, Outcome


def load_mjcf(path: Path) -> Any:
    """The model of a file; None where MuJoCo refuses it."""
    import mujoco

    try:
        return mujoco.MjModel.from_xml_path(str(path))
    except (ValueError, mujoco.FatalError):
        return None


def compare_mjcf(outcome: Outcome, report: ImportReport, a: Any, compiled: Path) -> None:
    """Masses, joints, world poses at the state of the scene, and mass matrices at random states."""
    import mujoco

    b = mujoco.MjModel.from_xml_path(str(compiled))
    _compare_bodies(outcome, a, b)
    told = ", ".join([n.what for n in report.notes if n.what.startswith(TOLD)][:3])
    kinds = [[int(t) for t in model.jnt_type] for model in (a, b)]
    if kinds[0] != kinds[1]:
        outcome.differing.append(f"joints are of types {kinds[1][:12]}, not {kinds[0][:12]}")
        return
    for j in range(a.njnt):
        if a.jnt_limited[j] and kinds[0][j] in (2, 3):
            name = mujoco.mj_id2name(a, mujoco.mjtObj.mjOBJ_JOINT, j) or f"joint_{j}"
            for end in (0, 1):
                theirs = float(a.jnt_range[j, end])
                bar = LIMIT * max(1, abs(theirs))
                outcome.compare("limit", float(b.jnt_range[j, end]), theirs, bar, f"joint {name}")
    names = [mujoco.mj_id2name(a, mujoco.mjtObj.mjOBJ_JOINT, int(j)) or f"joint_{j}" for j in a.dof_jntid]
    rng = np.random.default_rng(0)
    for _ in range(STATES):
        positions = _random_positions(a, rng)
        matrices = []
        for model in (b, a):
            data = mujoco.MjData(model)
            data.qpos[:] = positions
            matrices.append(mass_matrix(model, data))
        outcome.compare_matrices(matrices[0], matrices[1], names, told)


def _random_positions(model: Any, rng: np.random.Generator) -> NDArray[np.float64]:
    """A state in which every joint is somewhere."""
    out = np.zeros(model.nq)
    for j in range(model.njnt):
        at, kind = int(model.jnt_qposadr[j]), int(model.jnt_type[j])
        if kind in (2, 3):
            low, high = model.jnt_range[j] if model.jnt_limited[j] else (-1.0, 1.0)
            out[at] = rng.uniform(low, high)
            continue
        if kind == 0:
            out[at : at + 3] = rng.uniform(-1, 1, 3)
            at += 3
        q = rng.normal(size=4)
        out[at : at + 4] = q / np.linalg.norm(q)
    return out


def _compare_bodies(outcome: Outcome, a: Any, b: Any) -> None:
    """Masses and world poses of every body of the same name, at the state of the scene."""
    import mujoco

    states = [mujoco.MjData(a), mujoco.MjData(b)]
    for model, state in zip((a, b), states, strict=True):
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, state, 0)
    for j in range(a.njnt):
        if a.jnt_limited[j] and int(a.jnt_type[j]) in (2, 3):
            at = int(a.jnt_qposadr[j])
            states[0].qpos[at] = np.clip(states[0].qpos[at], *a.jnt_range[j])
    for model, state in zip((a, b), states, strict=True):
        mujoco.mj_kinematics(model, state)
        mujoco.mj_comPos(model, state)
    moving = [k for k in range(1, a.nbody) if a.body_weldid[k] != 0 and a.body_mocapid[a.body_rootid[k]] < 0]
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
            outcome.compare("position", error, 0.0, POSE, f"center of mass of body {name}")
        angle = Pose.of(q=states[0].xquat[k]).angle_to(Pose.of(q=states[1].xquat[i]))
        outcome.compare("angle", angle, 0.0, POSE * 10, f"body {name}")
