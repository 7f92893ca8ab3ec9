"""How fast the compiled MJCF steps, beside one that is written by hand: prints medians of one run.

    python -m tests.benchmarks.stepping [--runs 9] [--json FILE]

``by hand`` is what an expert writes of the same scene with the same options: no geoms that are only seen; a table whose
priority gives it the right friction against the most frequent surface, and near it against others; and between things
the larger friction of two, which is MuJoCo's own rule and not quite the same physics. ``with pairs`` is the same
physics with a ``<pair>`` for each two colliders whose surfaces differ. All are at rest when they are timed, each on one
core, in turns. ``ratio`` is the speed of ours to that by hand, ``to pairs`` to that with pairs, ``opened`` that of the
files opened plainly to that by hand; ``real time`` is how
many seconds of the world one second computes.

``--meshes FOLDER`` adds ten things of the meshes in a folder (``*/*.obj``, as of YCB), decomposed by CoACD; that takes
minutes once and is kept in the cache. Robots are left out: their models are their makers'.
"""

from __future__ import annotations

import argparse
import json
import shutil
import statistics
import tempfile
import time
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import mujoco

from simfoundry.assets.cache import Cache
from simfoundry.backends import compile_scene
from simfoundry.backends.mjcf.contact_rules import CONTACTS_FILE, EMPTY, desired_contact, is_native
from simfoundry.backends.mjcf.contacts import contact_geoms, exact_model, surface_attributes
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from tests.benchmarks import reference

SPECS = Path(__file__).parents[2] / "specs" / "scenes"
SETTLE_S = 1.0
"""Before the first timed step [s]."""

CUP = "[[0, 0], [0.028, 0], [0.04, 0.08], [0.037, 0.08], [0.025, 0.004], [0, 0.004]]"
"""The profile of a hollow thing: convex pieces of a ring and a floor [m]."""

MUG, WOOD = 0.35, 0.5
"""Frictions of a cup and of the table under it."""


def cups(table: float) -> str:
    """Ten hollow cups on a table of a friction."""
    lines = [
        "simfoundry: scene/1",
        "name: cups",
        f"materials: {{ceramic: {{density: 2400, friction: {MUG}}}, wood: {{density: 700, friction: {table}}}}}",
        "objects:",
        "  table: {fixed: true, shape: {box: [2, 2, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}",
    ]
    for k in range(10):
        pose = f"{{xyz: [{0.2 * (k % 5) - 0.4:.6g}, {0.2 * (k // 5) - 0.1:.6g}, 0], yaw_deg: {36 * k}}}"
        lines.append(f"  cup_{k}: {{shape: {{lathe: {{profile: {CUP}}}}}, material: ceramic, pose: {pose}}}")
    return "\n".join([*lines, ""])


def models(scene: Scene, by_hand: str | None) -> dict[str, mujoco.MjModel]:
    """The compiled model, that ``by_hand`` (or ours as an expert would simplify it), and one with all pairs."""
    files = compile_scene(scene, "mjcf").files
    assets = {path: data for path, data in files.items() if path.startswith("assets/")}
    assets[CONTACTS_FILE] = EMPTY.encode()
    ours = files["scene.xml"].decode()
    texts = {"by hand": by_hand or simplified(scene, ours), "with pairs": paired(scene, ours)}
    found = {name: mujoco.MjModel.from_xml_string(text, assets) for name, text in texts.items()}
    plain_files = assets | {CONTACTS_FILE: files[CONTACTS_FILE]}
    return {"ours": exact_model(files), "opened": mujoco.MjModel.from_xml_string(ours, plain_files)} | found


def plain(text: str) -> ET.Element:
    """Ours without geoms that are only seen: each geom has its own friction."""
    root = ET.fromstring(text)
    for body in root.iter("body"):
        for geom in body.findall("geom"):
            if geom.get("class") == "visual":
                body.remove(geom)
    return root


def simplified(scene: Scene, text: str) -> str:
    """An expert's: what stands still decides over all, with the friction that it has against most of what moves."""
    root = plain(text)
    geoms = contact_geoms(scene)
    most = Counter(geom.surface for geom in geoms if not geom.static).most_common(1)[0][0]
    static = {geom.name: geom.surface for geom in geoms if geom.static}
    for geom in root.iter("geom"):
        surface = static.get(geom.get("name", ""))
        if surface is not None:
            geom.attrib |= surface_attributes(desired_contact(surface, most)) | {"priority": "1"}
    return ET.tostring(root, encoding="unicode")


