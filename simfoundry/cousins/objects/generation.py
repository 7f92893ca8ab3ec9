"""Variants from models, as in the paper: a VLM takes the thing apart and proposes, an image model edits, a mesh model
builds, and the VLM judges the picture; after that a candidate is checked as any other.
"""

from __future__ import annotations

import io
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from importlib.resources import files
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, NamedTuple, Protocol, TypeVar

import numpy as np
from pydantic import BaseModel, Field

from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError
from simfoundry.assets.mesh import read_parts
from simfoundry.cousins.objects.item import ObjectAsset, item_of_mesh, lay, lowered
from simfoundry.cousins.objects.meshes import FOLDER, joined
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.cousins.objects.retrieval import USUAL, Retrieval, VariantLibrary
from simfoundry.cousins.objects.variants import Origins
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, frozen_array, look_at
from simfoundry.geometry.shapes import Mesh
from simfoundry.models.images import ImageEditor, images_from_environment
from simfoundry.models.meshes import MeshMaker, meshes_from_environment
from simfoundry.models.vlm import Vlm
from simfoundry.render.raycast import raycast
from simfoundry.runtime.extras import install_line
from simfoundry.scene.meshfile import obj_with_material
from simfoundry.scene.model import Camera, Scene, SceneObject
from simfoundry.scene.object_shapes import bounds
from simfoundry.spec.models.base import Material
from simfoundry.spec.models.cousins import ObjectAxis, ObjectVariants

T = TypeVar("T", bound=BaseModel)

DIMENSIONS = ("geometry", "topology", "visual")
CHANGES = {"geometry": "geometry", "topology": "topology", "visual": "appearance"}
"""What a recipe calls the paper's dimensions."""

FAILURES = 3
"""So many candidates in a row that a model gives no answer for, and it counts as not there."""

ATTEMPTS = 3
"""Pictures that are tried for one proposal, as in the paper's pipeline."""

SIDE = 512
"""Pictures for models are so many pixels wide and high."""


class PromptModel(Protocol):
    """A vision-language model that answers in a type."""

    def ask(self, prompt: str, pictures: Sequence[bytes], answer: type[T]) -> T:
        """The answer to a prompt about PNG pictures; raises :class:`SimfoundryError`."""
        ...


class VariationProposal(NamedTuple):
    """A change of one component in one dimension, in the words of the VLM."""

    component: str
    dimension: str
    words: str


@dataclass
class Generation:
    """A source of candidates: models, asked with the pictures of the thing and of its scene.

    ``counts`` are the proposals for each component in geometry, topology and looks. All that is proposed is asked for
    once, with the first candidate; with the same answers there are the same candidates. A model that fails is a reason;
    one that fails :data:`FAILURES` times in a row raises what it failed with, a :class:`SimfoundryError`.
    """

    vlm: PromptModel
    images: ImageEditor
    meshes: MeshMaker
    scene: bytes
    picture: bytes | None = None
    counts: tuple[int, int, int] = (2, 2, 2)
    _proposals: dict[str, list[VariationProposal]] = field(default_factory=dict)
    _pictures: dict[str, bytes] = field(default_factory=dict)
    _failures: int = 0

    def __call__(self, item: ObjectAsset, axis: ObjectVariants, seed: int, k: int) -> Draft | Reason:
        """Candidate ``k``: the next proposal when its turn has come round to this source."""
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
            text = f"the model proposed {len(proposals)} changes, and this is the {place + 1}th that is asked for"
            return Reason("proposals", text, {"proposals": float(len(proposals)), "place": float(place)})
        picture = self._edited(self._pictures[item.name], proposals[place])
        if isinstance(picture, Reason):
            return picture
        return built(item, self.meshes.make(picture, seed + k), proposals[place])

    def _propose(self, picture: bytes, axis: ObjectVariants) -> Iterator[VariationProposal]:
        """Prompts A, B and C: what could be changed, round the components so that the first few differ."""
        names = self.vlm.ask(prompt("A"), [picture], ComponentNames).components
        wanted = [name for name in names if not axis.components or name in axis.components]
        queues = []
        for name in wanted:
            geometry, topology, visual = self.counts
            if topology and not self.vlm.ask(prompt("B", component=name), [picture], TopologyAnswer).yes:
                topology = 0
            asked = prompt("C", component=name, num_geometry=geometry, num_topology=topology, num_visual=visual)
            told = self.vlm.ask(asked, [picture], Variations)
            limits = dict(zip(DIMENSIONS, (geometry, topology, visual), strict=True))
            queue = [
                VariationProposal(name, dimension, words[:300])
                for dimension in DIMENSIONS
                if CHANGES[dimension] in axis.changes
                for words in getattr(told, dimension)[: limits[dimension]]
            ]
            queues.append(queue)
        for turn in range(max(map(len, queues), default=0)):
            yield from (queue[turn] for queue in queues if turn < len(queue))

    def _edited(self, picture: bytes, proposal: VariationProposal) -> bytes | Reason:
        """Prompts D and E: a picture that the VLM finds reasonable, or why there is none."""
        asked = prompt(
            "D",
            component=proposal.component,
            dimension=proposal.dimension,
            variation_description=proposal.words,
        )
        why = ""
        for _ in range(ATTEMPTS):
            made = self.images.edit(asked, [picture, self.scene])
            verdict = self.vlm.ask(prompt("E"), [self.scene, made], PictureVerdict)
            if verdict.real_world_reasonable and verdict.scene_reasonable:
                return made
            why = verdict.scene_reason if verdict.real_world_reasonable else verdict.real_world_reason
        text = f"{proposal.component}, {proposal.words}: not reasonable in {ATTEMPTS} pictures: {why}"
        return Reason("picture", text, {"attempts": float(ATTEMPTS)})


