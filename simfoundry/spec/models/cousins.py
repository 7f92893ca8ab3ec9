"""``cousins/1``: a recipe for variations of a scene that keep its affordances."""

from __future__ import annotations

from typing import Annotated, Literal, Self

from pydantic import Field, StringConstraints, model_validator

from simfoundry.spec.models.base import (
    DocumentSpec,
    FileName,
    FormerKey,
    Model,
    Name,
    NonNegative,
    Number,
    Ordered,
    Positive,
    fault,
)

Side = Literal["LeftOf", "RightOf", "InFrontOf", "Behind", "OnTop", "Inside", "NextTo"]
Source = Literal["procedural", "library", "model"]
Engine = Literal["mujoco", "pybullet"]
Change = Literal["geometry", "topology", "appearance"]
Count = Annotated[int, Field(ge=0, le=1000)]
Folder = Annotated[FileName, StringConstraints(min_length=1, max_length=512)]
ModelName = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class ValueRange(Model):
    """A range; a bound that is left out is open."""

    min: Annotated[NonNegative | None, FormerKey("least")] = Field(None, description="Minimum.")
    max: Annotated[Positive | None, FormerKey("most")] = Field(None, description="Maximum.")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.min is not None and self.max is not None and self.min > self.max:
            raise fault("sf104", "`min` is greater than `max`", "min")
        return self


class SceneAxis(Model):
    """Other layouts: objects are placed anew around an anchor, which stays."""

    anchor: Name | None = Field(
        None, description="The object that stays in place; default: the object of the task's goal."
    )
    objects: dict[Name, tuple[Side, ...]] = Field(
        min_length=1, description="Objects to place at new positions, each with the allowed relations to the anchor."
    )
    relations_per_object: Annotated[int, Field(ge=1, le=3), FormerKey("together")] = Field(
        1, description="Number of predicates that each object must satisfy at once."
    )
    gap: Annotated[tuple[NonNegative, NonNegative], Ordered] = Field(
        (0.02, 0.2), description="Minimum and maximum gap between an object and the anchor [m]."
    )
    yaw_deg: Annotated[tuple[Number, Number], Ordered] = Field(
        (-180.0, 180.0), description="Minimum and maximum rotation about z [deg]."
    )


class ObjectVariants(Model):
    """Other objects in place of one, with the same affordances."""

    sources: tuple[Source, ...] = Field(
        ("procedural",), min_length=1, description="Sources of variants: rules, a library of meshes, or models."
    )
    changes: tuple[Change, ...] = Field(
        ("geometry", "appearance"),
        min_length=1,
        description="Aspects that may differ: shape, parts, or color and material.",
    )
    components: tuple[Name, ...] = Field((), description="Functional components that may differ; default: all of them.")
    count: Annotated[int, Field(ge=1, le=1000)] = Field(9, description="Number of variants.")


class ObjectModels(Model):
    """Models that generate variants if a source is `model`; addresses and keys are in the environment."""

    vlm: ModelName | None = Field(
        None,
        description="The vision-language model that names parts, proposes changes and judges images, such "
        "as `openai:gpt-5`; default: that of `--vlm`.",
    )
    images: ModelName | None = Field(
        None, description="Image-editing model, by the name that its server uses; default: the environment's."
    )
    meshes: Literal["hunyuan3d"] = Field(
        "hunyuan3d", description="Interface of the server that turns an image into a mesh."
    )
    texture: bool = Field(True, description="Texture the meshes, which not every server supports.")


class ObjectAxis(Model):
    """Other objects in the same layout."""

    objects: dict[Name, ObjectVariants] = Field(min_length=1, description="The objects that vary, by name.")
    library: Folder | None = Field(None, description="A folder of assets or meshes to choose from.")
    models: ObjectModels = Field(
        ObjectModels.model_construct(), description="Models that generate variants if a source is `model`."
    )


class DistractorAxis(Model):
    """Objects that the task does not involve: taken from a library, and placed without collision."""

    count: Annotated[tuple[Count, Count], Ordered] = Field((1, 4), description="Minimum and maximum number in a scene.")
    library: Folder | None = Field(None, description="A folder of assets or meshes to choose from.")
    builtin_library: Annotated[bool, FormerKey("shipped")] = Field(
        True, description="Also choose from the assets that come with SimFoundry."
    )
    categories: tuple[Name, ...] = Field(
        (), description="Categories to choose from; default: all that the twin does not contain."
    )
    exclude_categories: Annotated[tuple[Name, ...], FormerKey("without")] = Field(
        (), description="Categories to leave out."
    )
    mass: ValueRange = Field(ValueRange.model_construct(), description="Mass [kg].")
    volume: ValueRange = Field(ValueRange.model_construct(), description="Volume [m^3].")
    density: ValueRange = Field(ValueRange.model_construct(), description="Density [kg/m^3].")

    @model_validator(mode="after")
    def _ordered(self) -> Self:
        if self.library is None and not self.builtin_library:
            raise fault("sf107", "`builtin_library: false` requires a `library`", "builtin_library")
        return self


class TaskAxis(Model):
    """Other tasks in the same scene."""

    count: Annotated[int, Field(ge=1, le=1000)] = Field(10, description="Number of tasks.")
    proposals: Literal["affordances", "model"] = Field(
        "affordances",
        description="Enumerate tasks from the affordances, or have a vision-language model propose them.",
    )
    objects: tuple[Name, ...] = Field((), description="Objects that the tasks may involve; default: all free objects.")
    engines: tuple[Engine, ...] = Field(
        ("mujoco",), min_length=1, description="Engines in which the goal state of a task must be stable."
    )


class CousinsSpec(DocumentSpec):
    """A recipe: the twin, the axes that vary, and the number of cousins; the same seed gives the same cousins."""

    simfoundry: Literal["cousins/1"] = Field(description="The kind and version of this document.")
    twin: FileName = Field(description="The scene or task to vary, relative to this document.")
    count: Annotated[int, Field(ge=1, le=1_000_000)] = Field(100, description="Number of variants.")
    seed: Annotated[int, Field(ge=0, le=2**63 - 1)] = Field(0, description="Seed of the random choices.")
    scene: SceneAxis | None = Field(None, description="Vary the layout.")
    object: ObjectAxis | None = Field(None, description="Vary the objects.")
    distractors: DistractorAxis | None = Field(None, description="Add distractors.")
    task: TaskAxis | None = Field(None, description="Vary the task.")

    @model_validator(mode="after")
    def _varies(self) -> Self:
        if self.scene is None and self.object is None and self.distractors is None and self.task is None:
            raise fault("sf107", "one of `scene`, `object`, `distractors`, `task` is needed")
        return self
