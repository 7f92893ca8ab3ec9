"""All cousins on one USD stage: the twin with the union of their objects, and a variant set that selects a cousin.

``NAME.usda`` references a build of that union beside it, ``NAME/usd``. Each variant of the set ``cousin`` poses moved
objects, selects the variants of replaced objects, and deactivates absent ones; ``twin`` is the twin itself.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from pathlib import Path
from typing import Any

from simfoundry.backends.artifact import number
from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.recipe.document import Recipe
from simfoundry.cousins.run.log import Reader
from simfoundry.cousins.run.run import Ledger, RunPlan
from simfoundry.errors import OutputError
from simfoundry.geometry.frames import Pose
from simfoundry.runtime.files import MARK, writing_atomically
from simfoundry.scene.state import pose
from simfoundry.spec.models import base
from simfoundry.spec.yaml.text import parse

SET, TWIN = "cousin", "twin"
"""Name of the variant set, and of its variant for the twin."""

_HEAD = """\
#usda 1.0
(
    "{mark}"
    defaultPrim = "World"
    kilogramsPerUnit = 1
    metersPerUnit = 1
    upAxis = "Z"
)

def Xform "World" (
    references = @{whole}@
    variants = {{
        string {set} = "{first}"
    }}
    prepend variantSets = "{set}"
)
{{
    variantSet "{set}" = {{
"""

Objects = Mapping[str, Mapping[str, Any]]


def write_stage(plan: RunPlan, ledger: Ledger, recipe: Recipe, path: Path) -> Path:
    """Write the stage of a run's cousins; raises :class:`OutputError` if they have no scenes of their own."""
    if path.suffix != ".usda":
        raise OutputError(f"a stage is written as text; name it {path.with_suffix('.usda').name}")
    added: dict[str, Mapping[str, Any]] = {}
    others: dict[str, dict[str, str]] = {}
    for _, objects in _cousins(ledger):
        for name, data in objects.items():
            if name not in recipe.scene_spec.objects:
                added.setdefault(name, data)
            elif "asset" in data:
                others.setdefault(name, {})[_variant(data["asset"])] = data["asset"]
    whole = _whole(plan, recipe, added, others)
    home = {name: item.X_WO for name, item in whole.by_name.items()}
    _build(whole, path)
    with writing_atomically(path) as stream:
        stream.write(_head(path).encode())
        stream.write(_block(TWIN, {}, added, home).encode())
        for index, objects in _cousins(ledger):
            stream.write(_block(f"c{index:06d}", objects, added, home).encode())
        stream.write(b"    }\n}\n")
    return path


def _cousins(ledger: Ledger) -> Iterator[tuple[int, Objects]]:
    """Yield the object entries of each cousin's document."""
    with Reader() as reader:
        for place in ledger.counted():
            candidate = reader.candidate(place) if place.accepted else Candidate(0)
            if "scene" in candidate.documents:
                yield candidate.index, parse(candidate.documents["scene"]).data.get("objects", {})


def _variant(asset: str) -> str:
    return Path(asset).name.split(".")[0]


def _whole(plan: RunPlan, recipe: Recipe, added: Objects, others: Mapping[str, Mapping[str, str]]) -> Any:
    """Lower the twin's scene with all objects that cousins add, and with replacements as variants."""
    from simfoundry.assets.cache import Cache
    from simfoundry.cousins.recipe.overlay import relative
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.spec.yaml.tree import plain_tree
    from simfoundry.spec.yaml.write import write_tree

    data: dict[str, Any] = {
        "simfoundry": "scene/1",
        "extends": relative(recipe.scene.path, plan.out),
        "name": recipe.spec.name,
        "objects": {name: dict(item) for name, item in added.items()}
        | {name: {"variants": {key: {"asset": ref} for key, ref in of.items()}} for name, of in others.items()},
    }
    text = write_tree(plain_tree(data), SceneSpec)
    loaded = load(plan.out / "whole.scene.yaml", text=text)
    return lower(loaded, Cache.default())


def _build(whole: Any, path: Path) -> None:
    from simfoundry.targets.build import build

    build(whole, ("usd",), path.with_suffix(""))


def _head(path: Path) -> str:
    return _HEAD.format(mark=MARK, whole=f"./{path.stem}/usd/scene.usda", set=SET, first=TWIN)


def _block(name: str, objects: Objects, added: Iterable[str], home: Mapping[str, Pose]) -> str:
    """Format one variant of the set."""
    lines = [f'        "{name}" {{', '            over "Objects"', "            {"]
    lines += [f'                over "{other}" (active = false) {{}}' for other in added if other not in objects]
    for thing, data in objects.items():
        chosen = _variant(data["asset"]) if "asset" in data and thing not in added else ""
        choice = f' (variants = {{ string variant = "{chosen}" }})' if chosen else ""
        X_WO = pose(base.PoseSpec(**data["pose"])) if "pose" in data else home[thing]
        lines += [f'                over "{thing}"{choice}', "                {", *_placed(X_WO), "                }"]
    return "\n".join([*lines, "            }", "        }", ""])


def _placed(X_WO: Pose) -> Iterator[str]:
    pad = " " * 20
    xyz, quaternion = (", ".join(number(float(v)) for v in values) for values in (X_WO.p, X_WO.q))
    yield f"{pad}quatd xformOp:orient = ({quaternion})"
    yield f"{pad}double3 xformOp:translate = ({xyz})"
    yield f'{pad}uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]'