def built(item: ObjectAsset, glb: bytes, proposal: VariationProposal) -> Draft:
    """The draft of a made mesh: scaled to the twin's size, its foot on z = 0 in the middle, of the twin's material.

    Raises :class:`MeshError` for a mesh that cannot be read, or has several textures.
    """
    with TemporaryDirectory(prefix="simfoundry-made-") as scratch:
        path = Path(scratch) / "made.glb"
        path.write_bytes(glb)
        read = joined(read_parts(path))
        if read is None:
            raise MeshError("SF301", "the made mesh has several textures, which one OBJ cannot hold")
        low, high = _bounds_of(item)
        vertices = fitted(read.vertices, low, high)
        mesh = Mesh(frozen_array(vertices), read.faces, read.uv, read.texture)
        written = {f"{FOLDER}/{name}": data for name, data in obj_with_material(mesh).items()}
        first = next(iter(written))
        kept = Path(scratch) / Path(first).name
        kept.write_bytes(written[first])
        material = next((m for m in item.spec.materials.values() if m.density is not None), USUAL)
        made = item_of_mesh(kept, item.name, item.category, Material(**material.model_dump(exclude={"color"})))
    link = made.spec.links["body"]
    part = link.parts["mesh"].model_copy(
        update={"mesh": first, "color": None if read.texture is not None or read.rgba is None else read.rgba[:3]}
    )
    spec = made.spec.model_copy(update={"links": {"body": link.model_copy(update={"parts": {"mesh": part}})}})
    return Draft(spec, (f"{proposal.component}, {proposal.dimension}: {proposal.words}",), written)


def fitted(vertices: Array, low: Array, high: Array) -> Array:
    """Points of any unit scaled evenly to bounds [m], shape (3,) each: the same mean of the logarithms of the sides."""
    mine_low, mine_high = vertices.min(axis=0), vertices.max(axis=0)
    factor = float(np.exp(np.mean(np.log((high - low) / np.maximum(mine_high - mine_low, 1e-9)))))
    foot = np.array([*(mine_low + mine_high)[:2] / 2, mine_low[2]])
    return np.asarray((vertices - foot) * factor + np.array([*(low + high)[:2] / 2, low[2]]))


def picture_of(item: ObjectAsset, side: int = SIDE) -> bytes:
    """A PNG, ``side`` pixels wide and high, of the thing alone from above in front, on a transparent background."""
    from PIL import Image

    thing = _alone(item)
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


def _alone(item: ObjectAsset) -> SceneObject:
    with TemporaryDirectory(prefix="simfoundry-alone-") as folder:
        lay(item.files, Path(folder))
        return lowered(item.spec, Path(folder), item.name)


