"""A scene of boxes for a BDDL problem: a thing of each name, with a drawer for each region of a fixture."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import yaml

from simfoundry.frontends.bddl.problem import BddlProblem
from simfoundry.frontends.names import plain_name


def write_scene(problem: BddlProblem, folder: Path) -> Path:
    """Write a scene with all things of a problem side by side; returns its file."""
    objects: dict[str, Any] = {}
    surfaces = {region.target for region in problem.regions.values() if region.ranges is not None}
    for k, (name, kind) in enumerate(problem.kinds.items()):
        if name.startswith("agent"):
            continue
        parts = [r.name for r in problem.regions.values() if r.target == name and r.ranges is None]
        item: dict[str, Any] = {"category": plain_name(kind.partition(".")[0]), "pose": {"xyz": [k * 1.0, 5.0, 0.05]}}
        if name in surfaces:
            item |= {"fixed": True, "shape": {"box": [2, 2, 0.1]}, "pose": {"xyz": [0.3, -0.1, -0.05], "yaw_deg": 90}}
        elif any(word in kind for word in ("cabinet", "microwave", "refrigerator", "caddy", "bucket", "ashcan")):
            item |= {"asset": _drawers(folder, kind, parts), "fixed": True}
        else:
            item |= {"shape": {"box": [0.06, 0.05, 0.1]}, "mass": 0.2}
        objects[plain_name(name)] = item
    path = folder / "scene.scene.yaml"
    path.write_text(yaml.safe_dump({"simfoundry": "scene/1", "name": "boxes", "objects": objects}, sort_keys=False))
    return path


def _drawers(folder: Path, kind: str, parts: list[str]) -> str:
    words = [plain_name(p).removesuffix("_region") for p in parts if p.endswith("_region")] or ["door"]
    links: dict[str, Any] = {"body": {"mass": 3, "parts": {"block": {"shape": {"box": [0.3, 0.3, 0.1]}}}}}
    joints: dict[str, Any] = {}
    for k, word in enumerate(words):
        box = {"shape": {"box": [0.2, 0.2, 0.05]}, "pose": {"xyz": [0, 0, 0.1 + 0.06 * k]}}
        links[f"{word}_link"] = {"mass": 0.5, "parts": {"block": box}}
        joints[f"{word}_joint"] = {
            "type": "prismatic", "parent": "body", "child": f"{word}_link", "axis": [1, 0, 0], "limits": [-0.2, 0],
        }  # fmt: skip
    name = f"{plain_name(kind)}.asset.yaml"
    document = {"simfoundry": "asset/1", "name": plain_name(kind), "links": links, "joints": joints}
    (folder / name).write_text(yaml.safe_dump(document, sort_keys=False))
    return name
