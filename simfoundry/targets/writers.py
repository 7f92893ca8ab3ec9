"""Additional files that some simulators require besides the backend's files.

For example, OmniGibson reads a scene JSON that references one USD file per object.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path

from simfoundry.backends.artifact import rounded, rounded_list
from simfoundry.backends.usd import compile_usd
from simfoundry.geometry.frames import IDENTITY, to_xyzw
from simfoundry.scene.model import JointType, Scene, SceneObject
from simfoundry.targets.event_terms import asset_kind, events_file

SCENE_FILE = "scene.json"


def omnigibson_files(scene: Scene) -> dict[str, bytes]:
    """Return ``scene.json`` and the ``objects/<object>.usda`` files, which use meshes and textures from ``assets``."""
    files = {f"objects/{item.name}.usda": _object_layer(scene, item) for item in scene.objects}
    return {SCENE_FILE: scene_json(scene), **files}


def scene_json(scene: Scene) -> bytes:
    """Return the objects in a scene and their state in OmniGibson's save format, with xyzw quaternions."""
    settings = {"use_floor_plane": False, "floor_plane_visible": False}
    # `Scene.__init__` and `restore` read the keys of both registries, but our scenes have no particle systems.
    registry = {"object_registry": {item.name: _state(item) for item in scene.objects}, "system_registry": {}}
    data = {
        "metadata": {},
        "versions": {},
        "init_info": _constructor("scenes.scene_base", "Scene", settings),
        "objects_info": {"init_info": {item.name: _info(item) for item in scene.objects}},
        "state": {"registry": registry},
    }
    return (json.dumps(data, indent=2) + "\n").encode()


def _constructor(module: str, name: str, arguments: Mapping[str, object]) -> dict[str, object]:
    return {"class_module": f"omnigibson.{module}", "class_name": name, "args": arguments}


def _info(item: SceneObject) -> dict[str, object]:
    names = {"name": item.name, "usd_path": f"objects/{item.name}.usda", "category": item.category}
    settings = {"scale": [1.0, 1.0, 1.0], "fixed_base": item.fixed, "visual_only": False}
    return _constructor("objects.usd_object", "USDObject", names | settings)


def _state(item: SceneObject) -> dict[str, object]:
    root = {"pos": rounded_list(item.X_WO.p), "ori": rounded_list(to_xyzw(item.X_WO.q))}
    root |= {"lin_vel": [0.0, 0.0, 0.0], "ang_vel": [0.0, 0.0, 0.0]}
    # PhysX orders joints by the links they move, outward from the root; the file does not contain joint names.
    rank = {link.name: k for k, link in enumerate(item.links)}
    moving = sorted((j for j in item.joints if j.type is not JointType.FIXED), key=lambda j: rank[j.child])
    positions = [rounded(joint.position) for joint in moving]
    joints = {"joint_pos": positions, "joint_vel": [0.0] * len(positions)} if positions else {}
    return {"root_link": root, **joints}


def _object_layer(scene: Scene, item: SceneObject) -> bytes:
    """Return a layer whose default prim is the object, posed in the object's own frame.

    Materials are descendants of the prim.
    """
    from pxr import Sdf

    # Joints are at zero in the file, because OmniGibson sets their positions from its saved state.
    rest = tuple(replace(joint, position=0.0) for joint in item.joints)
    alone = replace(item, X_WO=IDENTITY, joints=rest, variant="", variants=())
    whole = Sdf.Layer.CreateAnonymous(".usda")
    files = compile_usd(Scene(scene.name, scene.gravity, (alone,), source=scene.source)).files
    whole.ImportFromString(files["scene.usda"].decode())
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for key in ("kilogramsPerUnit", "metersPerUnit", "upAxis"):
        layer.pseudoRoot.SetInfo(key, whole.pseudoRoot.GetInfo(key))
    layer.defaultPrim = item.name
    Sdf.CopySpec(whole, f"/World/Objects/{item.name}", layer, f"/{item.name}")
    for scope in ("Looks", "Contacts"):
        Sdf.CopySpec(whole, f"/World/{scope}", layer, f"/{item.name}/{scope}")
    text: str = layer.ExportToString()
    text = text.replace(f"</World/Objects/{item.name}", f"</{item.name}").replace("@./assets/", "@../assets/")
    return re.sub("</World/(Looks|Contacts)/", rf"</{item.name}/\1/", text).encode()


Writer = Callable[[Scene], Mapping[str, bytes]]


def objects_file(scene: Scene) -> dict[str, bytes]:
    """Return ``objects.json`` with gravity and each object's prim, joints and kind (static, rigid or articulated)."""
    data = {"gravity": rounded_list(scene.gravity), "objects": {item.name: _object(item) for item in scene.objects}}
    return {"objects.json": (json.dumps(data, indent=2) + "\n").encode()}


def environment_file(_: Scene) -> dict[str, bytes]:
    """Return ``environment.usda``, the stage without its physics scene, for simulators that clone stages."""
    return {"environment.usda": Path(__file__).with_name("environment.usda").read_bytes()}


def _object(item: SceneObject) -> dict[str, object]:
    prim = f"/World/Objects/{item.name}"
    moving = [joint for joint in item.joints if joint.type is not JointType.FIXED]
    return {
        "prim": prim,
        "body": f"{prim}/{item.root.name}",
        "kind": asset_kind(item),
        "p": rounded_list(item.X_WO.p),
        "q_wxyz": rounded_list(item.X_WO.q),
        "joints": {joint.name: rounded(joint.position) for joint in moving},
    }


# The writers that a profile can request under ``writes``.
WRITERS: dict[str, Writer] = {
    "objects": objects_file,
    "environment": environment_file,
    "events": events_file,
    "omnigibson": omnigibson_files,
}
