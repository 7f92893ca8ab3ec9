"""Generate object variants with AI models, following the paper's pipeline.

A VLM identifies components and proposes variations, an image model draws them, the VLM judges the images, and a mesh
model reconstructs the objects. The resulting candidates are checked in the same way as all other candidates.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from importlib.resources import files
from itertools import chain, zip_longest
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, Field

from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError
from simfoundry.cousins.objects.item import ObjectAsset, alone, item_of_mesh
from simfoundry.cousins.objects.meshes import joined, mesh_files
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.cousins.objects.retrieval import USUAL, VariantLibrary
from simfoundry.cousins.objects.variants import Origins
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, frozen_array, look_at
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.generators import HttpImages, HttpMeshes, images_from_environment, meshes_from_environment
from simfoundry.models.open import open_model, open_vlm
from simfoundry.models.provenance import ModelIdentity, model_use, provider_identity, require_commercial
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.models.tasks.images import ImageEditingModel, decoded_image, encoded_image, with_alpha
from simfoundry.models.tasks.meshes import MeshEstimate, MeshModel
from simfoundry.models.vlm import Vlm
from simfoundry.render.raycast import raycast
from simfoundry.runtime.extras import install_line
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants
from simfoundry.spec.models.origin import ModelUse

# Names used in recipes for the paper's dimensions.
CHANGES = {"geometry": "geometry", "topology": "topology", "visual": "appearance"}

# Number of consecutive failures after which generation is aborted.
FAILURES = 3

# Maximum number of images to try per proposal, as in the paper's pipeline.
ATTEMPTS = 3

# Width and height of the images sent to models [px].
SIDE = 512


Door = TypeVar("Door", HttpImages, HttpMeshes)


class VariationProposal(NamedTuple):
    """A variation of a component in one dimension, described by the VLM."""

    component: str
    dimension: str
    words: str


@dataclass
class Generation:
    """A source of candidates that sends images of the object and its scene to models.

    All proposals for an object are requested when its first candidate is generated. Identical model responses produce
    identical candidates. If a model fails, the candidate is rejected. After :data:`FAILURES` consecutive failures, a
    :class:`SimfoundryError` is raised.

    Attributes:
        vlm: Vision-language model.
        images: Image model.
        meshes: Mesh model.
        scene: Image of the scene.
        picture: Image of the object, or None to render one.
        texture: Whether to generate textures.
        counts: Numbers of proposals per component for geometry, topology and appearance.
    """

    vlm: Vlm
    images: ImageEditingModel
    meshes: MeshModel
    scene: bytes
    picture: bytes | None = None
    texture: bool = True
    counts: tuple[int, int, int] = (2, 2, 2)
    _proposals: dict[str, list[VariationProposal]] = field(default_factory=dict)
    _pictures: dict[str, bytes] = field(default_factory=dict)
    _failures: int = 0

    def __call__(self, item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        """Return candidate ``k``. It is generated from the next proposal."""
        try:
            made = self._made(item, axis, seed, k)
        except MeshError as error:
            made = Reason("mesh", str(error))
        except SimfoundryError as error:
            self._failures += 1
            if self._failures == FAILURES:
                raise
            return Reason("model", str(error))
        self._failures = 0
        return made

    def _made(self, item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        if item.name not in self._proposals:
            self._pictures[item.name] = self.picture or picture_of(item)
            self._proposals[item.name] = list(self._propose(self._pictures[item.name], axis))
        proposals = self._proposals[item.name]
        place = k // len(axis.sources)
        if place >= len(proposals):
            text = f"the model proposed only {len(proposals)} changes, but proposal {place + 1} was requested"
            return Reason("proposals", text, {"proposals": float(len(proposals)), "place": float(place)})
        picture = self._edited(self._pictures[item.name], proposals[place], seed + k)
        if isinstance(picture, Reason):
            return picture
        pixels, painter = picture
        mesh = self.meshes.make_mesh(with_alpha(pixels), self.texture, seed=seed + k)
        makers = (("propose", provider_identity(self.vlm.name)), ("edit", painter), ("mesh", mesh.made_by))
        return built(item, mesh, proposals[place], tuple(model_use(task, made_by) for task, made_by in makers))

    def _propose(self, picture: bytes, axis: ObjectVariants) -> Iterator[VariationProposal]:
        """Run prompts A, B and C, and yield the proposals, cycling through the components."""
        names = self.vlm.ask(prompt("a_components"), [picture], ComponentNames).components
        wanted = [name for name in names if not axis.components or name in axis.components]
        queues = []
        for name in wanted:
            counts = dict(zip(CHANGES, self.counts, strict=True))
            asked = prompt("b_topology", component=name)
            if counts["topology"] and not self.vlm.ask(asked, [picture], TopologyAnswer).yes:
                counts["topology"] = 0
            numbers = {f"num_{dimension}": count for dimension, count in counts.items()}
            told = self.vlm.ask(prompt("c_variations", component=name, **numbers), [picture], Variations)
            queue = [
                VariationProposal(name, dimension, words[:300])
                for dimension, count in counts.items()
                if CHANGES[dimension] in axis.changes
                for words in getattr(told, dimension)[:count]
            ]
            queues.append(queue)
        yield from filter(None, chain.from_iterable(zip_longest(*queues)))

    def _edited(
        self, picture: bytes, proposal: VariationProposal, seed: int
    ) -> tuple[NDArray[np.uint8], ModelIdentity] | Reason:
        """Run prompts D and E to create an image.

        Returns:
            An image that the VLM considered reasonable and the model that drew it, or the reason for the failure.
        """
        component, dimension, words = proposal
        asked = prompt("d_edit", component=component, dimension=dimension, variation_description=words)
        why = ""
        shown = [decoded_image(data) for data in (picture, self.scene)]
        for attempt in range(ATTEMPTS):
            made = self.images.edit_image(asked, shown, seed + attempt)
            verdict = self.vlm.ask(prompt("e_verify"), [self.scene, encoded_image(made.image)], PictureVerdict)
            if verdict.real_world_reasonable and verdict.scene_reasonable:
                return made.image, made.made_by
            why = verdict.scene_reason if verdict.real_world_reasonable else verdict.real_world_reason
        text = f"{component}, {words}: none of {ATTEMPTS} images was judged reasonable: {why}"
        return Reason("picture", text, {"attempts": float(ATTEMPTS)})


def built(
    item: ObjectAsset, mesh: MeshEstimate, proposal: VariationProposal, models: tuple[ModelUse, ...] = ()
) -> Draft:
    """Convert a generated mesh to a draft.

    The mesh is scaled to the size of the twin's object and aligned with its base. Its material is that of the twin's
    object.

    Args:
        item: The twin's object.
        mesh: The generated mesh.
        proposal: The variation from which the mesh was generated.
        models: Models that contributed.

    Raises:
        MeshError: The mesh cannot be read or has several textures.
    """
    with TemporaryDirectory(prefix="simfoundry-made-") as scratch:
        read = joined(mesh.parts, "the generated mesh")
        vertices = fitted(read.vertices, *bounds(alone(item)))
        first, written = mesh_files(Mesh(frozen_array(vertices), read.faces, read.uv, read.texture))
        kept = Path(scratch) / Path(first).name
        kept.write_bytes(written[first])
        material = next((m for m in item.spec.materials.values() if m.density is not None), USUAL)
        made = item_of_mesh(
            kept,
            item.name,
            item.category,
            Material(**material.model_dump(exclude={"color", "texture", "texture_size"})),
        )
    link = made.spec.links["body"]
    part = link.parts["mesh"].model_copy(
        update={"mesh": first, "color": None if read.texture is not None or read.rgba is None else read.rgba[:3]}
    )
    spec = made.spec.model_copy(update={"links": {"body": link.model_copy(update={"parts": {"mesh": part}})}})
    return Draft(spec, (f"{proposal.component}, {proposal.dimension}: {proposal.words}",), written, models=models)


def fitted(vertices: Array, low: Array, high: Array) -> Array:
    """Scale points uniformly so that their bounding box has the same size as the given bounds.

    The size is the geometric mean of the side lengths. The result is centered horizontally on the bounds, and its
    lowest point is at the bottom of the bounds.

    Args:
        vertices: Points in any unit, shape (n, 3).
        low: Minimum corner of the bounds [m], shape (3,).
        high: Maximum corner of the bounds [m], shape (3,).
    """
    mine_low, mine_high = vertices.min(axis=0), vertices.max(axis=0)
    factor = float(np.exp(np.mean(np.log((high - low) / np.maximum(mine_high - mine_low, 1e-9)))))
    foot = np.array([*(mine_low + mine_high)[:2] / 2, mine_low[2]])
    return np.asarray((vertices - foot) * factor + np.array([*(low + high)[:2] / 2, low[2]]))


def picture_of(item: ObjectAsset, side: int = SIDE) -> bytes:
    """Render an object on a transparent background, viewed from the front and above.

    Returns:
        A PNG with ``side`` pixels in width and height.
    """
    from PIL import Image

    thing = alone(item)
    low, high = bounds(thing)
    middle, far = (low + high) / 2, 2.2 * float(np.linalg.norm(high - low))
    eye = middle + far * np.array([0.72, -0.35, 0.6])
    f = 0.9 * side * far / float(np.linalg.norm(high - low))
    c = (side - 1) / 2
    camera = Camera("alone", side, side, f, f, c, c, look_at(eye, middle))
    seen = raycast(Scene("alone", frozen_array([0.0, 0.0, -9.81]), (thing,)), camera, samples=2)
    alpha = np.where(seen.objects > 0, 255, 0).astype(np.uint8)
    stream = io.BytesIO()
    Image.fromarray(np.dstack([seen.color, alpha]), "RGBA").save(stream, format="PNG")
    return stream.getvalue()


# Model responses are validated against a schema, limited in length, and never executed.


class ComponentNames(BaseModel):
    """The response to prompt A."""

    components: list[str] = Field(min_length=1, max_length=16, description="Names of the functional components.")


class TopologyAnswer(BaseModel):
    """The response to prompt B."""

    yes: bool = Field(description="True if a variation in topology is reasonable.")


class Variations(BaseModel):
    """The response to prompt C."""

    geometry: list[str] = Field(default=[], max_length=16, description="Variations in geometry.")
    topology: list[str] = Field(default=[], max_length=16, description="Variations in topology.")
    visual: list[str] = Field(default=[], max_length=16, description="Variations in appearance.")


class PictureVerdict(BaseModel):
    """The response to prompt E."""

    real_world_reasonable: bool = Field(description="True if the object is reasonable in the real world.")
    real_world_reason: str = Field(max_length=300, description="Short explanation.")
    scene_reasonable: bool = Field(description="True if the object is reasonable in this scene.")
    scene_reason: str = Field(max_length=300, description="Short explanation.")


def prompt(name: str, **variables: Any) -> str:
    """Render one of the paper's prompts.

    An error is raised if a required variable is missing.
    """
    try:
        from jinja2 import Environment, StrictUndefined
    except ImportError:
        raise SimfoundryError(f"prompts require jinja2; install it with `{install_line('vlm')}`") from None
    text = (files(__package__) / "prompts" / f"{name}.j2").read_text(encoding="utf-8")
    template = Environment(undefined=StrictUndefined, autoescape=False).from_string(text)  # plain text, no HTML
    return template.render(**variables).strip()


@dataclass(frozen=True)
class SourceSetup:
    """The settings of a run for the sources of variants.

    Attributes:
        scene: Document of the twin's scene. An image of the scene is shown to the models.
        library: Folder of the library, or None.
        vlm: Name of the vision-language model for recipes that do not specify a model.
        commercial_only: Whether to refuse models that may not be used commercially, whatever the project says.
    """

    scene: Path
    library: Path | None = None
    vlm: str = ""
    commercial_only: bool = False

    @property
    def models(self) -> ModelSetup:
        """The models that are configured for the scene."""
        return load_setup(self.scene, commercial_only=self.commercial_only)


def opened(axis: ObjectAxis, given: SourceSetup, cache: Cache | None = None) -> Mapping[str, Origins]:
    """Open all sources that an axis uses, except rules.

    Raises:
        ImpossibleError: A source is not configured. The error lists what is missing.
    """
    wanted = {source: name for name, of in reversed(axis.objects.items()) for source in of.sources}
    found: dict[str, Origins] = {}
    if "library" in wanted:
        if given.library is None:
            raise _lacking(wanted["library"], "library", "a `library`")
        found["library"] = VariantLibrary(given.library, cache)
    if "model" in wanted:
        found["model"] = _generation(axis, given, wanted["model"])
    return found


def _generation(axis: ObjectAxis, given: SourceSetup, name: str) -> Generation:
    """Create the models of the paper's pipeline as configured in the recipe and the environment."""
    models = axis.models
    named = models.vlm or given.vlm
    lacks = [] if named else ["no vision-language model: specify --vlm, or `vlm` in the recipe's `models`"]
    setup = given.models
    try:
        images = image_model(setup, models.images)
    except SimfoundryError as error:
        lacks.append(str(error))
    try:
        meshes = mesh_model(setup)
    except SimfoundryError as error:
        lacks.append(str(error))
    try:
        vlm = open_vlm(setup, named) if named else None
    except SimfoundryError as error:
        lacks.append(str(error))
    if lacks:
        raise _lacking(name, "model", f"models that are not available: {'; '.join(lacks)}")
    from simfoundry.cousins.run.report import draw

    picture = draw(given.scene)
    if picture is None:
        raise _lacking(name, "model", "a camera in the scene, because models judge variants in its image")
    assert vlm is not None
    return Generation(vlm, images, meshes, picture, texture=models.texture)


def image_model(setup: ModelSetup, name: str | None = None) -> ImageEditingModel:
    """Return the image model that is configured for `edit`, or else a server with OpenAI's API (called ``name``).

    Raises:
        ModelError: If there is none, or if it may not be used commercially although this is required.
    """
    if setup.source("edit") is not None:
        return open_model(setup, "edit")
    door = images_from_environment(setup.environment, name)
    return _permitted(setup, door)


def mesh_model(setup: ModelSetup) -> MeshModel:
    """Return the mesh model that is configured for `mesh`, or else a server with Hunyuan3D's API.

    Raises:
        ModelError: If there is none, or if it may not be used commercially although this is required.
    """
    if setup.source("mesh") is not None:
        return open_model(setup, "mesh")
    return _permitted(setup, meshes_from_environment(setup.environment))


def _permitted(setup: ModelSetup, door: Door) -> Door:
    if setup.commercial_only:
        require_commercial(door.identity, setup.accepted)
    return door


def _lacking(name: str, source: str, need: str) -> ImpossibleError:
    return ImpossibleError((Reason("source", f"`{name}` has the source `{source}`, which needs {need}"),))
