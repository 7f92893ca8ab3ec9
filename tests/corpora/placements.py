"""Predicates against what simulators and ray casts show, of random things stacked, contained, hung and leaning.

    python -m tests.corpora.placements [N] [--half tune|report] [--out FILE.jsonl]

Of N placements (500 by default) each is simulated for a second in MuJoCo and in PyBullet. There `OnTop` and `Inside`
are compared with which object the contact forces show to carry which, and `Under`, `Above` and `Inside` with a ray cast
of BEHAVIOR's definitions; for `Inside` both as they are and with the container beneath the object. The seeds are in two
halves: thresholds are chosen on the even fours (`tune`), the odd ones are reported in docs/predicates.md. A line is
printed for each disagreement; with `--out`, what was found is kept there, and placements that are in it are not run
again. Exits with 1 if a share of pairs is above the bar.
"""

from __future__ import annotations

import argparse
import json
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np

from simfoundry.predicates import Judge, PredicateError
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.worlds.mujoco_world import MujocoWorld
from simfoundry.worlds.pybullet_world import PybulletWorld
from tests.corpora.placement_references import (
    Engine,
    MujocoForces,
    PybulletForces,
    Rays,
    carried_by,
    carriers,
    is_above,
    is_enclosed,
    is_inside,
    is_under,
    run,
)
from tests.corpora.placement_scenes import placement

BAR = 0.02
"""The share of pairs of things on which a predicate and what it is compared with may disagree."""

SETTLED = 0.01
"""What moves faster than this [m/s] rests on nothing, and is left out."""

G = 9.81
NEAR = 0.02
"""Pairs whose bounds are farther apart than this [m], and not over each other, count for nothing: they are too easy."""


def compared(seed: int) -> dict[str, Any]:
    """What was found of one placement: by engine and question, how many pairs were asked and what disagrees."""
    with TemporaryDirectory() as temporary:
        kind, scene = placement(seed, Path(temporary))
    out: dict[str, Any] = {"seed": seed, "kind": kind, "asked": {}, "differ": []}
    forces: tuple[Engine, Engine] = MujocoForces(MujocoWorld(scene)), PybulletForces(PybulletWorld(scene))
    for name, engine in zip(("mujoco", "pybullet"), forces, strict=True):
        with engine.world:
            for question, asked, differ in _questions(scene, engine):
                key = f"{name} {question}"
                out["asked"][key] = asked
                out["differ"] += [f"{key}: {text}" for text in differ]
    return out


def _questions(scene: Scene, engine: Engine) -> Iterator[tuple[str, int, list[str]]]:
    pushes = run(engine)
    state: SceneState = engine.world.state()
    weights = {o.name: G * sum(k.mass for k in o.links) for o in scene.objects if not o.fixed}
    rests = {name for name in weights if state.speeds.get(name, 0.0) <= SETTLED}
    direct = carriers(pushes, weights)
    with MujocoWorld(scene) as world:
        world.reset(state)
        rays = Rays(world)
        pairs = [(a, b.name) for a in weights for b in scene.objects if a != b.name and _near(rays, a, b.name)]
        seen = {pair: rays.adjacency(*pair) for pair in pairs}
    judge = Judge(scene)

    def ours(text: str) -> tuple[bool, str]:
        try:
            verdict = judge(text, state)
        except PredicateError as error:
            return False, str(error)
        return verdict.value, verdict.why

    def asked(predicate: str, expected: dict[tuple[str, str], bool]) -> tuple[int, list[str]]:
        differ = []
        for (a, b), wanted in expected.items():
            found, why = ours(f"{predicate}({a}, {b})")
            if found != wanted:
                push = pushes.get((a, b), np.zeros(3)) / weights[a]
                shown = ", ".join(f"{v:+.2f}" for v in push)
                differ.append(f"{predicate}({a}, {b}) is {found}, expected {wanted}; push/weight {shown}; {why}")
        return len(expected), differ

    resting = [pair for pair in pairs if pair[0] in rests]
    carried = {pair: pair[1] in direct[pair[0]] for pair in resting}
    yield "OnTop, forces", *asked("OnTop", carried)
    enclosed = {pair: is_enclosed(seen[pair]) for pair in resting}
    bears = {pair: carried_by(*pair, pushes, weights) for pair in resting}
    yield "Inside, forces", *asked("Inside", {pair: enclosed[pair] and bears[pair] for pair in resting})
    yield "Inside, rays", *asked("Inside", {pair: is_inside(seen[pair]) for pair in resting})
    yield "Inside, BEHAVIOR", *asked("Inside", enclosed)
    yield "Under, rays", *asked("Under", {pair: is_under(one) for pair, one in seen.items()})
    yield "Above, rays", *asked("Above", {pair: is_above(one) for pair, one in seen.items()})


def _near(rays: Rays, a: str, b: str) -> bool:
    """Whether two things are near, or one over the other, by their bounds."""
    (low_a, high_a), (low_b, high_b) = rays.bounds[a], rays.bounds[b]
    gap = np.maximum(low_a - high_b, low_b - high_a)
    return bool((gap[:2] <= NEAR).all())


def main() -> int:
    """Print the disagreements and the table; 1 where the bar is missed."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("count", nargs="?", type=int, default=500)
    parser.add_argument("--half", choices=("tune", "report", "both"), default="both")
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    done: dict[int, dict[str, Any]] = {}
    if given.out is not None and given.out.exists():
        done = {row["seed"]: row for row in map(json.loads, given.out.read_text().splitlines())}
    wanted = {"tune": (0,), "report": (1,), "both": (0, 1)}[given.half]
    rows = []
    for seed in range(given.count):
        if seed // 4 % 2 not in wanted:  # four kinds take turns
            continue
        row = done.get(seed) or compared(seed)
        if seed not in done and given.out is not None:
            with given.out.open("a") as file:
                file.write(json.dumps(row) + "\n")
        rows.append(row)
        for text in row["differ"]:
            print(f"{seed} {row['kind']}: {text}", flush=True)
    return _table(rows)


def _table(rows: list[dict[str, Any]]) -> int:
    pairs, differ, placements = Counter[str](), Counter[str](), Counter[str]()
    for row in rows:
        pairs.update(row["asked"])
        keys = [text.partition(":")[0] for text in row["differ"]]
        differ.update(keys)
        placements.update(set(keys))
    print(f"\n{len(rows)} placements")
    print(f"{'question':28}{'pairs':>8}{'differ':>8}{'share':>8}{'placements':>12}{'share':>8}")
    for key in pairs:
        shares = differ[key] / max(pairs[key], 1), placements[key] / len(rows)
        print(f"{key:28}{pairs[key]:8}{differ[key]:8}{shares[0]:8.1%}{placements[key]:12}{shares[1]:8.1%}")
    return int(any(differ[key] > BAR * pairs[key] for key in pairs))


if __name__ == "__main__":
    sys.exit(main())
