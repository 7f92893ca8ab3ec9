"""The cameras of a scene as a world moves: those that ride on links where they are now, and pictures of any size."""

from __future__ import annotations

from dataclasses import replace

from simfoundry.scene.kinematics import link_poses
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
        state = world.state()
        X_OL = link_poses(item, state.of_object(item))[mounted.link or item.root.name]
        X_WL = state.poses[item.name] @ X_OL
    return replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)


def camera_of(world: World, name: str, width: int, height: int) -> Camera:
    """The camera called ``name`` as it is now, for pictures of another size; a KeyError lists the names there are."""
    for camera in world.scene.cameras:
        if camera.name == name:
            return resized(camera, width, height)
    for mounted in world.scene.mounted:
        if mounted.camera.name == name:
            return resized(camera_now(world, mounted), width, height)
    known = [c.name for c in world.scene.cameras] + [m.camera.name for m in world.scene.mounted]
    raise KeyError(f"no camera {name!r}; there are: {', '.join(known) or 'none'}")


def resized(camera: Camera, width: int, height: int) -> Camera:
    """The camera with ``width`` x ``height`` pixels: scaled evenly, and cut at the middle where the shape is another.

    As a picture of its own size, scaled until it covers the new one, and cropped alike on both sides.
    """
    scale = max(width / camera.width, height / camera.height)
    off_x, off_y = (camera.width * scale - width) / 2, (camera.height * scale - height) / 2
    # Pixel centres are integers, so the picture begins at -0.5.
    cx, cy = (camera.cx + 0.5) * scale - 0.5 - off_x, (camera.cy + 0.5) * scale - 0.5 - off_y
    return replace(camera, width=width, height=height, fx=camera.fx * scale, fy=camera.fy * scale, cx=cx, cy=cy)
