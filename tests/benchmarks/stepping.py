"""How fast the compiled MJCF steps, beside one that is written by hand: prints medians of one run.

    python -m tests.benchmarks.stepping [--runs 9] [--json FILE]

``by hand`` is the same scene with the same options, without what a step does not need: no geoms that are only seen,
and instead of a ``<pair>`` for each two colliders whose surfaces differ, the priority of the table where that says the
same. ``larger friction`` leaves the pairs out and lets MuJoCo take the larger friction of two geoms: other physics, and
what most files do. All are at rest when they are timed, each on one core, in turns. ``ratio`` is the speed of ours to
that by hand; ``real time`` is how many seconds of the world one second computes.
"""

from __future__ import annotations

import argparse
import json
import re
import statistics
import tempfile
import time
from collections.abc import Iterator
from math import sqrt
from pathlib import Path

import mujoco

from simfoundry.assets.cache import Cache
from simfoundry.backends import compile_scene
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
    """The compiled model, that ``by_hand`` (or ours without what is only seen), and one without pairs."""
    files = compile_scene(scene, "mjcf").files
    assets = {path: data for path, data in files.items() if path.startswith("assets/")}
    ours = files["scene.xml"].decode()
    unseen = re.sub(r' *<geom class="visual"[^>]*/>\n', "", ours)
    plain = re.sub(r" *<pair [^>]*/>\n", "", unseen)
    texts = {"ours": ours, "by hand": by_hand or unseen, "larger friction": plain}
    return {name: mujoco.MjModel.from_xml_string(text, assets) for name, text in texts.items()}


def with_priority(scene: Scene, table: str) -> str:
    """Ours for a table and things of one other friction: its priority says for all pairs what each pair would."""
    text = compile_scene(scene, "mjcf").files["scene.xml"].decode()
    text = re.sub(r' *<(?:geom class="visual"|pair )[^>]*/>\n', "", text)
    mu = f'friction="{sqrt(MUG * WOOD):.12g} 0.005 0.0001" priority="1"'
    return re.sub(rf'(name="{table}.shape"[^>]*) friction="[^"]*"', rf"\1 {mu}", text)


def scenes(folder: Path) -> Iterator[tuple[str, dict[str, mujoco.MjModel]]]:
    """The scenes that are timed."""

    def lowered(name: str, text: str) -> Scene:
        path = folder / f"{name}.scene.yaml"
        path.write_text(text)
        return lower_file(path)

    options = '<option timestep="0.002" integrator="implicitfast" cone="elliptic" impratio="10"/>'
    for count in (10, 100):
        by_hand = reference.mjcf(count).replace("<default>", f"{options}<default>", 1)
        yield f"{count} primitives", models(lowered("grid", reference.document(count)), by_hand)
    yield "10 cups, one friction", models(lowered("cups", cups(MUG)), None)
    two = lowered("cups", cups(WOOD))
    yield "10 cups, two frictions", models(two, with_priority(two, "table"))
    for name in ("serve_fruits", "cluttered"):
        yield f"specs: {name}", models(lower_file(SPECS / f"{name}.scene.yaml", Cache.default()), None)


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
    arguments = parser.parse_args()
    rows: dict[str, dict[str, float]] = {}
    print(f"{'':<24}  us a step  real time  ratio  to larger friction  pairs  geoms")
    with tempfile.TemporaryDirectory() as folder:
        for name, found in scenes(Path(folder)):
            times, model = step_times(found, arguments.runs), found["ours"]
            rows[name] = {
                "seconds": times["ours"],
                "real_time": model.opt.timestep / times["ours"],
                "ratio": times["by hand"] / times["ours"],
                "to_larger_friction": times["larger friction"] / times["ours"],
            }
            row = rows[name]
            print(
                f"{name:<24} {1e6 * row['seconds']:10.1f} {row['real_time']:10.1f} {row['ratio']:6.2f} "
                f"{row['to_larger_friction']:19.2f} {model.npair:6} {model.ngeom:6}"
            )
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(rows, indent=2) + "\n")


if __name__ == "__main__":
    main()
