"""Load this world: ``load()`` returns where each object's URDF is and how to pose it; ``python load.py`` lists them.

It needs nothing but Python: hand each file to the URDF reader of your simulator, with its base fixed or free as said.
"""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent


@dataclass(frozen=True)
class Placed:
    """One object: its URDF, whether its base is fixed, the pose of its root link in the world, its joint positions.

    ``p`` [m]; ``q_wxyz`` a unit quaternion, w first; ``joints`` [m or rad] by name.
    """

    urdf: Path
    fixed: bool
    p: tuple[float, float, float]
    q_wxyz: tuple[float, float, float, float]
    joints: dict[str, float]


def load() -> dict[str, Placed]:
    """Every object by name. A missing file raises FileNotFoundError."""
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
    """Say what is there."""
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
