"""Cameras of a world at their current poses, including those mounted on links, for images of any size."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, MountedCamera
from simfoundry.worlds.base import World


def camera_now(world: World, mounted: MountedCamera) -> Camera:
    """Return the camera at its current pose in the world."""
    scene = world.scene
    if any(robot.name == mounted.carrier for robot in scene.robots):
        robot = scene.robot(mounted.carrier)
        X_WL = world.robot(mounted.carrier).frame(mounted.link) if mounted.link else robot.X_WB
    else:
        item = scene.object(mounted.carrier)
        state = world.state()
        X_OL = link_poses(item, state.of_object(item))[mounted.link or item.root.name]
        X_WL = state.poses[item.name] @ X_OL
    return replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)


def camera_of(world: World, name: str, width: int, height: int) -> Camera:
    """Return the current camera ``name`` for another image size; raise a KeyError with the valid names if unknown."""
    for camera in world.scene.cameras:
        if camera.name == name:
            return resized(camera, width, height)
    for mounted in world.scene.mounted:
        if mounted.camera.name == name:
            return resized(camera_now(world, mounted), width, height)
    known = [c.name for c in world.scene.cameras] + [m.camera.name for m in world.scene.mounted]
    raise KeyError(f"no camera {name!r}; there are: {', '.join(known) or 'none'}")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """Return the camera with ``width`` x ``height`` pixels, scaled uniformly and cropped if the aspect ratio differs.

    The result equals the original image scaled to cover the new one and then cropped equally on both sides.
    """
    scale = max(width / camera.width, height / camera.height)
    off_x, off_y = (camera.width * scale - width) / 2, (camera.height * scale - height) / 2
    # Pixel centers have integer coordinates, so the image begins at -0.5.
    cx, cy = (camera.cx + 0.5) * scale - 0.5 - off_x, (camera.cy + 0.5) * scale - 0.5 - off_y
    return replace(camera, width=width, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=cx, cy=cy)