def _bounds_of(item: ObjectAsset) -> tuple[Array, Array]:
    return bounds(_alone(item))


PROMPTS = {
    "A": "a_components.j2",
    "B": "b_topology.j2",
    "C": "c_variations.j2",
    "D": "d_edit.j2",
    "E": "e_verify.j2",
}
"""Functional components, whether topology may change, variations, the edit of the picture, the verdict."""


class PromptAnswer(BaseModel):
    """An answer of a model: read by a schema, never run, and cut to what is used."""


class ComponentNames(PromptAnswer):
    """Answer to A."""

    components: list[str] = Field(min_length=1, max_length=16, description="Names of the functional components.")


class TopologyAnswer(PromptAnswer):
    """Answer to B."""

    yes: bool = Field(description="Whether a variation of topology is reasonable.")


class Variations(PromptAnswer):
    """Answer to C."""

    geometry: list[str] = Field(default=[], max_length=16, description="Variations of geometry.")
    topology: list[str] = Field(default=[], max_length=16, description="Variations of topology.")
    visual: list[str] = Field(default=[], max_length=16, description="Variations of the looks.")


class PictureVerdict(PromptAnswer):
    """Answer to E."""

    real_world_reasonable: bool = Field(description="Whether such a thing is reasonable in the real world.")
    real_world_reason: str = Field(max_length=300, description="Why, in short.")
    scene_reasonable: bool = Field(description="Whether it is reasonable in this scene.")
    scene_reason: str = Field(max_length=300, description="Why, in short.")


def prompt(letter: str, **variables: Any) -> str:
    """The text of a prompt; a variable that it needs and is not given is an error."""
    return str(_environment().get_template(PROMPTS[letter]).render(**variables)).strip()


@cache
def _environment() -> Any:
    try:
        from jinja2 import DictLoader, Environment, StrictUndefined
    except ImportError:
        raise SimfoundryError(f"prompts need jinja2; install with `{install_line('vlm')}`") from None
    folder = files("simfoundry.cousins.objects") / "prompts"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in PROMPTS.values()}
    return Environment(loader=DictLoader(texts), undefined=StrictUndefined, autoescape=False)  # plain text, no HTML


@dataclass(frozen=True)
class SourceSetup:
    """Sources that a run brings along: the folder of its ``library``, and a ``vlm`` if the recipe names none.

    ``scene`` is the document of the twin's scene, of which models see a picture.
    """

    scene: Path
    library: Path | None = None
    vlm: str = ""


def opened(axis: ObjectAxis, given: SourceSetup, cache: Cache | None = None) -> Mapping[str, Origins]:
    """The sources that the objects of an axis name; raises :class:`ImpossibleError` with all that one of them lacks."""
    wanted = {source: name for name, of in reversed(axis.objects.items()) for source in of.sources}
    found: dict[str, Origins] = {}
    if "library" in wanted:
        if given.library is None:
            raise _lacking(wanted["library"], "library", "a `library`")
        found["library"] = Retrieval(VariantLibrary(given.library, cache))
    if "model" in wanted:
        found["model"] = _generation(axis, given, wanted["model"])
    return found


def _generation(axis: ObjectAxis, given: SourceSetup, name: str) -> Generation:
    """The models of the paper, as the recipe and the environment name them."""
    models, lacks = axis.models, []
    try:
        images = images_from_environment(model=models.images)
    except SimfoundryError as error:
        lacks.append(str(error))
    try:
        meshes = meshes_from_environment(texture=models.texture)
    except SimfoundryError as error:
        lacks.append(str(error))
    named = models.vlm or given.vlm
    if not named:
        lacks.insert(0, "no vision-language model: give --vlm, or `vlm` in the recipe's `models`")
    if lacks:
        raise _lacking(name, "model", f"models that are not there; {'; '.join(lacks)}")
    from simfoundry.cousins.run.report import draw

    picture = draw(given.scene)
    if picture is None:
        raise _lacking(name, "model", "a camera in the scene: models judge variants by its picture")
    return Generation(Vlm(named), images, meshes, picture)


def _lacking(name: str, source: str, need: str) -> ImpossibleError:
    return ImpossibleError((Reason("source", f"`{name}` has the source `{source}`, which needs {need}"),))
