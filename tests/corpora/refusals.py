"""What `check` lets pass, everything else takes: ``python -m tests.corpora.refusals [--count N]``.

Documents are changed in one place, oddly but often validly. Each that `check` finds no error in is lowered, compiled to
the four formats, loaded in MuJoCo and PyBullet, stepped, and judged; a task is prepared with each of its steps. What
refuses it then, or leaves a state that is not finite, is a gap of `check`. Prints the gaps; exits with 1 if there are
any.
"""

from __future__ import annotations

import argparse
import os
import random
import re
import shutil
import sys
import tempfile
import traceback
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.backends import compile_scene
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.task import Task, load_task, need_robots
from simfoundry.predicates import Judge
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState
from simfoundry.spec.diagnostics import Severity, SpecError
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.worlds import open_world
from tests.conftest import REPOSITORY
from tests.corpora.mutations import findings
from tests.corpora.odd_documents import odd_mutants
from tests.corpora.spec_mutants import Mutant

ROOTS = (REPOSITORY / "tests" / "corpora" / "documents", REPOSITORY / "specs")
COUNT = 2000
BACKENDS = ("mjcf", "usd", "urdf", "pybullet")
STEPS = 25
"""The steps that a world takes: what an engine cannot integrate is not finite within a few of them."""


@dataclass
class Outcomes:
    """How many corruptions were found by `check`, how many were taken by everything, and the gaps by reason."""

    found: int = 0
    taken: int = 0
    crashed: list[str] = field(default_factory=list)
    gaps: dict[str, list[str]] = field(default_factory=dict)


def refusals(count: int, seed: int = 0, roots: tuple[Path, ...] = ROOTS, only: str = "") -> Outcomes:
    """Try ``count`` odd documents, evenly of each kind of change."""
    outcomes = Outcomes()
    with tempfile.TemporaryDirectory() as folder:
        os.environ.setdefault("SIMFOUNDRY_CACHE", f"{folder}/cache")
        (Path(folder) / "simfoundry.yaml").touch()
        every: dict[str, list[tuple[Path, Mutant]]] = {}
        for k, root in enumerate(roots):
            shutil.copytree(root, Path(folder) / f"{k}")
        for path in sorted(p for p in Path(folder).rglob("*.yaml") if is_document(p)):
            rng = random.Random(f"{seed} {path.relative_to(folder)}")
            for mutant in odd_mutants(path.read_text(), rng):
                if only in mutant.kind:
                    every.setdefault(mutant.kind, []).append((path, mutant))
        for chosen in every.values():
            random.Random(seed).shuffle(chosen)
        while count > 0 and any(every.values()):
            for chosen in (some for some in every.values() if some and count > 0):
                count -= 1
                attempt(*chosen.pop(), outcomes)
    return outcomes


def attempt(path: Path, mutant: Mutant, outcomes: Outcomes) -> None:
    """Check a changed document in the place of the original, and use it if there are no errors."""
    before, what = path.read_bytes(), f"{path.name}: {mutant.done} (line {mutant.line})"
    path.write_text(mutant.text)
    try:
        loaded, found = findings(path)
        if any(d.severity is Severity.ERROR for d in found):
            outcomes.found += 1
            return
        users = [path] if isinstance(loaded.spec, SceneSpec | TaskSpec) else list(_scenes_with(path))
        for user in users:
            if any(d.severity is Severity.ERROR for d in findings(user)[1]):
                continue
            reason = refusal(user)
            if reason:
                outcomes.gaps.setdefault(_kind(reason), []).append(f"{what}: {reason}")
                return
        outcomes.taken += 1
    except Exception:
        outcomes.crashed.append(f"{what}\n{traceback.format_exc()}")
    finally:
        path.write_bytes(before)


def _scenes_with(asset: Path) -> Iterator[Path]:
    """One scene that uses an asset."""
    users = (p for p in sorted(asset.parent.parent.rglob("*.scene.yaml")) if asset.name in p.read_text())
    yield from list(users)[:1]


def _kind(reason: str) -> str:
    return re.sub(r"`[^`]*`|[0-9.e+-]+|/\S+", "_", reason)[:90]


def refusal(path: Path) -> str:
    """Use a document for all that it is for; the reason why something refuses it, or an empty string."""
    try:
        if path.name.endswith(".task.yaml"):
            return _use_task(path)
        if path.name.endswith(".scene.yaml"):
            loaded, _ = findings(path)
            return _use_scene(lower(loaded, Cache.default(), fetch=False))
    except (SimfoundryError, SpecError) as error:
        return f"{type(error).__name__}: {error}"
    except Exception as error:
        where = traceback.extract_tb(error.__traceback__)[-1]
        return f"CRASH {type(error).__name__}: {error} at {Path(where.filename).name}:{where.lineno}"
    return ""


def _use_scene(scene: Scene) -> str:
    for backend in BACKENDS:
        compile_scene(scene, backend)
    judge, state = Judge(scene), SceneState.initial(scene)
    for relation in scene.relations:
        judge(f"{relation.predicate}({', '.join(relation.args)})", state)
    for engine in ("mujoco", "pybullet"):
        world = open_world(scene, engine)
        try:
            world.step(STEPS)
            after = world.state()
        finally:
            world.close()
        numbers = [*after.joints.values(), *(v for X in after.poses.values() for v in (*X.p, *X.q))]
        if not np.isfinite(np.array(numbers)).all():
            return f"{engine}: the state is not finite"
        if np.abs(np.array(numbers)).max(initial=0.0) > 1e7:
            return f"{engine}: the state explodes"
    return ""


def _use_task(path: Path) -> str:
    task = load_task(path, Cache.default())
    if not task.missing_robots:
        need_robots(task)
    _judge_goals(task, {name: step.goal for name, step in task.subtasks.items()} | {"": task.goal})
    for name, step in task.subtasks.items():
        _judge_goals(task.alone(name), {name: step.goal})
    return ""


def _judge_goals(task: Task, goals: dict[str, Any]) -> None:
    judge, state = Judge(task.scene), SceneState.initial(task.scene)
    lacks = set(task.missing_robots)
    for goal in goals.values():
        if not lacks or not re.search("Grasped|Lifted|Released|" + "|".join(lacks), str(goal)):
            judge(goal, state)


def main() -> int:
    """Print the gaps."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--only", default="", help="Only kinds of changes whose name contains this.")
    parser.add_argument("--own", action="store_true", help="Only the documents made for this, not the real ones.")
    options = parser.parse_args()
    outcomes = refusals(options.count, options.seed, ROOTS[:1] if options.own else ROOTS, options.only)
    for crash in outcomes.crashed[:10]:
        print(crash, file=sys.stderr)
    for kind, cases in sorted(outcomes.gaps.items(), key=lambda entry: -len(entry[1])):
        print(f"{len(cases)} x {kind}")
        for case in cases[:3]:
            print(f"    {case[:300]}")
    gaps = sum(map(len, outcomes.gaps.values()))
    print(f"{outcomes.found} found by check, {outcomes.taken} taken, {len(outcomes.crashed)} crashed, {gaps} gaps")
    return int(bool(gaps or outcomes.crashed))


if __name__ == "__main__":
    sys.exit(main())
