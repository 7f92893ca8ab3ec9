"""Where cameras that ride on links are, as a world moves."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.scene.model import Camera, MountedCamera
from simfoundry.worlds.base import World


def camera_now(world: World, mounted: MountedCamera) -> Camera:
    """The camera at its pose in the world now, to be drawn like any other."""
    scene = world.scene
    if any(robot.name == mounted.carrier for robot in scene.robots):
        robot = scene.robot(mounted.carrier)
        X_WL = world.robot(mounted.carrier).frame(mounted.link) if mounted.link else robot.X_WB
    else:
        item = scene.object(mounted.carrier)
        X_WL = world.read_back()[item.qualified(mounted.link or item.root.name)].X_WL
    return replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)
