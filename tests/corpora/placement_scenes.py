"""Random small scenes of things that are stacked, contained, hung and leaning, each from one seed.

Most are things as they are: cups, bowls, boxes, pens, plates, shelves, pegs. Some are traps: a block that is nearly as
high as the one that carries, a frame around a mat, a cup turned over a ball, a tower just under a seat.
"""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene

Rng = np.random.Generator
Data = dict[str, Any]

DENSITY = 600.0
"""Of everything [kg/m^3]: wood."""

GAP = 0.001
"""How far over what carries it a thing begins [m]."""


class Builder:
    """Collects the objects and assets of one scene."""

    def __init__(self, rng: Rng) -> None:
        self.rng = rng
        self.objects: Data = {}
        self.assets: dict[str, Data] = {}

    def add(self, name: str, shape: Data, xyz: tuple[float, ...], rpy_deg: tuple[float, ...] = (0, 0, 0)) -> None:
        """Put an object of one shape, or of several boxes, somewhere."""
        item: Data = {"pose": {"xyz": [round(float(v), 5) for v in xyz], "rpy_deg": [float(v) for v in rpy_deg]}}
        if "parts" in shape:
            parts = {f"part_{k}": part for k, part in enumerate(shape["parts"])}
            self.assets[name] = {"density": DENSITY, "parts": parts}
            item["asset"] = f"{name}.asset.yaml"
            item["fixed"] = bool(shape.get("fixed"))
        else:
            item |= {"shape": shape, "density": DENSITY}
        self.objects[name] = item

    def scene(self, folder: Path, name: str) -> Scene:
        """Write the documents into a folder and lower them."""
        for asset, link in self.assets.items():
            document = {"simfoundry": "asset/1", "name": asset, "links": {"base": link}}
            (folder / f"{asset}.asset.yaml").write_text(json.dumps(document))
        desk = {"fixed": True, "shape": {"box": [2, 2, 0.04]}, "density": DENSITY, "pose": {"xyz": [0, 0, -0.02]}}
        file = folder / f"{name}.scene.yaml"
        file.write_text(json.dumps({"simfoundry": "scene/1", "name": name, "objects": {"desk": desk} | self.objects}))
        return lower_file(file)


# -- shapes ------------------------------------------------------------------------------------------------------------


def box(x: float, y: float, z: float) -> Data:
    return {"box": [round(float(v), 5) for v in (x, y, z)]}


def cylinder(radius: float, height: float) -> Data:
    return {"cylinder": {"radius": round(float(radius), 5), "height": round(float(height), 5)}}


def part(x: float, y: float, z: float, at: tuple[float, float, float], rpy_deg: tuple[float, ...] = (0, 0, 0)) -> Data:
    return {"shape": box(x, y, z), "pose": {"xyz": [round(float(v), 5) for v in at], "rpy_deg": list(rpy_deg)}}


def vessel(bottom: float, top: float, height: float, wall: float = 0.004) -> Data:
    """A cup, bowl or plate: radii at the bottom and at the rim [m]."""
    outer: list[list[float]] = [[0, 0], [bottom, 0], [top, height]]
    inner: list[list[float]] = [[top - wall, height], [max(bottom - wall, 0.006), wall], [0, wall]]
    return {"lathe": {"profile": [[round(float(v), 5) for v in p] for p in outer + inner]}}


def shelf(width: float, depth: float, heights: list[float], wall: float = 0.012, back: bool = True) -> Data:
    """Boards between two sides, open to +x; the heights of its rooms [m], from below."""
    total = sum(heights) + wall * (len(heights) + 1)
    parts = [part(depth, wall, total, (0, sign * (width - wall) / 2, total / 2)) for sign in (1, -1)]
    if back:
        parts.append(part(wall, width - 2 * wall, total, ((wall - depth) / 2, 0, total / 2)))
    z = wall / 2
    for height in [*heights, 0.0]:
        parts.append(part(depth, width - 2 * wall, wall, (0, 0, z)))
        z += height + wall
    return {"parts": parts}


def bin_(width: float, depth: float, height: float, wall: float = 0.006) -> Data:
    """A box without a lid."""
    return {
        "parts": [
            part(depth, width, wall, (0, 0, wall / 2)),
            *(part(wall, width, height, (s * (depth - wall) / 2, 0, height / 2)) for s in (1, -1)),
            *(part(depth, wall, height, (0, s * (width - wall) / 2, height / 2)) for s in (1, -1)),
        ]
    }


