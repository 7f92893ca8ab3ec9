"""Lower the cameras of a scene, including those that look at an object, a link or a robot."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, LeftOut, MountedCamera, Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.surroundings import CameraSpec

if TYPE_CHECKING:
    from simfoundry.scene.lower import Lowering


def lower_cameras(lowering: Lowering, scene: Scene) -> Scene:
    """Lower the cameras, leaving out cameras mounted on a link that does not exist in the selected variant.

    Raises:
        SpecError: If a camera looks at its own position.
    """
    fixed, mounted, lost, findings = [], [], [], []
    robots, objects = {robot.name for robot in scene.robots}, scene.by_name
    for name, spec in lowering.spec.cameras.items():
        carrier, _, link = (spec.mount or "").partition(".")
        item = objects.get(carrier)
        poses = link_poses(item) if item is not None else {}
        if item is not None and link and link not in poses:
            reason = f"the variant `{item.variant}` of `{carrier}` has no link `{link}`"
            lost.append(LeftOut(f"cameras.{name}", reason))
            continue
        X_WM = item.X_WO @ poses[link or item.root.name] if item is not None else IDENTITY
        try:
            X_MC = lowering.frames.camera_pose(spec.pose, objects, X_WM)
        except PlaceError as error:
            where = ("cameras", name, "pose", "look_at")
            findings.append(lowering.loaded.finding("SF104", where, error.message, error.hint))
            continue
        if spec.mount is None:
            fixed.append(camera(name, spec, X_MC))
        elif item is not None or carrier in robots:
            mounted.append(MountedCamera(carrier, link, camera(name, spec, X_MC)))
    if findings:
        raise SpecError(findings)
    return replace(scene, cameras=tuple(fixed), mounted=tuple(mounted), left_out=(*scene.left_out, *lost))


def camera(name: str, spec: CameraSpec, X_WC: Pose) -> Camera:
    """Return a camera whose intrinsics are resolved."""
    width, height = spec.size
    cx = (width - 1) / 2 if spec.cx is None else spec.cx
    cy = (height - 1) / 2 if spec.cy is None else spec.cy
    return Camera(name, width, height, *spec.focal_lengths, cx, cy, X_WC)