def paired(scene: Scene, text: str) -> str:
    """The same physics with a pair for each two colliders that can meet and whose surfaces differ."""
    root = plain(text)
    contact = root.find("contact")
    contact = ET.SubElement(root, "contact") if contact is None else contact
    excluded = {frozenset((e.get("body1"), e.get("body2"))) for e in contact.findall("exclude")}
    for a, b in combinations(contact_geoms(scene), 2):
        apart = a.body == b.body or (a.static and b.static) or frozenset((a.body, b.body)) in excluded
        if not apart and not is_native(a.surface, b.surface):
            friction = desired_contact(a.surface, b.surface).friction
            ET.SubElement(contact, "pair", geom1=a.name, geom2=b.name, friction=f"{friction} {friction} 0 0 0")
    return ET.tostring(root, encoding="unicode")


def things(meshes: Path, folder: Path) -> str:
    """Ten decomposed meshes, copied to ``folder``, on a table; they are of two materials other than the table's."""
    lines = [
        "simfoundry: scene/1",
        "name: things",
        "materials: {a: {density: 400, friction: 0.35}, b: {density: 400, friction: 0.6}, "
        "wood: {density: 700, friction: 0.5}}",
        "objects:",
        "  table: {fixed: true, shape: {box: [3, 2, 0.04]}, material: wood, pose: {xyz: [0, 0, -0.02]}}",
    ]
    for k, mesh in enumerate(sorted(meshes.glob("**/*.obj"))[:10]):
        shutil.copy(mesh, folder / f"thing_{k}.obj")
        how = f"collision: decompose, solid: hull, material: {'ab'[k % 2]}"
        place = f"pose: {{xyz: [{0.4 * (k % 5) - 0.8:.6g}, {0.4 * (k // 5) - 0.2:.6g}, 0.15]}}"
        lines.append(f"  thing_{k}: {{asset: thing_{k}.obj, {how}, {place}}}")
    return "\n".join([*lines, ""])


def scenes(folder: Path, meshes: Path | None) -> Iterator[tuple[str, dict[str, mujoco.MjModel]]]:
    """The scenes that are timed."""

    def lowered(name: str, text: str) -> Scene:
        path = folder / f"{name}.scene.yaml"
        path.write_text(text)
        return lower_file(path, Cache.default())

    options = '<option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>'
    for count in (10, 100):
        by_hand = reference.mjcf(count).replace("<default>", f"{options}<default>", 1)
        yield f"{count} primitives", models(lowered("grid", reference.document(count)), by_hand)
    yield "10 cups, one friction", models(lowered("cups", cups(MUG)), None)
    yield "10 cups, two frictions", models(lowered("cups", cups(WOOD)), None)
    if meshes is not None:
        yield "10 decomposed meshes", models(lowered("things", things(meshes, folder)), None)
    for name in ("serve_fruits", "cup_in_bowl", "stack_dishware", "clear_table", "cluttered"):
        scene = lower_file(SPECS / f"{name}.scene.yaml", Cache.default())
        yield f"specs: {name}", models(replace(scene, robots=(), mounted=()), None)


def step_times(found: dict[str, mujoco.MjModel], runs: int) -> dict[str, float]:
    """Median seconds of processor time a step takes in each model, in turns."""
    datas: dict[str, mujoco.MjData] = {}
    for name, model in found.items():
        datas[name] = mujoco.MjData(model)
        if model.nkey:
            mujoco.mj_resetDataKeyframe(model, datas[name], 0)
        mujoco.mj_step(model, datas[name], round(SETTLE_S / model.opt.timestep))
    times: dict[str, list[float]] = {name: [] for name in found}
    for _ in range(runs):
        for name, model in found.items():
            start = time.process_time()
            mujoco.mj_step(model, datas[name], 250)
            times[name].append((time.process_time() - start) / 250)
    return {name: statistics.median(values) for name, values in times.items()}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--meshes", type=Path)
    arguments = parser.parse_args()
    rows: dict[str, dict[str, float]] = {}
    print(f"{'':<24}  us a step  real time  ratio  to pairs  opened  pairs  geoms")
    with tempfile.TemporaryDirectory() as folder:
        for name, found in scenes(Path(folder), arguments.meshes):
            times, model = step_times(found, arguments.runs), found["ours"]
            rows[name] = {
                "seconds": times["ours"],
                "real_time": model.opt.timestep / times["ours"],
                "ratio": times["by hand"] / times["ours"],
                "to_pairs": times["with pairs"] / times["ours"],
                "opened": times["by hand"] / times["opened"],
            }
            row = rows[name]
            print(
                f"{name:<24} {1e6 * row['seconds']:10.1f} {row['real_time']:10.1f} {row['ratio']:6.2f} "
                f"{row['to_pairs']:9.2f} {row['opened']:7.2f} {found['opened'].npair:6} {model.ngeom:6}"
            )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
