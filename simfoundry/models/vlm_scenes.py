"""Reading scenes by a vision-language model of a provider, beside servers that speak ``bundle/1`` (V_scene)."""

from __future__ import annotations

from simfoundry.models.contract import ConventionError, ModelError
from simfoundry.models.provenance import ModelIdentity, provider_identity
from simfoundry.models.tasks.depth import Pixels
from simfoundry.models.tasks.images import encoded_image
from simfoundry.models.tasks.scenes import SceneEstimate, SceneReading, check_boxes
from simfoundry.models.vlm import Vlm, VlmError

PROMPT = """\
List every separate object that stands on the support (such as a table) in this image of {width} x {height} pixels.
List objects on top of others first, so that each can be removed before what is below it. For each object, give a short
noun phrase that no other object fits, its category, the material of its surface, a box [left, top, right, bottom] in
pixels, its mass in kg, whether it has parts that move, such as drawers or doors, and the phrase of the object that it
stands on, or an empty text if it stands on the support itself. Leave out the support, robots and the background."""


class VlmScenes:
    """A vision-language model that lists the objects of an image; see :class:`SceneModel`."""

    def __init__(self, vlm: Vlm) -> None:
        self._vlm = vlm

    @property
    def identity(self) -> ModelIdentity:
        """The model."""
        return provider_identity(self._vlm.name)

    def read_scene(self, image: Pixels) -> SceneEstimate:
        """List the objects on the support in an RGB image, shape (H, W, 3).

        Raises:
            ModelError: If the model returns no usable answer.
        """
        height, width = image.shape[:2]
        try:
            reading = self._vlm.ask(PROMPT.format(width=width, height=height), [encoded_image(image)], SceneReading)
            check_boxes(reading, width, height)
        except ConventionError as error:
            raise ModelError(f"the answer for `read_scene` from {self._vlm.name} {error}") from None
        except VlmError as error:
            raise ModelError(str(error)) from None
        return SceneEstimate(reading, self.identity)
