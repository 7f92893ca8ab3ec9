"""Every scene of ``specs/`` to USD, MJCF and URDF and back: ``python -m tests.corpora.roundtrip``.

MJCF and URDF are imported and lowered; the scene that comes back is compared with the one that was compiled, field by
field (:mod:`tests.scenes_apart`). What differs must be of a feature that the loss report of the compile names.

USD carries the document. Each stage is read as it was written, as a crate, flattened, and below a layer of somebody's
own; from each the document comes back byte for byte, and compiling what was read gives the same stage. One thing after
another is then moved, and exactly that comes back. Every stage is held to all validators of USD. Prints two tables;
exit code 1 if a bar is missed.
"""

from __future__ import annotations

import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.backends import compile_scene
from simfoundry.backends.usd import compile_usd
from simfoundry.frontends.importer import import_file
from simfoundry.frontends.usd.compiled.loading import import_usd, load_usd, read_stage
from simfoundry.scene.lower import lower, lower_file
from simfoundry.scene.model import Scene
from tests.scenes_apart import Apart, apart
from tests.specs.documents import SCENES, SPECS, name_of
from tests.targets.everything import LIGHTS, write_everything

if TYPE_CHECKING:
    from pxr import Usd

MAINS = {"mjcf": "scene.xml", "urdf": "poses.json"}
"""What is imported of each target."""

DESK = SPECS / "captures" / "desk" / "desk.scene.yaml"

CARRIERS = ("as written", "crate", "flattened", "sublayer")


@dataclass(frozen=True)
class Trip:
    """What became of one scene; ``problems`` say in words what did not come back."""

    name: str
    kilobytes: float
    payload: float
    read_ms: float
    moved: int
    problems: tuple[str, ...]


def main() -> int:
    """Print the table."""
    print(f"{'scene':<20}{'scene.usda':>12}{'of it ours':>12}{'read':>9}{'moved':>8}  problems")
    trips = []
    for path in SCENES:
        with tempfile.TemporaryDirectory() as folder:
            trips.append(trip(path, Path(folder)))
        t = trips[-1]
        problems = "; ".join(t.problems) or "none"
        print(f"{t.name:<20}{t.kilobytes:>9.0f} kB{t.payload:>11.0%}{t.read_ms:>6.0f} ms{t.moved:>8}  {problems}")
    wrong = sum(bool(t.problems) for t in trips)
    print(f"{len(trips) - wrong} of {len(trips)} scenes come back byte for byte from {', '.join(CARRIERS)}")
    return 1 if lowered_trips() or wrong else 0


def lowered_trips() -> int:
    """Print the table of MJCF and URDF; returns how many trips lost something without saying so."""
    print(f"\n{'scene':<20}" + "".join(f"{target + ': fields apart':>24}{'unsaid':>8}" for target in MAINS))
    failures: list[str] = []
    with tempfile.TemporaryDirectory() as folder:
        for path in (write_everything(Path(folder), *LIGHTS, "background_mesh"), DESK, *SCENES):
            cells = ""
            for target in MAINS:
                with tempfile.TemporaryDirectory() as place:
                    said, unsaid = trip_by_scene(lower_file(path), target, Path(place))
                cells += f"{len(said) + len(unsaid):>24}{len(unsaid):>8}"
                failures += [f"{name_of(path)} through {target}: {each}" for each in unsaid]
            print(f"{name_of(path):<20}{cells}")
    print("\n".join(failures) or "every field that differs is in the loss report of its compile")
    return len(failures)


def trip_by_scene(scene: Scene, target: str, folder: Path) -> tuple[list[Apart], list[Apart]]:
    """A scene to a target, imported and lowered: in what it differs as the loss report says, and beyond that."""
    artifact = compile_scene(scene, target)
    artifact.write(folder / "build")
    document = folder / "back" / f"{scene.name}.scene.yaml"
    import_file(folder / "build" / MAINS[target], document)
    lost = {loss.feature for loss in artifact.losses}
    different = apart(scene, lower_file(document))
    return [d for d in different if d.feature in lost], [d for d in different if d.feature not in lost]


def trip(path: Path, folder: Path) -> Trip:
    """One scene there and back in every way."""
    from pxr import Usd

    artifact = compile_usd(lower_file(path))
    artifact.write(folder)
    file = folder / "scene.usda"
    stage = Usd.Stage.Open(str(file))
    problems = [f"{len(errors)} validation errors" for errors in (validation_errors(stage),) if errors]
    for name, carrier in zip(CARRIERS, carriers(file, stage), strict=True):
        if import_usd(carrier, path).text != path.read_text(encoding="utf-8"):
            problems.append(f"another document from {name}")
    start = time.perf_counter()
    loaded = load_usd(file)
    read_ms = (time.perf_counter() - start) * 1e3
    if loaded.errors or compile_usd(lower(loaded)).files != artifact.files:
        problems.append("another stage from what was read")
    moved = [name for name, right in moves(file) if right]
    count = len(read_stage(file).data["objects"])
    if len(moved) != count:
        problems.append(f"{count - len(moved)} moves do not come back alone")
    size = len(artifact.files["scene.usda"])
    return Trip(name_of(path), size / 1e3, payload(stage) / size, read_ms, len(moved), tuple(problems))


def carriers(file: Path, stage: Usd.Stage) -> Iterator[Path]:
    """The stage in each of the ways in which people keep it."""
    from pxr import Sdf

    yield file
    crate, flat, top = (file.with_name(name) for name in ("crate.usdc", "flat.usdc", "top.usda"))
    stage.GetRootLayer().Export(str(crate))
    yield crate
    stage.Flatten().Export(str(flat))
    yield flat
    layer = Sdf.Layer.CreateNew(str(top))
    layer.subLayerPaths = ["./scene.usda"]
    layer.Save()
    yield top


def moves(file: Path) -> Iterator[tuple[str, bool]]:
    """Each object moved by 5 cm in a layer on top, and whether that is all that comes back."""
    from pxr import Gf, Sdf, Usd

    before = read_stage(file)
    for name in before.data["objects"]:
        layer = Sdf.Layer.CreateNew(str(file.with_name(f"{name}.usda")))
        layer.subLayerPaths = ["./scene.usda"]
        edited = Usd.Stage.Open(layer)
        attribute = edited.GetPrimAtPath(f"/World/Objects/{name}").GetAttribute("xformOp:translate")
        if not attribute:
            continue
        attribute.Set(attribute.Get() + Gf.Vec3d(0, 0, 0.05))
        layer.Save()
        after = read_stage(Path(layer.realPath)).data["objects"]
        changed = {other for other in after if after[other] != before.data["objects"][other]}
        places = {other for other, item in before.data["objects"].items() if name in str(item.get("place"))}
        written = after[name].get("pose", {}).get("xyz", ())
        right = changed == {name} | places and list(written) == [round(v, 4) + 0.0 for v in attribute.Get()]
        yield name, right


def validation_errors(stage: Usd.Stage) -> list[str]:
    """What USD's own validators say."""
    from pxr import UsdValidation

    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    return [str(e.GetErrorAsString()) for e in UsdValidation.ValidationContext(validators).Validate(stage)]


def payload(stage: Usd.Stage) -> int:
    """How many characters the document and what the stage said take."""
    entries = [prim.GetCustomDataByKey("simfoundry") or {} for prim in stage.Traverse()]
    return sum(len(str(v)) for each in entries for key, v in each.items() if key in ("document", "spec", "built"))


if __name__ == "__main__":
    sys.exit(main())