def frame(inner: float, height: float, wall: float = 0.015) -> Data:
    """Four walls without a floor, around a square [m]."""
    mid, long = inner / 2 + wall / 2, inner + 2 * wall
    return {
        "parts": [
            *(part(wall, long, height, (s * mid, 0, height / 2)) for s in (1, -1)),
            *(part(inner, wall, height, (0, s * mid, height / 2)) for s in (1, -1)),
        ]
    }


def stool(width: float, height: float, leg: float = 0.02, seat: float = 0.02) -> Data:
    off = width / 2 - leg / 2
    legs = [part(leg, leg, height - seat, (x * off, y * off, (height - seat) / 2)) for x in (1, -1) for y in (1, -1)]
    return {"parts": [part(width, width, seat, (0, 0, height - seat / 2)), *legs]}


def pegs(length: float, thick: float, height: float, tilt_deg: float) -> Data:
    """A wall with a peg toward +x that rises to its end."""
    lean = math.radians(tilt_deg)
    at = (length / 2 * math.cos(lean), 0.0, height + length / 2 * math.sin(lean))
    return {
        "fixed": True,
        "parts": [part(0.02, 0.3, height + 0.1, (-0.01, 0, (height + 0.1) / 2)),
                  part(length, thick, thick, at, (0, -tilt_deg, 0))],
    }  # fmt: skip


def small(rng: Rng) -> tuple[Data, float, float]:
    """Something to put somewhere: its shape, its height and how far it reaches sideways [m]."""
    kind = int(rng.integers(5))
    if kind == 0:
        x, y, z = rng.uniform(0.025, 0.06, 3)
        return box(x, y, z), float(z), math.hypot(x, y) / 2
    if kind == 1:
        r, h = rng.uniform(0.015, 0.03), rng.uniform(0.02, 0.07)
        return cylinder(r, h), float(h), float(r)
    if kind == 2:
        r = rng.uniform(0.015, 0.03)
        return {"sphere": round(float(r), 5)}, 2 * float(r), float(r)
    if kind == 3:
        r, h = rng.uniform(0.02, 0.035), rng.uniform(0.03, 0.06)
        return vessel(r, r * rng.uniform(1.0, 1.2), h, 0.003), float(h), float(r) * 1.2
    x, y, z = rng.uniform(0.06, 0.1), rng.uniform(0.04, 0.07), rng.uniform(0.008, 0.025)
    return box(x, y, z), float(z), math.hypot(x, y) / 2


def pair(rng: Rng, reach: float) -> tuple[float, float]:
    """Two numbers no farther from zero than ``reach``."""
    x, y = rng.uniform(-reach, reach, 2)
    return float(x), float(y)


def centered(shape: Data) -> bool:
    """Whether its frame is in its middle; else it is at the middle of its base."""
    return any(key in shape for key in ("box", "cylinder", "sphere", "capsule"))


def put(b: Builder, name: str, shape: Data, height: float, x: float, y: float, z: float, yaw: float) -> None:
    """Put a shape with its base at a height [m]."""
    b.add(name, shape, (x, y, z + GAP + (height / 2 if centered(shape) else 0)), (0, 0, yaw))


# -- placements --------------------------------------------------------------------------------------------------------


