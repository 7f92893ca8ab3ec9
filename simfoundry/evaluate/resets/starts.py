"""Initial states of rollouts, which are settled, verified, and the same for all policies.

The protocol follows the paper ("Real-to-Sim Policy Evaluations"): 25 rollouts, a 5 x 5 grid for each object, one cell
per rollout drawn without replacement, and a random rotation. An initial state depends only on the task, the seed and
its own index. The cousins of a recipe have different initial states, so that many cousins with few rollouts each cover
the regions of the task. If an object's cell conflicts with the cells of other objects, it is exchanged for the cell of
a later initial state. Initial states are cached on disk under a key derived from the content they depend on.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass, field
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from pydantic import TypeAdapter

from simfoundry.assets.cache import Cache, key_of
from simfoundry.backends.mjcf import compile_mjcf
from simfoundry.errors import SimfoundryError
from simfoundry.evaluate.resets.placement import (
    GridCell,
    Refusal,
    Spots,
    bounds,
    clash,
    deal,
    draws,
    left_cell,
    not_at_rest,
    placed,
    sample,
    settled,
)
from simfoundry.evaluate.task import Task
from simfoundry.geometry.frames import Pose, frozen_array
from simfoundry.predicates import Judge
from simfoundry.scene.state import SceneState
from simfoundry.spec.models.predicate import Condition
from simfoundry.worlds import open_world
from simfoundry.worlds.base import World

# Cache version; increment it when the same task and seed would produce different initial states.
VERSION = "starts/1"

# The cells of each object in all initial states of a block, and the states that were already found.
Known = tuple[dict[str, list[GridCell]], list[SceneState]]


def key_of_starts(task: Task, seed: int) -> str:
    """Return the cache key for the initial states of a task.

    The key covers the world in which the states are settled, the reset, the goal and the seed. It does not include the
    engine version, so initial states do not change when the engine is updated.
    """
    files = compile_mjcf(task.scene).files
    goal: bytes = TypeAdapter(Condition).dump_json(task.goal)
    reset = task.reset.model_dump_json()
    carriers = json.dumps(dict(task.carriers), sort_keys=True)
    content = [part for name in sorted(files) for part in (name, files[name])]
    return key_of(VERSION, str(draw_seed(task, seed)), reset, goal, carriers, *content)


def draw_seed(task: Task, seed: int) -> int:
    """Return the seed from which positions are drawn: the given one, or for a cousin a number derived from both.

    Otherwise, all cousins that keep the regions of their twin would start from the same positions.
    """
    origin = task.setup.task_spec.origin
    if origin is None or origin.cousin is None:
        return seed
    cousin = origin.cousin
    text = f"{seed} {cousin.recipe} {cousin.seed} {cousin.index}"
    return int.from_bytes(hashlib.sha256(text.encode()).digest()[:8])


def read_block(cache: Cache, key: str) -> Known | None:
    """Read the cached part of a block.

    The result is None if there is no entry or if the entry is damaged.
    """
    try:
        entry = json.loads(cache.get(key_of(key)) or b"")
        cells = {name: [(int(i), int(j)) for i, j in one] for name, one in entry["cells"].items()}
        return cells, [state_from_json(state) for state in entry["states"]]
    except (ValueError, KeyError, TypeError):
        return None


def write_block(cache: Cache, key: str, cells: Mapping[str, list[GridCell]], states: list[SceneState]) -> None:
    """Store the cells of a block and the states found so far."""
    entry = {"cells": dict(cells), "states": [state_to_json(state) for state in states]}
    cache.put(key_of(key), json.dumps(entry).encode())


def state_to_json(state: SceneState) -> dict[str, Any]:
    """Serialize a state without rounding.

    The result contains positions [m], quaternions (w, x, y, z), and joint positions [rad or m].
    """
    return {
        "poses": {name: _numbers(pose) for name, pose in state.poses.items()},
        "joints": dict(state.joints),
        "motions": {name: _numbers(pose) for name, pose in state.motions.items()},
    }


def state_from_json(data: Mapping[str, Any]) -> SceneState:
    """Restore the exact state that was serialized by :func:`state_to_json`."""
    return SceneState.of(
        {name: _pose(numbers) for name, numbers in data["poses"].items()},
        {name: float(position) for name, position in data["joints"].items()},
        {name: _pose(numbers) for name, numbers in data["motions"].items()},
    )


def _numbers(pose: Pose) -> list[float]:
    return [*pose.p.tolist(), *pose.q.tolist()]


def _pose(numbers: list[float]) -> Pose:
    # Pose.of would normalize the quaternion again and change its last bit.
    return Pose(frozen_array(numbers[:3], (3,)), frozen_array(numbers[3:7], (4,)))


# Number of attempts to place objects in their cells, and number of attempts for each exchange of cells.
TRIES, TRIES_ELSEWHERE = 20, 5

# Number of failures, other than conflicts between the cells of two objects, after which the search stops.
HOPELESS = 6

# Callback that receives the number of initial states found and the total number.
Progress = Callable[[int, int], None]


@dataclass(frozen=True, eq=False)
class RolloutStart:
    """The initial state of a rollout.

    Attributes:
        index: The index of the rollout, counted from 0.
        seed: The seed from which the initial state was derived.
        cells: The cell of each object, keyed by object name.
        state: The state at rest.
    """

    index: int
    seed: int
    cells: Mapping[str, GridCell]
    state: SceneState

    @property
    def digest(self) -> str:
        """A digest of sixteen hexadecimal digits that identifies the state."""
        text = json.dumps(state_to_json(self.state), sort_keys=True)
        return hashlib.sha256(text.encode()).hexdigest()[:16]


class StartError(SimfoundryError):
    """An error raised if no initial state is found.

    The message states the object, its cell and the reason.
    """


def starts(
    task: Task, n: int = 25, seed: int = 0, cache: Cache | None = None, progress: Progress | None = None
) -> tuple[RolloutStart, ...]:
    """Return the first ``n`` initial states of a task.

    Once there is an initial state for every grid cell, the cells are shuffled again.

    Args:
        task: The task.
        n: The number of initial states.
        seed: The seed for all random choices.
        cache: A cache that stores initial states by the content of the scene and the task, so that they are settled
            only once.
        progress: A callback that receives the number of initial states found so far and the total number.

    Raises:
        StartError: If an initial state cannot be found.
    """
    with closing(StartSearch(task, seed, cache)) as search:
        return search.first(n, progress)


@dataclass
class _Block:
    """The initial states of a block that have been found so far.

    The block also stores the cells of each object in all of its states.
    """

    first: int
    cells: dict[str, list[GridCell]]
    starts: list[RolloutStart] = field(default_factory=list)

    @classmethod
    def of(cls, task: Task, seed: int, block: int, known: Known | None) -> _Block:
        first = block * math.prod(task.reset.grid)
        if known is None:
            return cls(first, deal(task.reset, draw_seed(task, seed), block))
        made = cls(first, known[0])
        made.starts = [made.start(k, seed, state) for k, state in enumerate(known[1])]
        return made

    def at(self, k: int) -> Mapping[str, GridCell]:
        """Return the cells for the initial state with index ``k`` in the block."""
        return MappingProxyType({name: cells[k] for name, cells in self.cells.items()})

    def start(self, k: int, seed: int, state: SceneState) -> RolloutStart:
        """Return the initial state with index ``k`` in the block."""
        return RolloutStart(self.first + k, seed, self.at(k), state)

    def exchange(self, name: str, k: int, other: int) -> None:
        """Exchange the cells of an object in two initial states."""
        cells = self.cells[name]
        cells[k], cells[other] = cells[other], cells[k]


class StartSearch:
    """A search for the initial states of a task, which continues where the previous call stopped.

    Args:
        task: The task.
        seed: The seed for all random choices.
        cache: A cache that stores initial states, as in :func:`starts`.
        opened: A world of the task's scene and its judge. By default, a world is opened when it is first needed.
    """

    def __init__(
        self, task: Task, seed: int, cache: Cache | None = None, opened: tuple[World, Judge] | None = None
    ) -> None:
        self.task, self.seed, self._cache, self._given = task, seed, cache, opened
        self._blocks: dict[int, _Block] = {}

    @cached_property
    def _opened(self) -> tuple[World, Judge]:
        return self._given or (open_world(self.task.scene, "mujoco"), Judge(self.task.scene))

    @cached_property
    def _key(self) -> str:
        return key_of_starts(self.task, self.seed) if self._cache is not None else ""

    def close(self) -> None:
        """Close the world if the search opened it."""
        if "_opened" in vars(self) and self._given is None:
            self._opened[0].close()

    def first(self, n: int, progress: Progress | None = None) -> tuple[RolloutStart, ...]:
        """Return the first ``n`` initial states, as in :func:`starts`.

        Raises:
            StartError: If an initial state cannot be found.
        """
        size = math.prod(self.task.reset.grid)
        found: list[RolloutStart] = []
        for block in range(-(-n // size)):
            wanted = min(size, n - block * size)
            done = self._block(block, wanted)
            known = len(done.starts)
            while len(done.starts) < wanted:
                done.starts.append(self._next(done))
                if progress is not None:
                    progress(len(found) + len(done.starts), n)
            if self._cache is not None and len(done.starts) > known:
                write_block(self._cache, f"{self._key}/{block}", done.cells, [s.state for s in done.starts])
            found += done.starts[:wanted]
        return tuple(found)

    def _block(self, number: int, wanted: int) -> _Block:
        """Return a block with the states found so far, by this process or by others that share the cache."""
        if number not in self._blocks or len(self._blocks[number].starts) < wanted:
            known = read_block(self._cache, f"{self._key}/{number}") if self._cache is not None else None
            done = self._blocks.get(number)
            if done is None or (known is not None and len(known[1]) > len(done.starts)):
                self._blocks[number] = _Block.of(self.task, self.seed, number, known)
        return self._blocks[number]

    def _next(self, block: _Block) -> RolloutStart:
        """Find the next initial state of a block, exchanging cells with later initial states if necessary."""
        k = len(block.starts)
        seed = draw_seed(self.task, self.seed)
        rngs = {name: draws(name, seed, block.first + k) for name in self.task.reset.objects}
        cells = block.at(k)
        result = self._attempts(cells, rngs, TRIES)
        if isinstance(result, SceneState):
            return block.start(k, self.seed, result)
        refused = _commonest(result)
        for later in range(k + 1, math.prod(self.task.reset.grid) if refused.other else 0):
            block.exchange(refused.object, k, later)
            again = self._attempts(block.at(k), rngs, TRIES_ELSEWHERE)
            if isinstance(again, SceneState):
                return block.start(k, self.seed, again)
            block.exchange(refused.object, k, later)
        raise StartError(_complaint(self.task, block.first + k, refused, cells, result))

    def _attempts(
        self, cells: Mapping[str, GridCell], rngs: Mapping[str, np.random.Generator], tries: int
    ) -> SceneState | list[Refusal]:
        """Return a state with all objects in their cells, or the reasons why every attempt failed."""
        regions, grid = self.task.reset.objects, self.task.reset.grid
        refusals: list[Refusal] = []
        while len(refusals) < tries and sum(not r.other for r in refusals) < HOPELESS:
            spots = {name: sample(regions[name], grid, cell, rngs[name]) for name, cell in cells.items()}
            result = self._attempt(spots, cells)
            if isinstance(result, SceneState):
                return result
            refusals.append(result)
            if not spots:  # nothing is random, so another attempt would fail in the same way
                break
        return refusals

    def _attempt(self, spots: Spots, cells: Mapping[str, GridCell]) -> SceneState | Refusal:
        world, judge = self._opened
        state = placed(self.task, spots)
        result = clash(self.task, world, spots, state) or settled(self.task, world, state)
        if isinstance(result, Refusal):
            return result
        if refusal := left_cell(self.task, cells, result) or not_at_rest(world, result):
            return refusal
        verdict, reason = judge(self.task.goal, result), "the goal already holds"
        return Refusal(next(iter(cells), ""), reason, f"{reason}: {verdict.why}") if verdict.value else result


def _commonest(refusals: list[Refusal]) -> Refusal:
    """Return the first refusal of the most frequent kind."""
    kind = Counter((r.object, r.kind) for r in refusals).most_common(1)[0][0]
    return next(r for r in refusals if (r.object, r.kind) == kind)


def _complaint(task: Task, index: int, refused: Refusal, cells: Mapping[str, GridCell], refusals: list[Refusal]) -> str:
    """Describe the object and the cell for which no initial state was found.

    The description includes the most frequent reasons.
    """
    blamed = refused.object
    examples = {refusal.kind: refusal.why for refusal in reversed(refusals)}
    counts = Counter(refusal.kind for refusal in refusals).most_common(3)
    reasons = "; ".join(f"{count} times {examples[kind]}" for kind, count in counts)
    start = f"task `{task.name}`{f', step `{task.step}`' if task.step else ''}: initial state {index}"
    if blamed not in cells:
        return f"{start} is not valid: {reasons}"
    (low_x, high_x), (low_y, high_y) = bounds(task.reset.objects[blamed], task.reset.grid, cells[blamed])
    cell = f"cell {cells[blamed]} (x {low_x:.3f} to {high_x:.3f} m, y {low_y:.3f} to {high_y:.3f} m)"
    tries = f"{len(refusals)} attempts{', nor in any remaining cell' if refused.other else ''}"
    fix = "move its region under `reset`, or make the region smaller"
    return f"{start}: could not place `{blamed}` in {cell} in {tries}: {reasons}; {fix}"
