"""Write the outputs of a run: the manifest, summaries, images, and a USD stage with all cousins as variants.

``manifest.json`` contains the request, every cousin, and every rejected candidate with its reasons. The manifest is
written line by line, so it can be larger than the available memory. It contains no timestamps, paths or process counts,
so identical runs produce identical bytes.

The stage ``NAME.usda`` references ``NAME/usd``, a build of the twin that also contains the objects from all cousins.
Each variant in the variant set ``cousin`` poses the moved objects, selects the variants of replaced objects, and
deactivates absent objects. The variant ``twin`` is the twin itself.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Iterator, Mapping
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.backends.artifact import number
from simfoundry.cousins.recipe.candidate import Candidate
from simfoundry.cousins.recipe.document import Recipe, relative
from simfoundry.cousins.run.log import Reader
from simfoundry.cousins.run.run import MANIFEST, Ledger, RunPlan
from simfoundry.errors import OutputError
from simfoundry.geometry.frames import Pose
from simfoundry.runtime.files import MARK, writing_atomically
from simfoundry.scene.state import pose
from simfoundry.spec.models.base import PoseSpec
from simfoundry.spec.yaml.text import parse

if TYPE_CHECKING:
    from simfoundry.render.montage import Image

# Format version of the manifest.
VERSION = "cousins-run/1"


def summary(plan: RunPlan, ledger: Ledger) -> dict[str, Any]:
    """Return statistics on a run and its object variants.

    ``end`` is `complete`, `hopeless` or `exhausted`.
    """
    return {
        "simfoundry": VERSION,
        **plan.about,
        "end": str(ledger.end),
        "asked": plan.wanted,
        "examined": ledger.examined,
        "accepted": len(ledger.accepted),
        "acceptance_rate": round(ledger.rate, 4),
        "reasons": dict(sorted(ledger.totals.items(), key=lambda pair: (-pair[1], pair[0]))),
        "unchecked": list(ledger.unchecked),
        "variants": {count.name: count.to_json() for count in plan.variants},
        **({"vary": dict(plan.varied)} if plan.varied else {}),
    }


def write_manifest(plan: RunPlan, ledger: Ledger) -> Path:
    """Write the manifest to the output folder and return its path."""
    path = plan.out / MANIFEST
    with Reader() as reader, writing_atomically(path) as stream:
        head = json.dumps(summary(plan, ledger), indent=1, ensure_ascii=False)
        stream.write(head.removesuffix("\n}").encode())
        for key, accepted in (("cousins", True), ("rejected", False)):
            stream.write(f',\n "{key}": ['.encode())
            for k, place in enumerate(p for p in ledger.counted() if p.accepted is accepted):
                text = json.dumps(_entry(reader.candidate(place)), ensure_ascii=False)
                stream.write(f"{',' if k else ''}\n  {text}".encode())
            stream.write(b"\n ]")
        stream.write(b"\n}\n")
    return path


def _entry(candidate: Candidate) -> dict[str, Any]:
    if not candidate.accepted:
        return {"index": candidate.index, "reasons": [reason.to_json() for reason in candidate.reasons]}
    entry: dict[str, Any] = {"index": candidate.index, "files": candidate.files(), "asked": list(candidate.asked)}
    return entry | ({"goal": candidate.goal} if candidate.goal else {}) | candidate.drawn()


def told(ledger: Ledger, top: int = 3) -> str:
    """Summarize the progress of a run, including up to ``top`` of the most frequent reasons for rejection.

    An example is ``412 of 1000, 69% accepted; no_room 120, out_of_reach 43``.
    """
    text = f"{len(ledger.accepted)} of {ledger.wanted}"
    if ledger.examined:
        text += f", {ledger.rate:.0%} accepted"
    if ledger.totals:
        text += "; " + ", ".join(f"{code} {count}" for code, count in ledger.totals.most_common(top))
    return text


def examples(ledger: Ledger) -> dict[str, str]:
    """Return the first rejection message for each rejection code, in order of decreasing frequency of the code."""
    found: dict[str, str] = {}
    with Reader() as reader:
        for place in ledger.counted():
            if place.accepted or len(found) == len(ledger.totals):
                continue
            for reason in reader.candidate(place).reasons:
                found.setdefault(reason.code, reason.text)
    return {code: found[code] for code, _ in ledger.totals.most_common() if code in found}


# Image width [px].
WIDTH = 384


def draw(file: Path) -> bytes | None:
    """Render a scene from its viewpoint, or from its first camera if it has no viewpoint.

    Returns:
        The image as PNG data, or None if the scene has no cameras.
    """
    from simfoundry.render.montage import png_bytes

    image = rendered(file)
    return None if image is None else png_bytes(image)


def rendered(file: Path) -> Image | None:
    """Render a scene as :func:`draw` does, and return the image."""
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.worlds.base import resized
    from simfoundry.worlds.render import render

    loaded = load_scene(file)
    assert isinstance(loaded.spec, SceneSpec)
    scene = lower(loaded, Cache.default())
    cameras = {camera.name: camera for camera in scene.cameras}
    camera = cameras.get(loaded.spec.viewpoint or "") or next(iter(cameras.values()), None)
    if camera is None:
        return None
    height = max(1, round(camera.height * WIDTH / camera.width))
    return render(scene, resized(camera, WIDTH, height))


# Maximum number of pictures on a preview sheet, including that of the twin, and their number in a row.
SHEET, COLUMNS = 16, 4


def write_preview(plan: RunPlan, ledger: Ledger, twin: Path, path: Path) -> Path:
    """Write a sheet with the pictures of the twin and of the first cousins that have a scene of their own.

    Raises:
        OutputError: If the scene has no cameras.
    """
    from simfoundry.render.montage import save_png, side_by_side

    with Reader() as reader:
        accepted = (reader.candidate(place) for place in ledger.counted() if place.accepted)
        files = [
            plan.out / c.files()["scene"] for c in islice((c for c in accepted if "scene" in c.documents), SHEET - 1)
        ]
    panels = [("twin", rendered(twin)), *((file.name.split(".")[0], rendered(file)) for file in files)]
    shown = [(caption, image) for caption, image in panels if image is not None]
    if not shown:
        raise OutputError(f"{twin} has no cameras, so there is nothing to preview; add one under `cameras`")
    save_png(path, side_by_side(shown, columns=COLUMNS))
    return path


# -- USD stage ---------------------------------------------------------------------------------------------------------

# Names of the variant set and of the variant that represents the twin.
SET, TWIN = "cousin", "twin"

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

_PLACED = """\
                over "{name}"{choice}
                {{
                    quatd xformOp:orient = ({quaternion})
                    double3 xformOp:translate = ({xyz})
                    uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:orient"]
                }}