def stacked(b: Builder) -> None:
    """A stack of things, or one that spans two blocks, with blocks beside that are nearly as high."""
    rng = b.rng
    kind = int(rng.integers(5))
    if kind == 0:
        z, x, y = 0.0, 0.0, 0.0
        wide = rng.uniform(0.08, 0.14)
        for k in range(int(rng.integers(2, 5))):
            width, height = wide * rng.uniform(0.75, 1.0), rng.uniform(0.015, 0.05)
            shape = (
                box(width, width * rng.uniform(0.7, 1), height) if rng.random() < 0.6 else cylinder(width / 2, height)
            )
            put(b, f"level_{k}", shape, height, x, y, z, float(rng.uniform(0, 360)))
            z, wide = z + height + GAP, width
            x, y = x + rng.uniform(-0.25, 0.25) * width, y + rng.uniform(-0.25, 0.25) * width
        shape, height, _ = small(rng)
        put(b, "top", shape, height, x, y, z, float(rng.uniform(0, 360)))
    elif kind == 1:  # a plank on two blocks of one height, and a third that is lower by little
        height, lower, far = rng.uniform(0.03, 0.06), rng.uniform(0.0005, 0.004), rng.uniform(0.08, 0.14)
        put(b, "left", box(0.05, 0.05, height), height, 0, -far, 0, 0)
        put(b, "right", box(0.05, 0.05, height), height, 0, far, 0, 0)
        put(b, "low", box(0.04, 0.04, height - lower), height - lower, 0, 0, 0, 0)
        put(b, "plank", box(0.05, 2 * far + 0.08, 0.012), 0.012, 0, rng.uniform(-0.02, 0.02), height + GAP, 0)
        put(b, "cup", vessel(0.025, 0.03, 0.06), 0.06, 0, rng.uniform(-far, far), height + 2 * GAP + 0.012, 0)
    elif kind == 2:  # a tower under a stool, and something on it
        height, tower = rng.uniform(0.15, 0.25), rng.uniform(0.0015, 0.03)
        b.add("stool", stool(rng.uniform(0.2, 0.3), height), (0, 0, GAP), (0, 0, float(rng.uniform(0, 90))))
        x, y = rng.uniform(-0.05, 0.05, 2)
        tall = height - 0.02 - tower
        put(b, "tower", box(0.05, 0.05, tall), tall, x, y, 0, float(rng.uniform(0, 90)))
        shape, tall, _ = small(rng)
        put(b, "top", shape, tall, *pair(rng, 0.06), height + GAP, 0)
    elif kind == 3:  # vessels in one another, or a lid on one
        r, h = rng.uniform(0.04, 0.06), rng.uniform(0.04, 0.07)
        put(b, "lower", vessel(r, r * 1.4, h), h, 0, 0, 0, 0)
        if rng.random() < 0.5:
            put(b, "upper", vessel(r, r * 1.4, h), h, 0, 0, 0.6 * h, 0)
        else:
            put(b, "lid", cylinder(r * 1.5, 0.008), 0.008, *pair(rng, 0.005), h + GAP, 0)
            shape, tall, _ = small(rng)
            put(b, "top", shape, tall, *pair(rng, 0.02), h + 0.01 + GAP, 0)
    else:  # side by side, touching, and one on top of one of them
        height, step = rng.uniform(0.03, 0.07), rng.uniform(0.0, 0.006)
        put(b, "first", box(0.08, 0.08, height), height, 0, 0, 0, 0)
        put(b, "second", box(0.08, 0.08, height - step), height - step, 0.0803, 0, 0, 0)
        shape, tall, _ = small(rng)
        put(b, "top", shape, tall, rng.uniform(-0.02, 0.06), rng.uniform(-0.02, 0.02), height + GAP, 0)


