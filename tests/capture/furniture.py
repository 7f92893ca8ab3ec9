"""Random pieces of furniture with one joint, and captures of them, shut and opened."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

import simfoundry as sf
from simfoundry.capture.synthesize import synthesize
from simfoundry.geometry.frames import Array, Pose, look_at, quat_from_rpy
from simfoundry.scene.model import Camera

KINDS = ("drawer", "door", "lid", "flap")

# Thickness of panels [m], and height above the table so that flaps do not touch it [m].
PANEL, FOOT = 0.012, 0.02


@dataclass(frozen=True, eq=False)
class Furniture:
    """A piece of furniture: the boxes of its body and of its part as (size, center), and its joint."""

    body: Mapping[str, tuple[Array, Array]]
    part: Mapping[str, tuple[Array, Array]]
    type: str
    axis: Array
    pivot: Array
    opened: float
    limit: float

    def text(self) -> str:
        """Return the asset document."""
        name, limit = ("limits", self.limit) if self.type == "prismatic" else ("limits_deg", math.degrees(self.limit))
        lines = ["simfoundry: asset/1", "name: furniture", "links:"]
        for link, boxes in (("body", self.body), ("part", self.part)):
            lines += [f"  {link}:", "    material: wood", "    parts:"]
            lines += [
                f"      {key}: {{shape: {{box: {_row(size)}}}, pose: {{xyz: {_row(at)}}}}}"
                for key, (size, at) in boxes.items()
            ]
        lines += ["joints:", "  joint:", f"    type: {self.type}", "    parent: body", "    child: part"]
        lines += [
            f"    pose: {{xyz: {_row(self.pivot)}}}",
            f"    axis: {_row(self.axis)}",
            f"    {name}: [0, {limit:.4f}]",
        ]
        lines += ["materials:", "  wood: {density: 650, color: [0.72, 0.53, 0.34]}", ""]
        return "\n".join(lines)


@dataclass(frozen=True, eq=False)
class Captured:
    """Two captures of a piece of furniture, and its joint in the world of the scene that was captured."""

    shut: Path
    opened: Path
    furniture: Furniture
    axis: Array
    pivot: Array
    X_WC: Sequence[Pose]


def furniture(kind: str, rng: np.random.Generator) -> Furniture:
    """Return a random piece of furniture that opens toward +x, or upward if it has a lid."""
    w, d, h, t = rng.uniform(0.25, 0.5), rng.uniform(0.22, 0.4), rng.uniform(0.2, 0.45), PANEL
    if kind == "lid":
        h = rng.uniform(0.12, 0.25)
        part = {"lid": _b((d, w, t), (d / 2, 0, t / 2))}
        body = _walls(w, d, h) | {"front": _b((t, w, h - t), (d / 2 - t / 2, 0, (h + t) / 2))}
        return Furniture(
            body, part, "revolute", np.array([0, -1.0, 0]), np.array([-d / 2, 0, h]), rng.uniform(0.5, 1.7), 1.9
        )
    body = _walls(w, d, h) | {"top": _b((d, w, t), (0, 0, h - t / 2))}
    if kind == "drawer":
        return _drawers(body, w, d, h, rng)
    if kind == "door":
        side = 1.0 if rng.random() < 0.5 else -1.0
        part = {"panel": _b((t, w - 0.004, h - 0.004), (0, -side * w / 2, 0))}
        if rng.random() < 0.6:
            part["handle"] = _b((0.025, 0.012, 0.1), (0.018, -side * (w - 0.04), 0))
        body["shelf"] = _b((d - 2 * t, w - 2 * t, t), (0, 0, h / 2))
        pivot = np.array([d / 2 + t / 2, side * w / 2, h / 2])
        return Furniture(body, part, "revolute", np.array([0, 0, side]), pivot, rng.uniform(0.4, 1.9), 2.0)
    part = {"panel": _b((t, w - 0.004, h - 0.004), (0, 0, h / 2))}
    if rng.random() < 0.7:
        part["handle"] = _b((0.025, 0.7 * w, 0.012), (0.02, 0, h - 0.04))
    pivot = np.array([d / 2 + t / 2, 0, 0])
    return Furniture(body, part, "revolute", np.array([0, 1.0, 0]), pivot, rng.uniform(0.4, 1.5), 1.6)


def _drawers(body: dict[str, tuple[Array, Array]], w: float, d: float, h: float, rng: np.random.Generator) -> Furniture:
    t, count = PANEL, int(rng.integers(2, 4))
    k, high, deep = int(rng.integers(count)), (h - 2 * PANEL) / count, d - 0.03
    fronts = {
        f"front_{i}": _b((t, w - 2 * t, high - 0.006), (d / 2 - t / 2, 0, t + high * (i + 0.5))) for i in range(count)
    }
    fronts.pop(f"front_{k}")
    part = {
        "front": _b((t, w - 2 * t, high - 0.006), (0, 0, 0)),
        "floor": _b((deep, w - 4 * t, 0.006), (-deep / 2, 0, -high / 2 + 0.012)),
        "left": _b((deep, 0.008, 0.7 * high), (-deep / 2, w / 2 - 2 * t, -0.01)),
        "right": _b((deep, 0.008, 0.7 * high), (-deep / 2, -w / 2 + 2 * t, -0.01)),
        "back": _b((0.008, w - 4 * t, 0.7 * high), (-deep, 0, -0.01)),
    }
    if rng.random() < 0.6:
        part["handle"] = _b((0.02, 0.1, 0.012), (0.016, 0, 0))
    pivot = np.array([d / 2 - t / 2, 0, t + high * (k + 0.5)])
    return Furniture(
        body | fronts, part, "prismatic", np.array([1.0, 0, 0]), pivot, rng.uniform(0.06, 0.6 * d), 0.7 * d
    )


def _walls(w: float, d: float, h: float) -> dict[str, tuple[Array, Array]]:
    t = PANEL
    return {
        "bottom": _b((d, w, t), (0, 0, t / 2)),
        "left": _b((d, t, h - 2 * t), (0, w / 2 - t / 2, h / 2)),
        "right": _b((d, t, h - 2 * t), (0, -w / 2 + t / 2, h / 2)),
        "back": _b((t, w - 2 * t, h - 2 * t), (-d / 2 + t / 2, 0, h / 2)),
    }


def _b(size: Sequence[float], center: Sequence[float]) -> tuple[Array, Array]:
    return np.array(size, float), np.array(center, float)


def _row(values: Array) -> str:
    return f"[{', '.join(f'{value:.5f}' for value in values)}]"


def captured(
    folder: Path, kind: str, seed: int, width: int = 640, moves: bool = False, opened: float | None = None
) -> Captured:
    """Write two captures of random furniture. If the camera moves in between, each states its pose.

    ``opened`` is the position of the joint in the second one [m or rad]; by default, it is random.
    """
    rng = np.random.default_rng([seed, KINDS.index(kind)])
    made = furniture(kind, rng)
    if opened is not None:
        made = replace(made, opened=opened)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "furniture.asset.yaml").write_text(made.text())
    yaw, (x, y) = float(rng.uniform(-35, 35)), rng.uniform(-0.1, 0.1, 2)
    X_WA = Pose.of([x, y, FOOT], quat_from_rpy(0, 0, math.radians(yaw)))
    poses, folders = [], []
    for k, position in enumerate((0.0, made.opened)):
        scene = folder / f"{kind}_{k}.scene.yaml"
        scene.write_text(
            f"simfoundry: scene/1\nname: {kind}\nobjects:\n"
            "  table: {fixed: true, mass: 20, shape: {box: [2.4, 2.4, 0.04]}, pose: {xyz: [0, 0, -0.02]}}\n"
            f"  furniture: {{asset: furniture.asset.yaml, fixed: true, joints: {{joint: {position:.5f}}},"
            f" pose: {{xyz: [{x:.5f}, {y:.5f}, {FOOT}], yaw_deg: {yaw:.5f}}}}}\n"
        )
        if k == 0 or moves:
            eye = _eye(yaw, rng)
        X_WC = look_at(eye, np.array([0, 0, 0.15]))
        f = 600 * width / 640
        camera = Camera("front", width, width * 3 // 4, f, f, (width - 1) / 2, (width * 3 // 4 - 1) / 2, X_WC)
        path = synthesize(sf.load(scene).lower(), camera, folder / f"{kind}_{k}", seed + k)
        if moves:
            pose = f"    pose: {{xyz: {_row(X_WC.p)}, quat_wxyz: [{', '.join(f'{v:.7f}' for v in X_WC.q)}]}}\n"
            path.write_text(path.read_text().replace("    color: color.png\n", f"    color: color.png\n{pose}"))
        poses.append(X_WC)
        folders.append(path.parent)
    axis, pivot = X_WA.rotation @ made.axis, X_WA.apply(made.pivot[None])[0]
    return Captured(folders[0], folders[1], made, axis, pivot, poses)


def _eye(yaw: float, rng: np.random.Generator) -> Array:
    """Return the position of a camera that sees the front of furniture with a yaw [deg]."""
    around, above, away = np.radians(yaw + rng.uniform(-45, 45)), np.radians(rng.uniform(20, 45)), rng.uniform(0.8, 1.2)
    direction = np.array([np.cos(around) * np.cos(above), np.sin(around) * np.cos(above), np.sin(above)])
    return np.asarray(away * direction + [0, 0, 0.15])
