"""Objects of an image, named and described (V_scene)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, Protocol

from pydantic import BaseModel, ConfigDict, Field

from simfoundry.models.client import ModelClient
from simfoundry.models.contract import ConventionError, ModelTask
from simfoundry.models.provenance import ModelIdentity
from simfoundry.models.tasks.depth import IMAGE, Pixels
from simfoundry.models.wire import Bundle, BundleImage

Words = Annotated[str, Field(min_length=1, max_length=100)]


class SeenObject(BaseModel):
    """An object in an image.

    Attributes:
        phrase: Short noun phrase by which a segmentation model finds it, such as `blue mug`.
        category: Noun, such as `mug`.
        material: Material of its surface, such as `ceramic`.
        box: Box [column, row, column, row] [px], if the model states one.
        mass: Estimated mass [kg].
        is_articulated: True if it has parts that move, such as drawers.
        supported_by: Phrase of the object that it stands on; empty for the table.
    """

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    phrase: Words
    category: Words
    material: Annotated[str, Field(max_length=100)] = ""
    box: tuple[float, float, float, float] | None = None
    mass: float | None = Field(None, gt=0, le=1000)
    is_articulated: bool = False
    supported_by: Annotated[str, Field(max_length=100)] = ""


class SceneReading(BaseModel):
    """The objects of an image, those on top first, so that none hides a later one."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    objects: tuple[SeenObject, ...] = Field(max_length=200)
    support: Annotated[str, Field(max_length=100)] = "table"


@dataclass(frozen=True, eq=False)
class SceneEstimate:
    """A reading of an image, and the model that read it."""

    reading: SceneReading
    made_by: ModelIdentity


class SceneModel(Protocol):
    """Objects of an image in words (V_scene)."""

    def read_scene(self, image: Pixels) -> SceneEstimate:
        """List the objects on the support in an RGB image, shape (H, W, 3)."""


def _check_reading(request: Bundle, answer: Bundle) -> None:
    picture = request.members["image"]
    assert isinstance(picture, BundleImage)
    height, width = picture.pixels.shape[:2]
    check_boxes(SceneReading.model_validate(answer.head.get("values", {})), width, height)


def check_boxes(reading: SceneReading, width: int, height: int) -> None:
    """Check that boxes are in pixels of an image of the given size.

    Raises:
        ConventionError: If a box follows another convention.
    """
    for seen in reading.objects:
        if seen.box is None:
            continue
        left, top, right, bottom = seen.box
        if not (-1 <= left < right <= width + 1 and -1 <= top < bottom <= height + 1):
            raise ConventionError(
                f"has a box of `{seen.phrase}`, {list(seen.box)}, that is not [column, row, column, row] in an image "
                f"of {width} x {height} pixels; some models answer in thousandths of the image, rows first"
            )
        if right <= 1.5 and bottom <= 1.5:
            raise ConventionError(f"has a box of `{seen.phrase}` in fractions of the image; boxes are in pixels")


READ_SCENE = ModelTask(
    "read_scene", "V_scene", "the objects of an image in words", (IMAGE,), (), values=SceneReading,
    checks=(_check_reading,),
)  # fmt: skip


@dataclass(frozen=True)
class BundleScenes:
    """The task about scenes, solved by servers that speak ``bundle/1``."""

    client: ModelClient

    def read_scene(self, image: Pixels) -> SceneEstimate:
        """List the objects; see :class:`SceneModel`."""
        got = self.client.ask(READ_SCENE, {"image": BundleImage(image)})
        return SceneEstimate(SceneReading.model_validate(got.bundle.head["values"]), got.made_by)