def contained(b: Builder) -> None:
    """Things in vessels, bins, shelves and microwaves; few around which there are only walls."""
    rng = b.rng
    kind = int(rng.choice(7, p=[0.2, 0.2, 0.23, 0.17, 0.18, 0.01, 0.01]))
    if kind == 0:
        r, h = rng.uniform(0.06, 0.1), rng.uniform(0.04, 0.08)
        put(b, "bowl", vessel(r * 0.6, r, h), h, 0, 0, 0, 0)
        for k in range(int(rng.integers(1, 3))):
            shape, tall, _ = small(rng)
            x, y = rng.uniform(-0.4, 0.4, 2) * r
            put(b, f"thing_{k}", shape, tall, x, y, 0.01 + 0.075 * k, float(rng.uniform(0, 90)))
    elif kind == 1:
        r, h = rng.uniform(0.032, 0.05), rng.uniform(0.08, 0.12)
        put(b, "cup", vessel(r * 0.9, r, h), h, 0, 0, 0, 0)
        for k in range(int(rng.integers(1, 3))):
            pen = {"capsule": {"radius": 0.006, "height": round(float(rng.uniform(0.1, 0.16)), 4)}}
            side = rng.uniform(0, 360)
            lean = rng.uniform(3, 10)
            b.add(f"pen_{k}", pen, (0.008 * (2 * k - 1), 0, 0.105), (lean, 0, side))
    elif kind == 2:
        width, depth, rooms = rng.uniform(0.2, 0.4), rng.uniform(0.15, 0.28), int(rng.integers(1, 4))
        heights = [float(rng.uniform(0.12, 0.18)) for _ in range(rooms)]
        b.add(
            "shelf",
            shelf(width, depth, heights, back=rng.random() < 0.9),
            (0, 0, GAP),
            (0, 0, float(rng.uniform(0, 360))),
        )
        turn = math.radians(b.objects["shelf"]["pose"]["rpy_deg"][2])
        z = 0.012
        for k, height in enumerate(heights):
            shape, tall, reach = small(rng)
            x = rng.uniform(-depth / 2 + reach + 0.013, depth / 2 + 0.01)  # some stand out at the front
            y = rng.uniform(-1, 1) * max(0.0, width / 2 - reach - 0.015)
            put(b, f"thing_{k}", shape, tall, x * math.cos(turn) - y * math.sin(turn),
                x * math.sin(turn) + y * math.cos(turn), z + 2 * GAP, float(rng.uniform(0, 360)))  # fmt: skip
            z += height + 0.012
        shape, tall, _ = small(rng)
        put(b, "top", shape, tall, 0, 0, z + 2 * GAP, 0)
    elif kind == 3:
        width, depth, height = rng.uniform(0.15, 0.3), rng.uniform(0.15, 0.3), rng.uniform(0.05, 0.2)
        b.add("bin", bin_(width, depth, height), (0, 0, GAP), (0, 0, float(rng.uniform(0, 90))))
        for k in range(int(rng.integers(1, 4))):
            shape, tall, _ = small(rng)
            put(b, f"thing_{k}", shape, tall, *pair(rng, 0.035), 0.01 + 0.08 * k, float(rng.uniform(0, 90)))
    elif kind == 4:  # a vessel lies, or leans, with something in it
        r, h = rng.uniform(0.04, 0.06), rng.uniform(0.09, 0.13)
        b.add("cup", bin_(2 * r, 2 * r, h), (0, 0, r + GAP), (0, 90, 0))
        shape = box(*rng.uniform(0.02, 0.04, 3))
        b.add("thing", shape, (rng.uniform(0.02, h - 0.01), rng.uniform(-0.01, 0.01), 0.006 + 0.022), (0, 0, 0))
    elif kind == 5:
        inner = rng.uniform(0.042, 0.06)
        b.add("frame", frame(inner, rng.uniform(0.02, 0.06)), (0, 0, GAP))
        put(b, "mat", box(inner - 0.002, inner - 0.002, 0.01), 0.01, 0, 0, 0, 0)
        side = inner - rng.uniform(0.0015, 0.02)
        put(b, "cube", box(side, side, side), side, 0, 0, 0.011, 0)
    else:
        r, h = rng.uniform(0.04, 0.06), rng.uniform(0.07, 0.1)
        b.add("cup", vessel(r * 0.9, r, h), (0, 0, h + GAP), (180, 0, 0))
        ball = rng.uniform(0.015, 0.6 * r)
        put(b, "coaster", cylinder(0.02, 0.008), 0.008, 0, 0, 0, 0)
        b.add("ball", {"sphere": round(float(ball), 5)}, (0, 0, 0.01 + ball))


def hung(b: Builder) -> None:
    """Rings, mugs and hooks on pegs."""
    rng = b.rng
    thick, height, length = rng.uniform(0.006, 0.014), rng.uniform(0.2, 0.3), rng.uniform(0.06, 0.12)
    tilt = float(rng.uniform(0, 15))
    b.add("rack", pegs(length, thick, height, tilt), (0, 0, 0))
    kind = int(rng.choice(4, p=[0.33, 0.33, 0.32, 0.02]))
    along = rng.uniform(0.4, 0.8) * length
    top = height + along * math.tan(math.radians(tilt)) + thick / 2 / math.cos(math.radians(tilt)) + 0.003
    if kind == 0:  # a square ring
        inner = rng.uniform(0.03, 0.06)
        b.add("ring", frame(inner, 0.015, 0.01), (along - 0.0075, 0, top - inner / 2), (0, 90, 0))
    elif kind == 1:  # a mug by its handle: the body is a block with a loop on its side
        size, loop, wall = rng.uniform(0.05, 0.07), rng.uniform(0.03, 0.04), 0.008
        parts = [part(size, size, size, (0, 0, size / 2))]
        parts += [part(loop, 0.012, wall, (size / 2 + loop / 2, 0, z)) for z in (size / 2 - 0.02, size / 2 + 0.02)]
        parts += [part(wall, 0.012, 0.048, (size / 2 + loop, 0, size / 2))]
        # Its x to the world's z, its y to the world's x, its z to the world's y: it hangs by its handle.
        b.add("mug", {"parts": parts}, (along, -size / 2, top - loop - size / 2 + 0.004))
        b.objects["mug"]["pose"] |= {"quat_wxyz": [0.5, -0.5, -0.5, -0.5]}
        del b.objects["mug"]["pose"]["rpy_deg"]
    elif kind == 2:  # a hook over the peg
        long, wide = rng.uniform(0.06, 0.12), thick + rng.uniform(0.004, 0.012)
        parts = [part(0.012, 0.008, long, (0, -wide / 2 - 0.004, -long / 2)),
                 part(0.012, wide + 0.016, 0.008, (0, 0, 0.004)),
                 part(0.012, 0.008, 0.03, (0, wide / 2 + 0.004, -0.015))]  # fmt: skip
        b.add("hook", {"parts": parts}, (along, 0, top + GAP))
    else:  # a cup turned over the end of a standing rod
        rod = rng.uniform(0.1, 0.14)
        put(b, "rod", box(0.05, 0.05, rod), rod, 0.3, 0, 0, 0)
        h = rng.uniform(0.07, 0.09)
        b.add("cup", vessel(0.045, 0.05, h), (0.3, rng.uniform(-0.003, 0.003), rod + 0.004 + 2 * GAP), (180, 0, 0))
    if kind != 3 and rng.random() < 0.5:
        shape, tall, _ = small(rng)
        put(b, "below", shape, tall, along, rng.uniform(-0.02, 0.02), 0, 0)


