"""The contents of a dataset: which values and images of a demonstration it has, under which keys."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.dataset import DatasetSpec
from simfoundry.spec.models.dataset_profile import ProfileSpec
from simfoundry.spec.models.policy import CameraView, GripperConvention
from simfoundry.spec.models.signals import ActionSpace, ImageKind


@dataclass(frozen=True)
class ImageView:
    """An image feature: a camera, the size at which it is rendered, and the size to which the image is resized."""

    camera: str
    size: ImageSize
    render: ImageSize
    kind: ImageKind = ImageKind.COLOR


@dataclass(frozen=True)
class ActionColumns:
    """An action feature: the action space, and the values of an action to include, ``all``, ``arm`` or ``gripper``."""

    space: ActionSpace
    part: str = "all"


@dataclass(frozen=True)
class DatasetContents:
    """The features of a dataset, by key.

    Attributes:
        fps: The number of frames per second [Hz].
        space: The action space of the first action feature.
        actions: The action features.
        state: The entries of each observed array.
        views: The images.
        is_video: True if color images are to be stored as videos.
        gripper: The gripper values in actions and observations.
        parts: The names of parts of arrays, by entry.
    """

    fps: float
    space: ActionSpace
    actions: Mapping[str, ActionColumns]
    state: Mapping[str, tuple[str, ...]]
    views: Mapping[str, ImageView]
    is_video: bool
    gripper: GripperConvention
    parts: Mapping[str, str]


def contents_of(
    spec: DatasetSpec, profile: ProfileSpec, scene: Scene, recorded_hz: float, recorded_space: ActionSpace
) -> DatasetContents:
    """Return the contents of a dataset.

    Args:
        spec: The document.
        profile: The profile, which supplies what the document omits.
        scene: The scene of the first demonstration.
        recorded_hz: The control frequency of the first demonstration [Hz].
        recorded_space: The action space of the first demonstration.

    Raises:
        SimfoundryError: If the scene lacks a camera.
    """
    space = _space(spec, profile) or recorded_space
    actions = {
        key: ActionColumns(ActionSpace.parse(entry.space) if entry.space else space, entry.part)
        for key, entry in profile.actions.items()
    }
    state = dict(profile.state if spec.state is None else spec.state)
    views = _views(spec, profile, scene)
    for key in actions:
        if key in state or key in views:
            raise SimfoundryError(
                f"`{key}` is the key of the actions in profile `{spec.profile}`; choose another key for "
                f"{'the state' if key in state else 'the camera'}"
            )
    return DatasetContents(
        fps=float(spec.fps or profile.fps or recorded_hz),
        space=space,
        actions=actions,
        state=state,
        views=views,
        is_video=(spec.images or profile.images) == "video",
        gripper=spec.gripper or profile.gripper,
        parts=dict(profile.parts),
    )


def _space(spec: DatasetSpec, profile: ProfileSpec) -> ActionSpace | None:
    if spec.action_space is not None:
        words = (spec.action_space, spec.frame, spec.rotation, "normalized" if spec.normalized else None)
        return ActionSpace.parse(":".join(word for word in words if word is not None))
    return ActionSpace.parse(profile.action_space) if profile.action_space is not None else None


def _views(spec: DatasetSpec, profile: ProfileSpec, scene: Scene) -> dict[str, ImageView]:
    """Return the images: those of the document, else those of the profile that the scene has, else all cameras."""
    cameras = {camera.name: camera for camera in (*scene.cameras, *(mounted.camera for mounted in scene.mounted))}
    if spec.cameras is not None:
        for key, view in spec.cameras.items():
            if view.camera not in cameras:
                hint = nearest(view.camera, cameras) or "the scene has no cameras"
                raise SimfoundryError(
                    f"`{key}` shows camera `{view.camera}`, which scene `{scene.name}` does not have; {hint}"
                )
        return {key: _view(view) for key, view in spec.cameras.items()}
    known = {key: _view(view) for key, view in profile.cameras.items() if view.camera in cameras}
    if known:
        return known
    found = {}
    for name, camera in cameras.items():
        # Video encoders need sides of even length.
        height = profile.height or max(2, 2 * round(profile.width * camera.height / camera.width / 2))
        size = ImageSize(profile.width, height)
        found[profile.image_key.format(camera=name)] = ImageView(name, size, size)
    return found


def _view(view: CameraView) -> ImageView:
    size = ImageSize(*view.size)
    return ImageView(view.camera, size, ImageSize(*view.render) if view.render else size, ImageKind(view.kind))
