"""Additional files that simulators read beside those of a backend."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping

from simfoundry.backends.artifact import number
from simfoundry.geometry.frames import Array
from simfoundry.scene.model import JointType, Scene, SceneObject
from simfoundry.targets.omnigibson import omnigibson_files

Writer = Callable[[Scene], Mapping[str, bytes]]

_ENVIRONMENT = """#usda 1.0
(
    defaultPrim = "World"
    metersPerUnit = 1
    subLayers = [@./scene.usda@]
    upAxis = "Z"
)

over "World"
{
    over "Physics" (
        active = false
    )
    {
    }
}
"""


def objects_file(scene: Scene) -> dict[str, bytes]:
    """Return ``objects.json``: gravity, and the prim, joints and kind (static, rigid or articulated) of each object."""
    data = {
        "gravity": _numbers(scene.gravity),
        "objects": {item.name: _object(item) for item in scene.objects},
    }
    return {"objects.json": (json.dumps(data, indent=2) + "\n").encode()}


def environment_file(_: Scene) -> dict[str, bytes]:
    """Return ``environment.usda``: the stage without its physics scene, for simulators that clone it."""
    return {"environment.usda": _ENVIRONMENT.encode()}


def _object(item: SceneObject) -> dict[str, object]:
    prim = f"/World/Objects/{item.name}"
    moving = [joint for joint in item.joints if joint.type is not JointType.FIXED]
    kind = "articulation" if item.joints and (moving or not item.fixed) else "static" if item.fixed else "rigid"
    return {
        "prim": prim,
        "body": f"{prim}/{item.root.name}",
        "kind": kind,
        "p": _numbers(item.X_WO.p),
        "q_wxyz": _numbers(item.X_WO.q),
        "joints": {joint.name: float(number(joint.position)) for joint in moving},
    }


def _numbers(values: Array) -> list[float]:
    return [float(number(v)) for v in values]


WRITERS: dict[str, Writer] = {
    "objects": objects_file,
    "environment": environment_file,
    "omnigibson": omnigibson_files,
}
"""The writers that a profile can request under ``writes``."""
