"""Load this world from URDF.

``load()`` returns the URDF and the pose of each object, and ``python load.py`` lists them.

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
    """An object with its URDF and its placement.

    Attributes:
        urdf: URDF file.
        fixed: True if the base is fixed.
        p: Position of the root link in the world [m].
        q_wxyz: Orientation of the root link in the world, a unit quaternion with w first.
        joints: Joint positions by name [m or rad].
    """

    urdf: Path
    fixed: bool
    p: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]
    joints: dict[str, float]


def load() -> dict[str, Placed]:
    """Return all objects by name.

    Raises:
        FileNotFoundError: If a file is missing.
    """
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
