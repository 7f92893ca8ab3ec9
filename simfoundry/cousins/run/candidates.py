"""Sample the candidates of a recipe.

Candidate k depends only on the recipe, its twin, the seed and k, so it is the same in every process. The axes are
sampled in this order: object variants, layout, distractors, task. The resulting scene is then settled and checked.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
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
from simfoundry.cousins.randomization.draws import DrawnValues
from simfoundry.cousins.randomization.varied_twin import ASSET, ValueSampler
from simfoundry.cousins.recipe import library
from simfoundry.cousins.recipe.candidate import Candidate, ImpossibleError, Reason, Rejected, file_of, free_name
from simfoundry.cousins.recipe.document import (
    Data,
    Recipe,
    own_task,
    read_recipe,
    scene_overlay,
    task_overlay,
)
from simfoundry.cousins.recipe.moved_objects import dependents, moved_joints, written
from simfoundry.cousins.recipe.variant_pool import Choice, VariantPool, variant_pool
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import SceneObject
from simfoundry.spec.check.scene import OF_LINKS
from simfoundry.spec.files import is_document
from simfoundry.spec.models.predicate import parse_call

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
    values: ValueSampler
    twins: dict[tuple[tuple[str, Path], ...], Twin] = field(default_factory=dict, repr=False)

    @classmethod
    def load(
        cls, path: Path, out: Path, seed: int, vlm: str = "", split: str = "", commercial_only: bool = False
    ) -> CandidateSampler:
        """Read a recipe, settle its twin, and collect the variant pool.

        Args:
            path: Path of the recipe.
            out: Output folder.
            seed: Seed of the run.
            vlm: Name of the vision-language model that may be queried for the variant pool.
            split: The split of `vary` to draw from, or empty to draw from all splits.
            commercial_only: Whether to refuse models that may not be used commercially.
        """
        recipe = read_recipe(path, seed, split)
        twin = Twin.of_document(recipe.task or recipe.scene, Cache.default())
        pool = variant_pool(recipe, out, twin, vlm, commercial_only)
        return cls(recipe, out, twin, pool, ValueSampler.of(recipe, out, twin))

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
        lost = tuple(_lost_relations(self, draw))
        if lost:
            return Candidate(index, reasons=lost)
        found = examine(draw.twin, draw.layout) if draw.is_moved else None
        if found is not None and not found.accepted:
            return Candidate(index, reasons=found.reasons)
        return _written(self, draw, found, index)

    def extended(
        self,
        twin: Twin,
        others: Mapping[str, Choice],
        added: Mapping[str, library.LibraryItem],
        varied: Mapping[str, SceneObject],
    ) -> Twin:
        """Return a twin with the objects in ``others`` replaced and those in ``added`` added but not yet placed.

        Args:
            twin: The twin, which has the drawn values of the candidate.
            others: Replacements by object name.
            added: Distractors by object name.
            varied: Lowered replacements that have drawn values, by object name.
        """
        if not others and not added:
            return twin
        if twin is not self.twin or varied:  # no other candidate has the same values
            return twin.extended(_objects(twin, others, added, varied))
        files = {**{n: choice.file for n, choice in others.items()}, **{n: item.file for n, item in added.items()}}
        key = tuple(files.items())
        if key not in self.twins:
            objects = _objects(self.twin, others, added, {})
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
        drawn: Values of the axis `vary`.
    """

    twin: Twin
    layout: Layout
    others: Mapping[str, Choice]
    added: Mapping[str, library.LibraryItem]
    drawn: DrawnValues

    @property
    def is_moved(self) -> bool:
        """True if the scene differs from the twin and must be settled, or if cameras see it from elsewhere."""
        return bool(self.layout.poses or self.others or self.added or not self.drawn.same_scene or self.drawn.views)

    @property
    def pictures_only(self) -> bool:
        """True if only pictures differ from the twin's."""
        return not (self.layout.poses or self.others or self.added) and self.drawn.pictures_only


