"""Short summaries of scenes."""

from __future__ import annotations

import math
from typing import Any

from simfoundry.geometry.frames import IDENTITY
from simfoundry.geometry.shapes import Mesh
from simfoundry.scene.model import Joint, JointType, Scene, SceneObject
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.models.base import Estimate
from simfoundry.spec.models.scene import SceneSpec


def summary(scene: Scene, spec: SceneSpec) -> dict[str, Any]:
    """Return the key facts about a scene and its objects as plain data.

    For each object, these include the size [m], the mass [kg] and its uncertainty, the position [m], the joints, and
    the support.
    """
    places = {name: item.place for name, item in spec.objects.items() if item.place is not None}
    carried_by = {name: (place.on or place.inside or "").partition(".")[0] for name, place in places.items()}
    carried_by |= {r.args[0]: r.args[1] for r in scene.relations if r.predicate == "OnTop"}
    objects = {o.name: _object(o, spec, carried_by.get(o.name)) for o in scene.objects}
    cameras = {c.name: {"size": [c.width, c.height]} for c in (*scene.cameras, *(m.camera for m in scene.mounted))}
    mounts = {m.camera.name: spec.cameras[m.camera.name].mount for m in scene.mounted}
    robots = {r.name: {"kind": r.kind, "models": [form.value for form in r.models]} for r in scene.robots}
    facts = {"name": scene.name, "objects": objects, "cameras": cameras, "mounts": mounts, "robots": robots}
    left_out = {part.path: part.reason for part in scene.left_out}
    return facts | {"left_out": left_out, "relations": [str(r) for r in scene.relations]}


def tree(facts: dict[str, Any]) -> str:
    """Format the facts from :func:`summary` as a tree in which objects are indented below their supports."""
    objects: dict[str, Any] = facts["objects"]
    children: dict[str | None, list[str]] = {}
    for name, item in objects.items():
        parent = item["on"] if item["on"] in objects and item["on"] != name else None
        children.setdefault(parent, []).append(name)
    total = sum(o["mass"] for o in objects.values() if not o["fixed"])
    lines, shown = [f"{facts['name']}  {len(objects)} objects, {total:.3g} kg"], set[str]()

    def branch(name: str, prefix: str, last: bool) -> None:
        if name in shown:
            return
        shown.add(name)
        lines.append(f"{prefix}{'└─ ' if last else '├─ '}{_line(name, objects[name])}")
        below = f"{prefix}{'   ' if last else '│  '}"
        lines.extend(f"{below}   ~ {joint}" for joint in objects[name]["joints"])
        inside = children.get(name, [])
        for k, child in enumerate(inside):
            branch(child, below, k == len(inside) - 1)

    roots = _roots(objects, children)
    for k, name in enumerate(roots):
        branch(name, "", k == len(roots) - 1)
    for name, robot in facts["robots"].items():
        lines.append(f"robot {name}  {robot['kind']}  {', '.join(robot['models'])}")
    for name, camera in facts["cameras"].items():
        carried = f"  on {facts['mounts'][name]}" if name in facts["mounts"] else ""
        lines.append(f"camera {name}  {camera['size'][0]} x {camera['size'][1]}{carried}")
    lines.extend(f"without {path}: {reason}" for path, reason in facts["left_out"].items())
    return "\n".join(lines)


def _roots(objects: dict[str, Any], children: dict[str | None, list[str]]) -> list[str]:
    """Return the objects without a support, and the first object in each `OnTop` cycle, because a cycle has no root."""
    roots, below = list[str](), set[str]()
    for name in (*children.get(None, []), *objects):
        if name not in below:
            roots.append(name)
            todo = [name]
            while todo:
                one = todo.pop()
                if one not in below:
                    below.add(one)
                    todo += children.get(one, [])
    return roots


def _line(name: str, item: dict[str, Any]) -> str:
    size = " x ".join(f"{100 * v:.1f}" for v in item["size"])
    weight = "fixed" if item["fixed"] else f"{item['mass']:.3g} kg"
    if item["mass_range"] and not item["fixed"]:
        weight += f" ({item['mass_range'][0]:.3g} to {item['mass_range'][1]:.3g}, {item['mass_by']})"
    parts = f"{item['colliders']} collider{'s' if item['colliders'] != 1 else ''}"
    if item["collision_error"]:
        parts += f" ({', '.join(item['collider_shapes'])}) within {1000 * item['collision_error']:.2g} mm"
    return f"{name}  {item['shape']} {size} cm  {weight}  {parts}"


def _joint(joint: Joint) -> str:
    if joint.has_axis:
        return f"{joint.name}  {joint.type.value}  at {joint.position:.3g}"
    return f"{joint.name}  {joint.type.value}  turned by {math.degrees(joint.motion.angle_to(IDENTITY)):.3g} deg"


def _object(item: SceneObject, spec: SceneSpec, on: str | None) -> dict[str, Any]:
    written = spec.objects[item.name]
    estimate = written.mass if isinstance(written.mass, Estimate) else None
    colliders = [c for link in item.links for c in link.colliders]
    joints = [_joint(joint) for joint in item.joints if joint.type is not JointType.FIXED]
    low, high = bounds(item)
    kind = f"{len(item.links)} links" if len(item.links) > 1 else "mesh"
    if written.shape is not None:
        kind = next(iter(type(written.shape).model_fields))
    return {
        "category": item.category,
        "shape": kind,
        "size": [round(float(v), 4) for v in high - low],
        "fixed": item.fixed,
        "mass": math.fsum(link.mass for link in item.links),
        "mass_range": list(estimate.range) if estimate is not None and estimate.range is not None else None,
        "mass_by": estimate.source if estimate is not None else None,
        "xyz": [round(float(v), 4) for v in item.X_WO.p],
        "colliders": len(colliders),
        "collider_shapes": sorted(
            {"convex part" if isinstance(c.geometry, Mesh) else type(c.geometry).__name__.lower() for c in colliders}
        ),
        "collision_error": max((link.collision_error for link in item.links), default=0.0),
        "joints": joints,
        "on": on,
    }
