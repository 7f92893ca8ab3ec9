"""The ``dataset/1`` document: the demonstrations of a dataset, and what it contains of each of them."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import (
    FORMAT_NAME,
    DocumentSpec,
    FileName,
    Fraction,
    Model,
    Name,
    NonNegative,
    Ordered,
    Positive,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.policy import (
    ActionKindWord,
    CameraView,
    FrameWord,
    GripperConvention,
    NormalizedFlag,
    RotationWord,
    WireKey,
)
from simfoundry.spec.models.vary import SplitSpec

# Name of a built-in profile or of one from an installed package, or the path of a profile.
ProfileName = Annotated[str, StringConstraints(min_length=1, max_length=200)]
FormatName = Annotated[str, StringConstraints(pattern=FORMAT_NAME, max_length=64)]
License = Annotated[str, StringConstraints(min_length=1, max_length=100)]

# The readings of a robot, as in policy documents, and the true state of the objects, which only a simulation knows.
StateEntry = Literal[
    "joints",
    "gripper",
    "joints_gripper",
    "hand",
    "hand_quat",
    "hand_rotvec",
    "hand_rot6d",
    "hand_world",
    "objects",
    "object_joints",
]


# The entries of one observed array, in order.
StateEntries = Annotated[tuple[StateEntry, ...], Field(min_length=1, max_length=32)]


class DatasetSource(Model):
    """Demonstrations, or the episodes of an existing dataset."""

    demonstrations: FileName | None = Field(
        None,
        description="A folder that `simfoundry record` wrote, or a folder that contains such folders; relative to this "
        "document.",
    )
    dataset: FileName | None = Field(
        None, description="The folder of an existing dataset, for example one recorded with a real robot."
    )
    keys: dict[WireKey, WireKey] = Field(
        {}, description="For an existing dataset: its keys, by the keys that they have in this dataset."
    )
    weight: Positive = Field(
        1.0, description="How often each frame is drawn in training, relative to frames of other sources."
    )
    share: Fraction | None = Field(
        None, gt=0, description="Share of all frames drawn in training that this source has, instead of a `weight`."
    )
    count: Annotated[int, Field(ge=1, le=1_000_000)] | None = Field(
        None, description="Maximum number of demonstrations to use; default: all."
    )
    split: Name | None = Field(
        None, description="The split that contains all demonstrations of this source; default: as in `splits`."
    )

    @consistent
    def _one_kind(self) -> None:
        if (self.demonstrations is None) == (self.dataset is None):
            raise fault("sf107", "specify either `demonstrations` or `dataset`")
        exclusive(self, "weight", "share")
        if self.keys and self.dataset is None:
            raise fault("sf107", "`keys` requires `dataset`; demonstrations have no keys", "keys")


class DemonstrationFilter(Model):
    """The demonstrations to use. All conditions must hold."""

    subtasks: tuple[Name, ...] = Field((), description="Sub-tasks that must have been completed.")
    duration: Annotated[tuple[NonNegative, NonNegative], Ordered] | None = Field(
        None, description="Minimum and maximum duration [s]."
    )
    split: Name | None = Field(
        None, description="The split of the recipe from which the scenes of the demonstrations were drawn."
    )


class PictureVariation(Model):
    """Variations of the pictures of each demonstration, which are rendered while it is replayed."""

    recipe: FileName = Field(
        description="A recipe whose `vary` changes only pictures: cameras, lights, colors, textures or the background."
    )
    count: Annotated[int, Field(ge=1, le=1000)] = Field(
        1, description="Number of episodes with different pictures for each demonstration."
    )
    seed: Annotated[int, Field(ge=0, le=2**31)] = Field(0, description="Seed of the random choices.")
    split: Name | None = Field(None, description="The split of the recipe to draw from; default: all values.")
    keep_original: bool = Field(False, description="Also include an episode with the original pictures.")


class DatasetSpec(DocumentSpec):
    """A dataset for imitation learning: its sources, and what it contains of each demonstration.

    Keys that are omitted are those of the profile.
    """

    simfoundry: Literal["dataset/1"] = Field(description="The kind and version of this document.")
    license: License | None = Field(None, description="License of the data, such as `CC-BY-4.0`.")
    profile: ProfileName = Field(
        "lerobot",
        description="Conventions of the training library: `lerobot`, `openpi-droid`, `gr00t`, `robomimic`, "
        "`rlds-droid`, or a YAML file relative to this document.",
    )
    formats: tuple[FormatName, ...] = Field(
        (), max_length=8, description="File formats to write, such as `lerobot-v3`; default: that of the profile."
    )
    sources: dict[Name, DatasetSource] = Field(
        min_length=1, max_length=1000, description="Demonstrations and existing datasets, by name."
    )
    filter: DemonstrationFilter = Field(
        DemonstrationFilter.model_construct(), description="The demonstrations to use; default: all."
    )
    cameras: dict[WireKey, CameraView] | None = Field(
        None, max_length=32, description="Camera views by their keys in the dataset."
    )
    images: Literal["video", "image"] | None = Field(
        None, description="How color images are stored if the format offers a choice."
    )
    state: dict[WireKey, StateEntries] | None = Field(
        None, max_length=64, description="Observed values, in order, by their keys in the dataset."
    )
    fps: Positive | None = Field(
        None, le=1000, description="Number of frames per second [Hz]; default: the control frequency of the task."
    )
    action_space: ActionKindWord | None = Field(
        None, description="Meaning of the arm values in an action. Recorded actions are converted if necessary."
    )
    frame: FrameWord = None
    rotation: RotationWord = None
    normalized: NormalizedFlag = False
    gripper: GripperConvention | None = Field(None, description="Gripper values in actions and observations.")
    pictures: PictureVariation | None = Field(None, description="Vary the pictures of each demonstration.")
    splits: dict[Name, SplitSpec] = Field(
        {},
        max_length=32,
        description="Shares of the demonstrations of each source, in order, by name; default: all are in `train`.",
    )

    @consistent
    def _describes_actions(self) -> None:
        for key in ("frame", "rotation"):
            if getattr(self, key) is not None and not (self.action_space or "").startswith("hand"):
                what = f"{self.action_space.replace('_', ' ')}s" if self.action_space else "the default action space"
                raise fault("sf107", f"`{key}` has no effect on {what}", key)
        if self.normalized and self.action_space is None:
            raise fault("sf107", "`normalized` requires `action_space`", "normalized")
        if self.frame == "hand" and self.action_space == "hand_pose":
            raise fault(
                "sf104", "a pose of the hand cannot be in the frame of the hand; use `base` or `world`", "frame"
            )

    @consistent
    def _shares_fit(self) -> None:
        shares = [source.share for source in self.sources.values()]
        total = sum(share for share in shares if share is not None)
        if total > 1 or (total < 1 and None not in shares):
            goal = "add up to at most 1" if None in shares else "add up to 1"
            raise fault("sf104", f"the shares of the sources must {goal}, not {total:g}", "sources")

    @consistent
    def _splits_cover_everything(self) -> None:
        ends = sorted((split.ends, name) for name, split in self.splits.items())
        for (a, first), (b, second) in pairwise(ends):
            if b[0] != a[1]:
                relation = "overlap" if b[0] < a[1] else "leave a gap"
                message = f"`{second}` starts at {b[0]:g}, but `{first}` ends at {a[1]:g}; splits must not {relation}"
                raise fault("sf104", message, "splits")
        if ends and (ends[0][0][0], ends[-1][0][1]) != (0.0, 1.0):
            raise fault("sf104", "the splits must cover everything from 0 to 1", "splits")

    @consistent
    def _keys_are_distinct(self) -> None:
        for key in self.cameras or {}:
            if key in (self.state or {}):
                raise fault("sf104", f"`{key}` is the key of both a camera and a state", "state")
