"""OmniGibson: a scene JSON for its own tools, and one USD for each object, which the JSON refers to."""

from __future__ import annotations

import json
from dataclasses import replace

from simfoundry.backends.artifact import number
from simfoundry.backends.usd import compile_usd
from simfoundry.geometry.frames import IDENTITY, Array, to_xyzw
from simfoundry.scene.model import JointType, Scene, SceneObject

SCENE_FILE = "scene.json"


def omnigibson_files(scene: Scene) -> dict[str, bytes]:
    """Return ``scene.json`` and ``objects/<object>.usda``; meshes and textures are in ``assets``, as in the stage."""
    files = {f"objects/{item.name}.usda": _object_layer(scene, item) for item in scene.objects}
    return {SCENE_FILE: scene_json(scene), **files}


def scene_json(scene: Scene) -> bytes:
    """Return the scene in OmniGibson's save format: its objects and their state; quaternions are xyzw."""
    info = {item.name: _info(item) for item in scene.objects}
    state = {item.name: _state(item) for item in scene.objects}
    data = {
        "metadata": {},
        "versions": {},
        "init_info": {
            "class_module": "omnigibson.scenes.scene_base",
            "class_name": "Scene",
            "args": {"use_floor_plane": False, "floor_plane_visible": False},
        },
        "objects_info": {"init_info": info},
        # `Scene.__init__` and `restore` read the keys of both registries; our scenes have no particle systems.
        "state": {"registry": {"object_registry": state, "system_registry": {}}},
    }
    return (json.dumps(data, indent=2) + "\n").encode()


def _info(item: SceneObject) -> dict[str, object]:
    arguments = {
        "name": item.name,
        "usd_path": f"objects/{item.name}.usda",
        "category": item.category,
        "scale": [1.0, 1.0, 1.0],
        "fixed_base": item.fixed,
        "visual_only": False,
    }
    return {"class_module": "omnigibson.objects.usd_object", "class_name": "USDObject", "args": arguments}


def _state(item: SceneObject) -> dict[str, object]:
    still = [0.0, 0.0, 0.0]
    root = {"pos": _numbers(item.X_WO.p), "ori": _numbers(to_xyzw(item.X_WO.q)), "lin_vel": still, "ang_vel": still}
    # PhysX numbers joints by the links that they move, outward from the root; the file does not name them.
    rank = {link.name: k for k, link in enumerate(item.links)}
    moving = sorted((j for j in item.joints if j.type is not JointType.FIXED), key=lambda j: rank[j.child])
    positions = [float(number(joint.position)) for joint in moving]
    joints = {"joint_pos": positions, "joint_vel": [0.0] * len(positions)} if positions else {}
    return {"root_link": root, **joints}


def _object_layer(scene: Scene, item: SceneObject) -> bytes:
    """Return a layer whose default prim is the object in its own frame, with its materials below it."""
    from pxr import Sdf

    # Joints are at zero in the file, because OmniGibson sets the positions of its state itself.
    rest = tuple(replace(joint, position=0.0) for joint in item.joints)
    alone = replace(
        scene,
        objects=(replace(item, X_WO=IDENTITY, joints=rest, variant="", variants=()),),
        cameras=(),
        robots=(),
        mounted=(),
        lights=(),
        relations=(),
        background=None,
        left_out=(),
        no_contact=(),
    )
    whole = Sdf.Layer.CreateAnonymous(".usda")
    whole.ImportFromString(compile_usd(alone).files["scene.usda"].decode())
    layer = Sdf.Layer.CreateAnonymous(".usda")
    for key in ("kilogramsPerUnit", "metersPerUnit", "upAxis"):
        layer.pseudoRoot.SetInfo(key, whole.pseudoRoot.GetInfo(key))
    layer.defaultPrim = item.name
    Sdf.CopySpec(whole, f"/World/Objects/{item.name}", layer, f"/{item.name}")
    for scope in ("Looks", "Contacts"):
        Sdf.CopySpec(whole, f"/World/{scope}", layer, f"/{item.name}/{scope}")
    text: str = layer.ExportToString()
    moved = {
        f"</World/Objects/{item.name}": f"</{item.name}",
        "</World/Looks/": f"</{item.name}/Looks/",
        "</World/Contacts/": f"</{item.name}/Contacts/",
        "@./assets/": "@../assets/",
    }
    for old, new in moved.items():
        text = text.replace(old, new)
    return text.encode()


def _numbers(values: Array) -> list[float]:
    return [float(number(v)) for v in values]
