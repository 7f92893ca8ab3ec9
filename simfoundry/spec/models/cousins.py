"""The ``cousins/1`` document: a recipe for variations of a scene that preserve its affordances."""

from __future__ import annotations

from itertools import pairwise
from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import (
    DocumentSpec,
    FileName,
    FormerKey,
    Interval,
    Model,
    Name,
    NonNegative,
    Number,
    Ordered,
    Positive,
    consistent,
    fault,
)
from simfoundry.spec.models.vary import AnyDistribution, SplitSpec, VaryPath

Side = Literal["LeftOf", "RightOf", "InFrontOf", "Behind", "OnTop", "Inside", "NextTo"]
Source = Literal["procedural", "library", "model"]
Change = Literal["geometry", "topology", "appearance"]
Count = Annotated[int, Field(ge=0, le=1000)]
Gap = Annotated[tuple[NonNegative, NonNegative], Ordered]
Folder = Annotated[FileName, StringConstraints(min_length=1, max_length=512)]
WorldName = Annotated[str, StringConstraints(min_length=1, max_length=64)]  # not the name of a member
ModelName = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class ValueRange(Model):
    """A range with optional bounds. An omitted bound means no limit."""

    min: Annotated[NonNegative | None, FormerKey("least")] = Field(None, description="Minimum.")
    max: Annotated[Positive | None, FormerKey("most")] = Field(None, description="Maximum.")

    @consistent
    def _ordered(self) -> None:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise fault("sf104", "`min` is greater than `max`", "min")


class SceneAxis(Model):
    """Layout variations: objects are placed at new positions around an anchor object, which does not move."""

    anchor: Name | None = Field(
        None, description="The object that stays in place; default: the object in the task's goal."
    )
    objects: dict[Name, tuple[Side, ...]] = Field(
        min_length=1, description="Objects to place at new positions, each with the allowed relations to the anchor."
    )
    relations_per_object: Annotated[int, Field(ge=1, le=3), FormerKey("together")] = Field(
        1, description="Number of relations to the anchor that each object must satisfy simultaneously."
    )
    gap: Gap = Field((0.02, 0.2), description="Minimum and maximum gap between an object and the anchor [m].")
    yaw_deg: Interval = Field((-180.0, 180.0), description="Minimum and maximum rotation about z [deg].")


class ObjectVariants(Model):
    """Substitutes for one object, with the same affordances."""

    sources: tuple[Source, ...] = Field(
        ("procedural",),
        min_length=1,
        description="Sources of variants: procedural rules, a mesh library, or generative models.",
    )
    changes: tuple[Change, ...] = Field(
        ("geometry", "appearance"),
        min_length=1,
        description="Aspects that may differ: the shape, the parts, or the color and material.",
    )
    components: tuple[Name, ...] = Field((), description="Functional components that may differ; default: all.")
    count: Annotated[int, Field(ge=1, le=1000)] = Field(9, description="Number of variants.")


class ObjectModels(Model):
    """Models that generate variants if a source is `model`. URLs and API keys are read from environment variables."""

    vlm: ModelName | None = Field(
        None,
        description="Vision-language model that names parts, proposes changes and judges images, such as "
        "`openai:gpt-5`; default: the value of `--vlm`.",
    )
    images: ModelName | None = Field(
        None, description="Name of the image-editing model on the server; default: `SIMFOUNDRY_IMAGES_MODEL`."
    )
    meshes: Literal["hunyuan3d"] = Field(
        "hunyuan3d", description="Interface of the server that turns an image into a mesh."
    )
    texture: bool = Field(True, description="Generate textures for the meshes; not every server supports this.")


class ObjectAxis(Model):
    """Object variations: different objects in the same layout."""

    objects: dict[Name, ObjectVariants] = Field(min_length=1, description="The objects to vary, by name.")
    library: Folder | None = Field(None, description="A folder of assets or meshes to choose from.")
    models: ObjectModels = Field(
        ObjectModels.model_construct(), description="Models that generate variants if a source is `model`."
    )


class DistractorAxis(Model):
    """Distractors: library objects that the task does not involve, placed without collisions."""

    count: Annotated[tuple[Count, Count], Ordered] = Field(
        (1, 4), description="Minimum and maximum number of distractors in a scene."
    )
    library: Folder | None = Field(None, description="A folder of assets or meshes to choose from.")
    builtin_library: Annotated[bool, FormerKey("shipped")] = Field(
        True, description="Also choose from the assets that come with SimFoundry."
    )
    categories: tuple[Name, ...] = Field(
        (), description="Categories to choose from; default: all categories that do not occur in the twin."
    )
    exclude_categories: Annotated[tuple[Name, ...], FormerKey("without")] = Field(
        (), description="Excluded categories."
    )
    mass: ValueRange = Field(ValueRange.model_construct(), description="Mass [kg].")
    volume: ValueRange = Field(ValueRange.model_construct(), description="Volume [m^3].")
    density: ValueRange = Field(ValueRange.model_construct(), description="Density [kg/m^3].")

    @consistent
    def _ordered(self) -> None:
        if self.library is None and not self.builtin_library:
            raise fault("sf107", "`builtin_library: false` requires a `library`", "builtin_library")


class TaskAxis(Model):
    """Task variations: different tasks in the same scene."""

    count: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="Number of tasks.")
    proposals: Literal["affordances", "model"] = Field(
        "affordances",
        description="Source of the tasks: `affordances` enumerates them from the affordances, and `model` has a "
        "vision-language model propose them.",
    )
    objects: tuple[Name, ...] = Field((), description="Objects that the tasks may involve; default: all free objects.")
    engines: tuple[WorldName, ...] = Field(
        ("mujoco",), min_length=1, description="Simulators in which goals must be stable."
    )


class CousinsSpec(DocumentSpec):
    """A cousin recipe: the twin, the axes to vary, and the number of cousins.

    The same seed always produces the same cousins.
    """

    simfoundry: Literal["cousins/1"] = Field(description="The kind and version of this document.")
    twin: FileName = Field(description="The scene or task to vary, relative to this document.")
    parameters: dict[Name, Number] = Field({}, description="Values for parameters of the twin's scene.")
    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(100, description="Number of cousins.")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="Seed for the random choices.")
    scene: SceneAxis | None = Field(None, description="Vary the layout.")
    object: ObjectAxis | None = Field(None, description="Vary the objects.")
    distractors: DistractorAxis | None = Field(None, description="Add distractors.")
    task: TaskAxis | None = Field(None, description="Vary the task.")
    vary: dict[VaryPath, AnyDistribution] = Field(
        {},
        max_length=1000,
        description="Draw values in the scene at random: paths such as `light.*.intensity` or `cabinet.drawer`, each "
        "with a distribution.",
    )
    splits: dict[Name, SplitSpec] = Field(
        {}, max_length=32, description="Shares of the distributions in `vary`, such as `train` and `held_out`, by name."
    )

    @consistent
    def _varies(self) -> None:
        axes = (self.scene, self.object, self.distractors, self.task)
        if all(axis is None for axis in axes) and not self.vary:
            raise fault("sf107", "one of `scene`, `object`, `distractors`, `task`, `vary` is needed")
        if self.splits and not self.vary:
            raise fault("sf107", "`splits` requires `vary`", "splits")

    @consistent
    def _splits_are_disjoint(self) -> None:
        ends = sorted((split.ends, name) for name, split in self.splits.items())
        for (a, first), (b, second) in pairwise(ends):
            if b[0] < a[1]:
                message = f"`{second}` starts at {b[0]:g}, but `{first}` ends at {a[1]:g}; splits must not overlap"
                raise fault("sf104", message, "splits")