def leaning(b: Builder) -> None:
    """Pens, boards and plates that lean against a block, a wall, a rim or a ledge."""
    rng = b.rng
    kind = int(rng.integers(4))
    lean = rng.uniform(20, 75)
    c, s = math.cos(math.radians(lean)), math.sin(math.radians(lean))
    if kind in (0, 1):  # a board or a pen on the edge of a block: its foot on the desk
        length, thick = rng.uniform(0.1, 0.2), rng.uniform(0.006, 0.012)
        share = rng.uniform(0.55, 0.95)
        height = share * length * s
        put(b, "block", box(0.12, 0.12, height), height, 0.06 + share * length * c, 0, 0, 0)
        at = (length / 2 * c - thick / 2 * s - 0.0005, 0, length / 2 * s + thick / 2 * c + 0.001)
        shape = box(length, rng.uniform(0.04, 0.08), thick) if kind == 0 else box(length, thick, thick)
        b.add("leaning", shape, at, (0, -lean, 0))
    elif kind == 2:  # a plank against a fixed wall
        length, thick = rng.uniform(0.1, 0.2), 0.008
        b.add("wall", {"fixed": True, "parts": [part(0.02, 0.4, 0.4, (0, 0, 0.2))]}, (0.01 + length * c + 0.0005, 0, 0))
        b.add("leaning", box(length, 0.05, thick),
              (length / 2 * c - thick / 2 * s, 0, length / 2 * s + thick / 2 * c + 0.0005), (0, -lean, 0))  # fmt: skip
    else:  # a spoon, flat or steep, over the rim of a plate or a bowl
        r, h = rng.uniform(0.05, 0.08), rng.uniform(0.015, 0.06)
        put(b, "bowl", vessel(r * 0.6, r, h), h, 0, 0, 0, 0)
        length = rng.uniform(0.12, 0.2)
        lean = math.degrees(math.asin(min(0.9, h / (length * rng.uniform(0.5, 0.9)))))
        c, s = math.cos(math.radians(lean)), math.sin(math.radians(lean))
        foot = r - h / max(math.tan(math.radians(lean)), 0.05) - rng.uniform(0.0, 0.01)
        b.add("leaning", box(length, 0.012, 0.006),
              (foot + length / 2 * c, rng.uniform(-0.01, 0.01), length / 2 * s + 0.012), (0, -lean, 0))  # fmt: skip
    if rng.random() < 0.4:
        shape, tall, _ = small(rng)
        put(b, "beside", shape, tall, rng.uniform(-0.02, 0.05), 0.15, 0, 0)


KINDS: dict[str, Callable[[Builder], None]] = {
    "stacked": stacked, "contained": contained, "hung": hung, "leaning": leaning,
}  # fmt: skip


def placement(seed: int, folder: Path) -> tuple[str, Scene]:
    """The kind of a seed, and its scene."""
    kind = list(KINDS)[seed % len(KINDS)]
    builder = Builder(np.random.default_rng(seed))
    KINDS[kind](builder)
    return kind, builder.scene(folder, f"placement_{seed}")