"""

Objects = Mapping[str, Mapping[str, Any]]


def write_stage(plan: RunPlan, ledger: Ledger, recipe: Recipe, path: Path) -> Path:
    """Write a stage that contains all cousins in a run to ``path`` and return the path.

    Raises:
        OutputError: The file name does not end with `.usda`.
    """
    from simfoundry.targets.build import build

    if path.suffix != ".usda":
        raise OutputError(f"stages are written in text format; name the file {path.with_suffix('.usda').name}")
    added, others = dict[str, Mapping[str, Any]](), dict[str, dict[str, str]]()
    for _, objects in _cousins(ledger, recipe):
        for name, data in objects.items():
            if name not in recipe.scene_spec.objects:
                added.setdefault(name, data)
            elif "asset" in data:
                others.setdefault(name, {})[_variant(data["asset"])] = data["asset"]
    whole = _whole(plan, recipe, added, others)
    home = {name: item.X_WO for name, item in whole.by_name.items()}
    build(whole, ("usd",), path.with_suffix(""))
    with writing_atomically(path) as stream:
        stream.write(_HEAD.format(mark=MARK, whole=f"./{path.stem}/usd/scene.usda", set=SET, first=TWIN).encode())
        stream.write(_block(TWIN, {}, added, home).encode())
        for index, objects in _cousins(ledger, recipe):
            stream.write(_block(f"c{index:06d}", objects, added, home).encode())
        stream.write(b"    }\n}\n")
    return path


def _cousins(ledger: Ledger, recipe: Recipe) -> Iterator[tuple[int, Objects]]:
    """Yield the index of each cousin that has a scene document, along with the object entries in that document.

    An asset with drawn values is replaced by the asset that it extends, because stages do not contain the values.
    """
    with Reader() as reader:
        for candidate in (reader.candidate(place) for place in ledger.counted() if place.accepted):
            if "scene" not in candidate.documents:
                continue
            objects = dict(parse(candidate.documents["scene"]).data.get("objects", {}))
            for kind, text in candidate.documents.items():
                if (name := kind.removesuffix(".asset")) != kind:
                    asset, of_twin = parse(text).data["extends"], recipe.scene_spec.objects[name].asset
                    other = {k: v for k, v in objects[name].items() if k != "asset"}
                    is_twin = of_twin is not None and Path(asset).name == Path(of_twin).name
                    objects[name] = other if is_twin else {**other, "asset": asset}
            yield candidate.index, objects


def _variant(asset: str) -> str:
    return Path(asset).name.split(".")[0]


def _whole(plan: RunPlan, recipe: Recipe, added: Objects, others: Mapping[str, Mapping[str, str]]) -> Any:
    """Lower the scene of the twin with everything that cousins add to it.

    The result includes all added objects and, as variants, all replacements.
    """
    from simfoundry.assets.cache import Cache
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
    loaded = load(plan.out / "whole.scene.yaml", text=write_tree(plain_tree(data), SceneSpec))
    return lower(loaded, Cache.default())


def _block(name: str, objects: Objects, added: Iterable[str], home: Mapping[str, Pose]) -> str:
    """Format a single variant of the variant set."""
    lines = [f'        "{name}" {{', '            over "Objects"', "            {"]
    lines += [f'                over "{other}" (active = false) {{}}' for other in added if other not in objects]
    for own, data in objects.items():
        chosen = _variant(data["asset"]) if "asset" in data and own not in added else ""
        choice = f' (variants = {{ string variant = "{chosen}" }})' if chosen else ""
        X_WO = pose(PoseSpec(**data["pose"])) if "pose" in data else home[own]
        xyz, quaternion = (", ".join(number(float(v)) for v in values) for values in (X_WO.p, X_WO.q))
        lines += _PLACED.format(name=own, choice=choice, quaternion=quaternion, xyz=xyz).splitlines()
    return "\n".join([*lines, "            }", "        }", ""])
