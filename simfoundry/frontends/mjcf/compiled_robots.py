"""Robots in MJCF that SimFoundry compiled: taken out of the model with all that belongs to them, and named."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from simfoundry.frontends.compiled_robot import robot_draft
from simfoundry.frontends.draft import Draft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.mjcf.compiled import Said
from simfoundry.frontends.mjcf.elements import read_camera
from simfoundry.geometry.frames import Pose

SAID, MOUNT = ":robot", ":mount"


def take_robots(draft: Draft, path: Path, mujoco: Any, model: Any, own: Said) -> Any:
    """Put the robots of a file and the cameras that ride on them into ``draft``; returns the model without them."""
    names = [name.removesuffix(SAID) for name in own.texts if name.endswith(SAID)]
    roots = {mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, name): name for name in names}
    roots.pop(-1, None)
    if not roots:
        return model
    for body, name in roots.items():
        X_WB = Pose.of(model.body_pos[body], model.body_quat[body])
        draft.robots.append(robot_draft(path, name, _words(path, name, own), X_WB))
    for k in range(model.ncam):
        root = int(model.body_rootid[model.cam_bodyid[k]])
        if root in roots:
            _take_camera(draft, mujoco, model, own, k, roots[root])
    return _without(path, mujoco, list(roots.values()))


def _words(path: Path, name: str, own: Said) -> dict[str, Any]:
    try:
        words = json.loads(own.texts[f"{name}{SAID}"])
    except ValueError:
        words = None
    if not isinstance(words, dict):
        raise ImportRefusedError(path, f"robot `{name}` is not as compiled files have it: its text is no JSON object")
    return words


def _take_camera(draft: Draft, mujoco: Any, model: Any, own: Said, k: int, robot: str) -> None:
    """A camera on one of the robot's frames; where no text says on which, on the link that carries it."""
    camera = read_camera(draft, mujoco, model, k)
    if camera is None:
        return
    body = mujoco.mj_id2name(model, mujoco.mjtObj.mjOBJ_BODY, int(model.cam_bodyid[k]))
    frame = own.texts.get(f"{camera.name}{MOUNT}", "")
    site = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_SITE, f"{robot}.{frame}")
    if site >= 0:
        camera.X_WC = Pose.of(model.site_pos[site], model.site_quat[site]).inverse() @ camera.X_WC
    camera.mount = (robot, frame or body.removeprefix(robot).removeprefix("."))
    draft.cameras.append(camera)


def _without(path: Path, mujoco: Any, robots: list[str]) -> Any:
    """The model without some bodies of the world. Theirs are the last coordinates: a robot comes after all objects."""
    spec = mujoco.MjSpec.from_file(str(path))
    state = [(key.name, list(key.qpos), list(key.ctrl)) for key in spec.keys]
    for key in list(spec.keys):
        spec.delete(key)
    for name in robots:
        spec.delete(spec.body(name))
    model = spec.compile()
    for name, qpos, ctrl in state:
        spec.add_key(name=name, qpos=qpos[: model.nq], ctrl=ctrl[: model.nu])
    return spec.compile()
