"""Check what cameras are mounted on and look at."""

from __future__ import annotations

from typing import TYPE_CHECKING

from simfoundry.spec.check.checker import Checker, Path_

if TYPE_CHECKING:
    from simfoundry.spec.check.names import SceneNames


def check_mount(c: Checker, names: SceneNames, mount: str, path: Path_) -> None:
    """Check the name of the object, link or robot link that a camera is attached to."""
    carrier, _, link = mount.partition(".")
    if carrier not in names.robots:
        known = c.name(carrier, [*names.robots, *names.objects], path, "robot or object")
        if known and link not in names.links(carrier):
            names.check_link(c, mount, path)
        return
    robot = names.spec.robots.get(carrier) if names.spec is not None else None
    described = robot.known() if robot is not None and link else None
    if described is not None:
        c.name(link, described.links, path, f"link of `{carrier}`", len(carrier) + 1)


def check_target(c: Checker, names: SceneNames, target: str, mount: str | None, path: Path_) -> None:
    """Check the name of the object, link or robot that a camera looks at."""
    owner, _, part = target.partition(".")
    if mount is not None and mount.partition(".")[0] in names.robots:
        message = "a camera on a robot cannot look at a name, because the robot moves it"
        c.add("SF107", path, message, "give a point in the frame of the robot's link, or `quat_wxyz`")
    elif not c.name(owner, [*names.objects, *names.robots], path, "object or robot"):
        return
    elif owner not in names.robots:
        names.check_part(c, target, path)
        if mount is not None and mount == target:
            c.add("SF107", path, "a camera cannot look at the object that it is mounted on", "give a point")
    elif part:
        c.add("SF107", path, f"a camera can look at the base of a robot, but not at its link `{part}`", "give a point")
