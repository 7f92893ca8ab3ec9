"""Load this world: ``load()`` returns the URDF and pose of each object; ``python load.py`` lists them.

This script has no dependencies. Pass each file to your simulator's URDF reader, with the base fixed or free as listed.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Placed:
    """An object: its URDF, a flag for a fixed base, the pose of its root link in the world, and its joint positions.

    ``p`` is in m, ``q_wxyz`` is a unit quaternion with w first, and ``joints`` contains positions [m or rad] by name.
    """

    urdf: Path
    fixed: bool
    p: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]
    joints: dict[str, float]


def load() -> dict[str, Placed]:
    """Return all objects by name; raise FileNotFoundError if a file is missing."""
    poses = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
    world = {
        name: Placed(HERE / item["urdf"], item["fixed"], tuple(item["p"]), tuple(item["q_wxyz"]), item["joints"])
        for name, item in poses.items()
    }
    for item in world.values():
        if not item.urdf.is_file():
            raise FileNotFoundError(item.urdf)
    return world


def main() -> None:
    """Load the world and print a summary."""
    world = load()
    for name, item in world.items():
        robot = ET.parse(item.urdf).getroot()
        x, y, z = item.p
        base = "fixed" if item.fixed else "free"
        links, joints = len(robot.findall("link")), len(robot.findall("joint"))
        print(f"{name}: {links} links, {joints} joints, {base} at {x:g} {y:g} {z:g}")
    print(f"loaded {HERE / 'poses.json'}: {len(world)} objects")


if __name__ == "__main__":
    main()
