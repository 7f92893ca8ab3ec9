"""Sample the candidates of a recipe.

Candidate k depends only on the recipe, its twin, the seed and k, so it is the same in every process. The axes are
sampled in this order: object variants, layout, distractors, task. The resulting scene is then settled and checked.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.cousins.layout.acceptance import Examined, examine
from simfoundry.cousins.layout.constraints import placement_constraints, too_full
from simfoundry.cousins.layout.propose import NOTHING, Layout, propose, scatter
from simfoundry.cousins.layout.twin import Twin
from simfoundry.cousins.recipe import library
from simfoundry.cousins.recipe.candidate import Candidate, ImpossibleError, Reason, Rejected, free_name
from simfoundry.cousins.recipe.document import (
    Data,
    Recipe,
    dependents,
    moved_joints,
    own_task,
    read_recipe,
    scene_overlay,
    task_overlay,
    written,
)
from simfoundry.cousins.recipe.variant_pool import Choice, VariantPool, variant_pool
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import SceneObject
from simfoundry.spec.check.scene import OF_LINKS
from simfoundry.spec.files import is_document

# Factory of the sampler that a worker calls for each candidate.
FUNCTION = "simfoundry.cousins.run.candidates:CandidateSampler.load"

# Maximum number of twins with replaced or added objects to keep in memory. Each takes about 10 MB. With 16 twins,
# recipes with few variants prepare each combination only once.
KEPT_TWINS = 16


@dataclass(frozen=True, eq=False)
class CandidateSampler:
    """A sampler for a recipe's candidates in one process.

    All candidates share the twin and the variant pool.
    """

    recipe: Recipe
    out: Path
    twin: Twin
    pool: VariantPool
    twins: dict[tuple[tuple[str, Path], ...], Twin] = field(default_factory=dict, repr=False)

    @classmethod
    def load(cls, path: Path, out: Path, seed: int, vlm: str = "") -> CandidateSampler:
        """Read a recipe, settle its twin, and collect the variant pool.

        Args:
            path: Path of the recipe.
            out: Output folder.
            seed: Seed of the run.
            vlm: Name of the vision-language model that may be queried for the variant pool.
        """
        recipe = read_recipe(path, seed)
        twin = Twin.of_document(recipe.task or recipe.scene, Cache.default())
        return cls(recipe, out, twin, variant_pool(recipe, out, twin, vlm))

    def require_possible(self) -> None:
        """Check that the recipe can be satisfied by at least one candidate.

        Raises:
            ImpossibleError: If no candidate can satisfy the recipe.
        """
        twin, axis, distractors = self.twin, self.recipe.spec.scene, self.recipe.spec.distractors
        asks = placement_constraints(twin, axis) if axis is not None else None
        places = twin.places if distractors is not None else ()
        if distractors is not None and places:
            around = asks.support.name if asks is not None and asks.support is not None else ""
            full = too_full(twin, places, axis, self.recipe.distractors, distractors.count[0], around)
            if full:
                raise ImpossibleError(full)

    def __call__(self, index: int) -> Candidate:
        """Return the candidate with the given 1-based index."""
        draw = _draw(self, index)
        if isinstance(draw, Rejected):
            return Candidate(index, reasons=draw.reasons)
        found = examine(draw.twin, draw.layout) if draw.is_moved else None
        if found is not None and not found.accepted:
            return Candidate(index, reasons=found.reasons)
        return _written(self, draw, found, index)

    def extended(self, others: Mapping[str, Choice], added: Mapping[str, library.LibraryItem]) -> Twin:
        """Return the twin with the objects in ``others`` replaced and those in ``added`` added but not yet placed."""
        if not others and not added:
            return self.twin
        files = {**{n: choice.file for n, choice in others.items()}, **{n: item.file for n, item in added.items()}}
        key = tuple(files.items())
        if key not in self.twins:
            objects = [_in_place_of(self.twin.scene.object(name), choice) for name, choice in others.items()]
            objects += [replace(library.lowered(item.file), name=name) for name, item in added.items()]
            while len(self.twins) >= KEPT_TWINS:
                del self.twins[next(iter(self.twins))]
            self.twins[key] = self.twin.extended(objects)
        return self.twins[key]


@dataclass(frozen=True, eq=False)
class _Draw:
    """A random draw from all axes.

    Attributes:
        twin: The twin with replaced and added objects.
        layout: The new poses.
        others: Replacements for objects in the twin, keyed by object name.
        added: Distractors, keyed by object name.
    """

    twin: Twin
    layout: Layout
    others: Mapping[str, Choice]
    added: Mapping[str, library.LibraryItem]

    @property
    def is_moved(self) -> bool:
        """True if the scene differs from the twin and must be settled."""
        return bool(self.layout.poses or self.others or self.added)


def _draw(shared: CandidateSampler, index: int) -> _Draw | Rejected:
    """Sample the axes one after another. Each axis has a separate random stream, so axes do not affect each other."""
    by_object, by_layout, by_distractors = np.random.default_rng([shared.recipe.seed, index]).spawn(3)
    spec, pool = shared.recipe.spec, shared.pool
    if pool.most is not None:
        others = pool.combination((index - 1) // max(1, len(pool.tasks)))
    else:
        others = {name: of[int(by_object.integers(len(of)))] for name, of in pool.choices.items()}
    added = _distractors(shared, by_distractors)
    twin = shared.extended(others, added)
    layout: Layout | Rejected = NOTHING
    if spec.scene is not None:
        layout = propose(twin, spec.scene, by_layout)
    if added and isinstance(layout, Layout):
        layout = scatter(twin, tuple(added), by_distractors, layout=layout)
    return layout if isinstance(layout, Rejected) else _Draw(twin, layout, others, added)


def _distractors(shared: CandidateSampler, rng: np.random.Generator) -> dict[str, library.LibraryItem]:
    """Choose distractors from the library, and give them names that are not yet used in the scene.

    No distractor is repeated until all have been used.
    """
    axis = shared.recipe.spec.distractors
    if axis is None:
        return {}
    items, spec = shared.recipe.distractors, shared.recipe.scene_spec
    count = int(rng.integers(axis.count[0], axis.count[1], endpoint=True))
    order = [k for _ in range(-(-count // len(items)) if items else 0) for k in rng.permutation(len(items))]
    found = dict[str, library.LibraryItem]()
    for k in order[:count]:
        found[free_name(items[k].name, {*spec.objects, *spec.robots, *found})] = items[k]
    return found


def _in_place_of(old: SceneObject, choice: Choice) -> SceneObject:
    new = library.lowered(choice.file)
    return replace(new, name=old.name, category=old.category, fixed=old.fixed, X_WO=old.X_WO, labels=old.labels)


def _written(shared: CandidateSampler, draw: _Draw, found: Examined | None, index: int) -> Candidate:
    """Return the candidate for a draw that has settled, with either its documents or the reasons for rejection."""
    recipe, spec = shared.recipe, shared.recipe.scene_spec
    documents, moved, goal = dict[str, str](), set[str](), ""
    if found is not None:
        moved = {*draw.layout.poses, *draw.others, *draw.added}
        moved |= dependents(spec, moved)
        free = [n for n in moved if not draw.twin.scene.object(n).fixed]
        poses = {name: found.state.poses[name] for name in sorted(free)}
        state = replace(found.state, poses={**found.state.poses, **written(poses)})
        for text in draw.layout.asked:
            verdict = draw.twin.judge(text, state)
            if not verdict.value:
                why = f"{text} no longer holds when the poses are rounded as written to documents: {verdict.why}"
                return Candidate(index, reasons=(Reason("too_close", why, {"margin": verdict.margin}),))
        joints = moved_joints(draw.twin.scene, found.state, poses)
        relations = _relations(draw, state, spec.relations)
        changes = _changes(shared, draw)
        documents["scene"] = scene_overlay(recipe, shared.out, index, changes, poses, joints, relations)
    elif recipe.spec.parameters:
        documents["scene"] = scene_overlay(recipe, shared.out, index, {}, {}, {}, spec.relations)
    if shared.pool.tasks:
        task = shared.pool.tasks[(index - 1) % len(shared.pool.tasks)]
        reasons = task.reasons(draw.twin, found.state if found is not None else draw.twin.state, draw.others)
        if reasons:
            return Candidate(index, reasons=reasons)
        documents["task"] = own_task(recipe, shared.out, index, task.spec, moved, "scene" in documents)
        goal = task.goal
    elif recipe.task is not None:
        reasons = _undoable(recipe, draw, found)
        if reasons:
            return Candidate(index, reasons=reasons)
        documents["task"] = task_overlay(recipe, shared.out, index, moved, bool(draw.added))
    return Candidate(index, documents, draw.layout.asked, goal, found.unchecked if found is not None else ())


def _undoable(recipe: Recipe, draw: _Draw, found: Examined | None) -> tuple[Reason, ...]:
    """Return the reasons why this combination of variants makes the twin's task impossible."""
    from simfoundry.cousins.tasks.acceptance import impossible
    from simfoundry.cousins.tasks.candidate_poses import objects_of
    from simfoundry.cousins.tasks.context import TaskContext
    from simfoundry.robots.reach import hands_of

    goal = draw.twin.goal
    if found is None or goal is None or not set(objects_of(goal)) & set(draw.others):
        return ()
    return impossible(
        goal, TaskContext(draw.twin.at(found.state), hands_of(recipe.scene_spec.robots, FrameTree(recipe.scene_spec)))
    )


def _changes(shared: CandidateSampler, draw: _Draw) -> dict[str, Data]:
    """Return the document fields of replaced and added objects, without their poses."""
    found: dict[str, Data] = {}
    for name, choice in draw.others.items():
        written = shared.recipe.scene_spec.objects[name]
        gone = [key for key in OF_LINKS if key in written.model_fields_set and is_document(choice.reference)]
        gone += ["joints"] if written.joints else []
        found[name] = {"asset": choice.reference, **dict.fromkeys(gone)}
    for name, item in draw.added.items():
        found[name] = item.data(shared.pool.references[item.name])
    return found


def _relations(draw: _Draw, state: Any, stated: tuple[str, ...]) -> tuple[str, ...]:
    """Return the relations to write to the document.

    These are the relations of the twin that still hold, the requested relations, and the relations between added
    objects and their supports.
    """
    more = [text for text in draw.layout.asked if text not in stated]
    holds = [text for text in stated if draw.twin.judge(text, state).value]
    for name in draw.added:
        supports = (f"OnTop({name}, {item.name})" for item in draw.twin.scene.objects if item.fixed)
        more += islice((text for text in supports if draw.twin.judge(text, state).value), 1)
    return (*holds, *more)
