"""The description of a dataset: its features, splits and origin, independent of any file format."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from enum import StrEnum
from typing import Any

from simfoundry.spec.models.signals import ImageKind


class FeatureKind(StrEnum):
    """The kind of values that a feature contains.

    Formats that can encode videos store the images of a ``VIDEO`` feature as a video, and those of an ``IMAGE`` feature
    as single images without loss.
    """

    ARRAY = "array"
    IMAGE = "image"
    VIDEO = "video"


class FeatureRole(StrEnum):
    """The purpose of a feature in training."""

    OBSERVATION = "observation"
    ACTION = "action"


@dataclass(frozen=True)
class FeaturePart:
    """Consecutive values of an array feature that form one quantity, such as the joints of an arm.

    Attributes:
        name: The name of the quantity, such as ``joint_position`` or ``arm_joint_position``.
        start: The index of its first value.
        stop: The index after its last value.
        unit: The unit of the values, as in :mod:`simfoundry.spec.models.signals`.
        meaning: The action space of an action, such as ``joint_delta``, ``gripper`` for the target of a gripper, and
            the name of the reading, such as ``hand_quat``, for an observation.
    """

    name: str
    start: int
    stop: int
    unit: str = ""
    meaning: str = ""


@dataclass(frozen=True)
class DatasetFeature:
    """A feature of a dataset: a quantity that has a value in each frame.

    Attributes:
        name: The key in the dataset, such as ``observation.state`` or ``exterior_image_1_left``.
        role: The purpose of the feature.
        kind: The kind of values.
        dtype: The NumPy type of one value: ``float32`` for arrays, ``uint8`` for color images, ``float32`` [m] for
            depth images and ``int32`` for instance masks.
        shape: The shape in one frame. Images have the shape (height, width, channels), where depth images and masks
            have one channel.
        names: The name of each value of an array; for images ``("height", "width", "channels")``.
        parts: The quantities of which an array consists, in order; empty for images.
        camera: The camera in the scene, for images.
        image: The kind of image, for images.
    """

    name: str
    role: FeatureRole
    kind: FeatureKind
    dtype: str
    shape: tuple[int, ...]
    names: tuple[str, ...]
    parts: tuple[FeaturePart, ...] = ()
    camera: str = ""
    image: ImageKind | None = None

    @property
    def is_image(self) -> bool:
        """True for images and videos."""
        return self.kind is not FeatureKind.ARRAY

    @property
    def unit(self) -> str:
        """The unit of the values, or of each part if they differ."""
        return "; ".join(dict.fromkeys(part.unit for part in self.parts if part.unit))


@dataclass(frozen=True)
class DatasetInfo:
    """The description of a dataset that all formats share.

    Attributes:
        name: The name of the dataset.
        fps: The number of frames per second [Hz].
        robot_type: The kinds of the robots that act, such as ``franka_robotiq``, joined by ``+``.
        features: The features in order.
        action_space: The text form of the action space of the feature with the actions.
        instructions: The distinct instructions; an episode refers to them by ``task_index``.
        splits: The range of episodes (first, end) of each split. The ranges are consecutive and cover all episodes.
        episodes: The number of episodes.
        frames: The number of frames.
        profile: The name of the profile, or an empty string.
        license: The license of the data as an SPDX expression, or an empty string.
        environment: The simulation as JSON: ``engine``, ``engine_version``, ``version`` (of SimFoundry), ``tasks``,
            ``control_hz`` and ``robots`` (the kind of each robot by name).
        origin: The sources as JSON, each with its digest.
    """

    name: str
    fps: float
    robot_type: str
    features: tuple[DatasetFeature, ...]
    action_space: str
    instructions: tuple[str, ...]
    splits: Mapping[str, tuple[int, int]]
    episodes: int
    frames: int
    profile: str = ""
    license: str = ""
    environment: Mapping[str, Any] = field(default_factory=dict)
    origin: Mapping[str, Any] = field(default_factory=dict)

    def feature(self, name: str) -> DatasetFeature:
        """Return the feature called ``name``.

        Raises:
            KeyError: If there is no such feature.
        """
        for feature in self.features:
            if feature.name == name:
                return feature
        raise KeyError(f"no feature is called {name!r}; available: {', '.join(f.name for f in self.features)}")

    @property
    def arrays(self) -> tuple[DatasetFeature, ...]:
        """The features that are arrays."""
        return tuple(feature for feature in self.features if not feature.is_image)

    @property
    def images(self) -> tuple[DatasetFeature, ...]:
        """The features that are images or videos."""
        return tuple(feature for feature in self.features if feature.is_image)

    def to_json(self) -> dict[str, Any]:
        """Return the description as JSON data, from which :meth:`from_json` restores it."""
        plain = {**self.__dict__, "features": (), "environment": dict(self.environment), "origin": dict(self.origin)}
        plain["splits"] = {name: list(ends) for name, ends in self.splits.items()}
        plain["instructions"] = list(self.instructions)
        return plain | {"features": [_feature_json(feature) for feature in self.features]}

    @classmethod
    def from_json(cls, data: Mapping[str, Any]) -> DatasetInfo:
        """Restore a description.

        Raises:
            ValueError, TypeError, KeyError: If the data are not such a description.
        """
        features = tuple(_feature_of(one) for one in data["features"])
        splits = {str(name): (int(first), int(end)) for name, (first, end) in data["splits"].items()}
        lists = {"features": features, "splits": splits, "instructions": tuple(map(str, data["instructions"]))}
        return cls(**{**data, **lists})


def _feature_json(feature: DatasetFeature) -> dict[str, Any]:
    data = {key: list(value) if isinstance(value, tuple) else value for key, value in asdict(feature).items()}
    return {key: value for key, value in data.items() if value not in ("", None, [])}


def _feature_of(data: Mapping[str, Any]) -> DatasetFeature:
    return DatasetFeature(
        name=str(data["name"]),
        role=FeatureRole(data["role"]),
        kind=FeatureKind(data["kind"]),
        dtype=str(data["dtype"]),
        shape=tuple(map(int, data["shape"])),
        names=tuple(map(str, data.get("names", ()))),
        parts=tuple(FeaturePart(**part) for part in data.get("parts", ())),
        camera=str(data.get("camera", "")),
        image=ImageKind(data["image"]) if "image" in data else None,
    )
