"""Where the variants of a recipe come from beyond rules: a library of meshes, and models. Opened when one is needed."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.cousins.objects.generation import Generation
from simfoundry.cousins.objects.retrieval import Library, Retrieval
from simfoundry.cousins.objects.variants import Origins
from simfoundry.cousins.reasons import ImpossibleError, Reason
from simfoundry.errors import SimfoundryError
from simfoundry.models.images import images_from_environment
from simfoundry.models.meshes import meshes_from_environment
from simfoundry.models.vlm import Vlm
from simfoundry.spec.models.cousins import ObjectAxis


@dataclass(frozen=True)
class Given:
    """What a run brings along: the folder of its ``library``, and the name of a ``vlm`` where the recipe has none.

    ``scene`` is the document of the twin's scene, of which models see a picture.
    """

    scene: Path
    library: Path | None = None
    vlm: str = ""


def opened(axis: ObjectAxis, given: Given, cache: Cache | None = None) -> Mapping[str, Origins]:
    """The sources that the objects of an axis name; raises :class:`ImpossibleError` with all that one of them lacks."""
    wanted = {source: name for name, of in reversed(axis.objects.items()) for source in of.sources}
    found: dict[str, Origins] = {}
    if "library" in wanted:
        if given.library is None:
            raise _lacking(wanted["library"], "library", "a `library`")
        found["library"] = Retrieval(Library(given.library, cache))
    if "model" in wanted:
        found["model"] = _generation(axis, given, wanted["model"])
    return found


def _generation(axis: ObjectAxis, given: Given, name: str) -> Generation:
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
    from simfoundry.cousins.gallery import draw

    picture = draw(given.scene)
    if picture is None:
        raise _lacking(name, "model", "a camera in the scene: models judge variants by its picture")
    return Generation(Vlm(named), images, meshes, picture)


def _lacking(name: str, source: str, need: str) -> ImpossibleError:
    return ImpossibleError((Reason("source", f"`{name}` has the source `{source}`, which needs {need}"),))
