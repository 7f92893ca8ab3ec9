"""The scene that compilers are timed on: a table, and on it boxes, cylinders and spheres in turn on a grid.

The same things in the same places as a document of ours, and as MJCF for the converters that start from that.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import NamedTuple


class Thing(NamedTuple):
    """A thing of the grid: its kind, and where its middle is [m]."""

    name: str
    kind: str
    x: float
    y: float
    z: float


HALF_HEIGHTS = {"box": 0.03, "cylinder": 0.03, "sphere": 0.02}
"""From the middle of a kind to the table [m]."""

SHAPES = {
    "box": "{box: [0.04, 0.05, 0.06]}",
    "cylinder": "{cylinder: {radius: 0.02, height: 0.06}}",
    "sphere": "{sphere: 0.02}",
}

MASSES = {"box": 0.1, "cylinder": 0.08, "sphere": 0.05}
"""Of each kind [kg]."""

GEOMS = {
    "box": 'type="box" size="0.02 0.025 0.03"',
    "cylinder": 'type="cylinder" size="0.02 0.03"',
    "sphere": 'type="sphere" size="0.02"',
}

TOP = 0.75
"""Height of the table's top [m]."""


def things(count: int) -> Iterator[Thing]:
    """``count`` things on a grid, 0.12 m apart, that stand on the table and do not touch each other."""
    side = math.ceil(math.sqrt(count))
    for k in range(count):
        kind = ("box", "cylinder", "sphere")[k % 3]
        x, y = (0.12 * (v - (side - 1) / 2) for v in (k % side, k // side))
        yield Thing(f"thing_{k}", kind, round(x, 6), round(y, 6), TOP + HALF_HEIGHTS[kind])


def table_size(count: int) -> float:
    """The side of a square table that holds so many things [m]."""
    return round(0.12 * (math.ceil(math.sqrt(count)) + 1), 6)


def document(count: int) -> str:
    """A ``scene/1`` document; what stands on the table is stated for each thing."""
    side = table_size(count)
    lines = [
        "simfoundry: scene/1",
        f"name: grid_{count}",
        "materials: {plastic: {density: 1000, friction: 0.7, restitution: 0.1, color: [0.8, 0.3, 0.2]}}",
        "objects:",
        f"  table: {{fixed: true, shape: {{box: [{side}, {side}, 0.03]}}, material: plastic,"
        f" pose: {{xyz: [0, 0, {TOP - 0.015}]}}}}",
    ]
    for thing in things(count):
        lines += [
            f"  {thing.name}:",
            f"    category: {thing.kind}",
            f"    shape: {SHAPES[thing.kind]}",
            "    material: plastic",
            f"    mass: {MASSES[thing.kind]}",
            f"    pose: {{xyz: [{thing.x}, {thing.y}, {thing.z:.6g}]}}",
        ]
    return "\n".join([*lines, "relations:", *(f"  - OnTop({t.name}, table)" for t in things(count)), ""])


def mjcf(count: int) -> str:
    """The same scene as MJCF, as short as it can be said."""
    half = table_size(count) / 2
    lines = [
        f'<mujoco model="grid_{count}"><compiler autolimits="true"/>',
        '<default><geom friction="0.7 0.005 0.0001"/></default>',
        f'<worldbody><body name="table" pos="0 0 {TOP - 0.015}"><geom type="box" size="{half} {half} 0.015"/></body>',
    ]
    lines += [
        f'<body name="{thing.name}" pos="{thing.x} {thing.y} {thing.z:.6g}"><freejoint name="{thing.name}_free"/>'
        f'<geom {GEOMS[thing.kind]} mass="{MASSES[thing.kind]}" rgba="0.8 0.3 0.2 1"/></body>'
        for thing in things(count)
    ]
    return "\n".join([*lines, "</worldbody></mujoco>", ""])
