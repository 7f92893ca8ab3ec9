"""Move, add and remove cameras."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

from simfoundry.geometry.frames import IDENTITY, Pose
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.kinematics import link_poses
from simfoundry.spec.change.edit_data import DataPath
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.studio.acts.act import ActEdits, ActError, require_new_name, scene_edits
from simfoundry.studio.acts.placement import STILL_RAD, moved
from simfoundry.studio.reading import StudioScene

# Size [px] of the images of new cameras, as of common webcams.
NEW_SIZE = (640, 480)


@dataclass(frozen=True, eq=False)
class MoveCamera:
    """Move a camera. One that looks at something keeps looking at it, unless it is turned.

    Attributes:
        name: The camera.
        X_WC: Its new pose (OpenCV axes: x right, y down, z forward).
    """

    name: str
    X_WC: Pose

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"move {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edits of the camera's pose."""
        spec = scene.draft.spec.cameras.get(self.name)
        if spec is None or self.name not in scene.draft.cameras:
            raise ActError(f"`{self.name}` is not a camera that can be moved here")
        try:
            X_WF = _mount(scene, spec.mount) @ scene.frames.pose(spec.pose.frame, scene.objects)
        except PlaceError as error:
            raise ActError(f"`{self.name}` cannot be moved: {error.message}") from None
        X_FC = X_WF.inverse() @ self.X_WC
        before = scene.draft.cameras[self.name].X_WC
        edits: dict[DataPath, Any] = {("cameras", self.name, "pose", "xyz"): moved(spec.pose.xyz, X_FC.p)}
        if self.X_WC.angle_to(before) > STILL_RAD:
            edits["cameras", self.name, "pose", "quat_wxyz"] = tuple(round(float(v), 6) + 0.0 for v in X_FC.q)
            edits["cameras", self.name, "pose", "look_at"] = ABSENT
        return scene_edits(scene, edits)


@dataclass(frozen=True, eq=False)
class AddCamera:
    """Add a camera at a viewpoint.

    Attributes:
        name: The name of the new camera.
        X_WC: Its pose (OpenCV axes).
        look_at: The point that it looks at [m], shape (3,), or None to state its rotation.
        fov_deg: Its vertical field of view [deg].
    """

    name: str
    X_WC: Pose
    look_at: tuple[float, float, float] | None = None
    fov_deg: float = 45.0

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"add camera {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit that adds the camera."""
        require_new_name(self.name, "camera", scene.spec.cameras)
        pose: dict[str, Any] = {"xyz": tuple(round(float(v), 3) + 0.0 for v in self.X_WC.p)}
        if self.look_at is not None:
            pose["look_at"] = tuple(round(float(v), 3) + 0.0 for v in self.look_at)
        else:
            pose["quat_wxyz"] = tuple(round(float(v), 6) + 0.0 for v in self.X_WC.q)
        fov = round(min(max(self.fov_deg, 1.0), 170.0), 1)
        return scene_edits(scene, {("cameras", self.name): {"size": NEW_SIZE, "fov_deg": fov, "pose": pose}})


@dataclass(frozen=True)
class RemoveCamera:
    """Remove a camera."""

    name: str

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"remove {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the edit that removes the camera."""
        if self.name not in scene.spec.cameras:
            raise ActError(f"the scene has no camera `{self.name}`")
        return scene_edits(scene, {("cameras", self.name): ABSENT})


def _mount(scene: StudioScene, mount: str | None) -> Pose:
    """Return the pose of what a camera is mounted on, or the identity if it is fixed in the world."""
    if mount is None:
        return IDENTITY
    carrier, _, link = mount.partition(".")
    item = scene.objects[carrier]
    return item.X_WO @ link_poses(item)[link or item.root.name]