def _draw(shared: CandidateSampler, index: int) -> _Draw | Rejected:
    """Sample the axes one after another. Each axis has a separate random stream, so axes do not affect each other."""
    by_object, by_layout, by_distractors = np.random.default_rng([shared.recipe.seed, index]).spawn(3)
    spec, pool = shared.recipe.spec, shared.pool
    if pool.most is not None:
        others = pool.combination((index - 1) // max(1, len(pool.tasks)))
    else:
        others = {name: of[int(by_object.integers(len(of)))] for name, of in pool.choices.items()}
    added = _distractors(shared, by_distractors)
    replaced = {name: choice.file for name, choice in others.items()}
    drawn = shared.values.draw(index, replaced)
    base = shared.values.varied_twin(index, drawn, replaced)
    if isinstance(base, Rejected):
        return base
    varied = {
        kind.removesuffix(ASSET): text
        for kind, text in shared.values.asset_documents(index, drawn, replaced).items()
        if kind.removesuffix(ASSET) in replaced
    }
    objects = {n: shared.values.lowered_object(index, n, replaced[n], text) for n, text in varied.items()}
    twin = shared.extended(base, others, added, objects)
    layout: Layout | Rejected = NOTHING
    if spec.scene is not None:
        layout = propose(twin, spec.scene, by_layout)
    if added and isinstance(layout, Layout):
        layout = scatter(twin, tuple(added), by_distractors, layout=layout)
    return layout if isinstance(layout, Rejected) else _Draw(twin, layout, others, added, drawn)


def _objects(
    twin: Twin,
    others: Mapping[str, Choice],
    added: Mapping[str, library.LibraryItem],
    varied: Mapping[str, SceneObject],
) -> list[SceneObject]:
    """Return the replaced and added objects of a candidate."""
    new = {name: varied.get(name) or library.lowered(choice.file) for name, choice in others.items()}
    replaced = [_in_place_of(twin.scene.object(name), item) for name, item in new.items()]
    return replaced + [replace(library.lowered(item.file), name=name) for name, item in added.items()]


def _lost_relations(shared: CandidateSampler, draw: _Draw) -> Iterator[Reason]:
    """Yield a reason for each relation of the twin that the drawn values break.

    Relations about a joint that varies need not hold.
    """
    if draw.drawn.same_scene:
        return
    joints = {name for name in draw.drawn.values if name.count(".") == 1}
    moved = {*draw.drawn.poses, *draw.others}
    for text in shared.twin.relations:
        call = parse_call(text)
        names = {argument.partition(".")[0] for argument in call.args}
        about_joint = call.predicate in ("Open", "Closed") and {arg.removesuffix(".deg") for arg in call.args} & joints
        if about_joint or names & moved or names & draw.layout.poses.keys():
            continue
        verdict = draw.twin.judge(text, draw.twin.state)
        if not verdict.value:
            why = f"{text} no longer holds with the drawn values: {verdict.why}"
            yield Reason("relation_lost", why, {"margin": verdict.margin})


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


def _in_place_of(old: SceneObject, new: SceneObject) -> SceneObject:
    return replace(new, name=old.name, category=old.category, fixed=old.fixed, X_WO=old.X_WO, labels=old.labels)


def _written(shared: CandidateSampler, draw: _Draw, found: Examined | None, index: int) -> Candidate:
    """Return the candidate for a draw that has settled, with either its documents or the reasons for rejection."""
    recipe, spec = shared.recipe, shared.recipe.scene_spec
    files = {name: choice.file for name, choice in draw.others.items()}
    documents = shared.values.asset_documents(index, draw.drawn, files)
    entries = {kind: draw.drawn.documents.get(kind, {}) for kind in ("scene", "task")}
    moved, goal = set[str](), ""
    changes = _changes(shared, draw, index)
    if found is not None:
        moved = {*draw.layout.poses, *draw.others, *draw.added}
        # What stands on an object whose height varies is placed on it again, unless its pose was written.
        moved |= dependents(spec, moved) | draw.drawn.poses.keys()
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
        fixed = {name: pose for name, pose in draw.drawn.poses.items() if name not in poses}
        documents["scene"] = scene_overlay(
            recipe, shared.out, index, changes, {**fixed, **poses}, joints, relations, entries["scene"]
        )
    elif recipe.spec.parameters or changes or entries["scene"]:
        documents["scene"] = scene_overlay(recipe, shared.out, index, changes, {}, {}, spec.relations, entries["scene"])
    if shared.pool.tasks:
        task = shared.pool.tasks[(index - 1) % len(shared.pool.tasks)]
        reasons = task.reasons(draw.twin, found.state if found is not None else draw.twin.state, draw.others)
        if reasons:
            return Candidate(index, reasons=reasons)
        own_scene = "scene" in documents
        documents["task"] = own_task(recipe, shared.out, index, task.spec, moved, own_scene, entries["task"])
        goal = task.goal
    elif recipe.task is not None:
        reasons = _undoable(recipe, draw, found)
        if reasons:
            return Candidate(index, reasons=reasons)
        own_scene = "scene" in documents
        documents["task"] = task_overlay(recipe, shared.out, index, moved, bool(draw.added), entries["task"], own_scene)
    documents = {kind: documents[kind] for kind in sorted(documents, key=lambda kind: (kind.endswith(ASSET), kind))}
    drawn = draw.drawn
    unchecked = found.unchecked if found is not None else ()
    is_picture = draw.pictures_only and not shared.pool.tasks
    return Candidate(index, documents, draw.layout.asked, goal, unchecked, (), drawn.values, drawn.split, is_picture)


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


def _changes(shared: CandidateSampler, draw: _Draw, index: int) -> dict[str, Data]:
    """Return the document fields of replaced and added objects, without their poses."""
    found: dict[str, Data] = {}
    for name, choice in draw.others.items():
        written = shared.recipe.scene_spec.objects[name]
        gone = [key for key in OF_LINKS if key in written.model_fields_set and is_document(choice.reference)]
        gone += ["joints"] if written.joints else []
        found[name] = {"asset": choice.reference, **dict.fromkeys(gone)}
    for name, item in draw.added.items():
        found[name] = item.data(shared.pool.references[item.name])
    for name in (kind.removesuffix(ASSET) for kind in draw.drawn.documents if kind.endswith(ASSET)):
        found[name] = {**found.get(name, {}), "asset": file_of(index, f"{name}{ASSET}")}
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
