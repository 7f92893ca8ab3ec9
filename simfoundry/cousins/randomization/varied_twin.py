"""The twin of a cousin with drawn values: its documents in memory, lowered and settled like the twin itself."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.cousins.layout.acceptance import DRIFT, TILT_DEG
from simfoundry.cousins.layout.twin import Twin, TwinError
from simfoundry.cousins.randomization.draws import DrawnValues, TwinContext, draw_values
from simfoundry.cousins.randomization.quantiles import QuantileSource
from simfoundry.cousins.recipe.candidate import Reason, Rejected, file_of
from simfoundry.cousins.recipe.document import Recipe, asset_overlay, scene_overlay
from simfoundry.cousins.recipe.library import described
from simfoundry.cousins.recipe.moved_objects import dependents
from simfoundry.evaluate.task import task_of
from simfoundry.scene.lower import lower
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.scene.robot import mujoco_model
from simfoundry.spec.check.varied_fields import FieldFinder
from simfoundry.spec.check.varied_places import ValueKind
from simfoundry.spec.check.vary import VariedValue, varied_values
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.load import Known, load
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import Start
from simfoundry.spec.models.vary import ShiftDistribution
from simfoundry.worlds.rest import is_ball, tilt_deg

# Suffix of the kind of document that contains the drawn values of an object's asset.
ASSET = ".asset"


@dataclass(frozen=True, eq=False)
class VariedScenes:
    """Draws the values of a recipe and derives the scenes that have them, without settling them.

    Attributes:
        recipe: The recipe.
        out: Folder in which the documents would be located; relative paths in them start there.
        context: The properties of the twin on which draws depend.
    """

    recipe: Recipe
    out: Path
    context: TwinContext
    _known: Known = field(default_factory=dict, repr=False)

    @classmethod
    def of_pictures(cls, recipe: Recipe, scene: Scene) -> VariedScenes:
        """Return the scenes of a recipe that changes only pictures.

        Args:
            recipe: The recipe.
            scene: The twin's lowered scene.
        """
        out = recipe.loaded.path.parent
        context = TwinContext(recipe.scene_spec, scene, recipe.loaded, out, MappingProxyType({}), MappingProxyType({}))
        return cls(recipe, out, context)

    def source(self, index: int) -> QuantileSource:
        """Return the quantiles of the values with an index."""
        return QuantileSource.of(self.recipe.seed, index, self.recipe.spec.splits, self.recipe.split)

    def draw_pictures(self, index: int) -> DrawnValues:
        """Draw values for the twin's own assets."""
        return draw_values(self.recipe.varied, self.source(index), self.context)

    def lowered(self, index: int, drawn: DrawnValues) -> Scene:
        """Lower the scene with drawn values, in the initial state of the task if the twin is a task.

        Raises:
            SpecError: If a value is invalid in its document.
        """
        return self._lowered(self._scene(index, drawn, {}), drawn)

    def asset_documents(self, index: int, drawn: DrawnValues, replaced: Mapping[str, Path]) -> dict[str, str]:
        """Return the texts of the assets with drawn values, by kind of document (`cup.asset`)."""
        found = {}
        for kind, entries in drawn.documents.items():
            if kind.endswith(ASSET):
                name = kind.removesuffix(ASSET)
                item = self.recipe.scene_spec.objects[name]
                file = replaced.get(name) or self.recipe.scene.file(str(item.asset))
                found[kind] = asset_overlay(self.recipe, self.out, index, file, entries)
        return found

    def _scene(self, index: int, drawn: DrawnValues, replaced: Mapping[str, Path]) -> Loaded:
        """Return the twin's scene with drawn values.

        Raises:
            SpecError: If a value is invalid in its document.
        """
        text = scene_overlay(
            self.recipe, self.out, index, {}, drawn.poses, {}, self.recipe.scene_spec.relations,
            drawn.documents.get("scene", {}),
        )  # fmt: skip
        file = self.out / file_of(index, "scene")
        loaded = load(file, self.recipe.scene.root, self._known, text=text)
        assets = {}
        for kind, document in self.asset_documents(index, drawn, {}).items():
            name = kind.removesuffix(ASSET)
            if name not in replaced:
                assets[name] = load(self.out / file_of(index, kind), self.recipe.scene.root, self._known, text=document)
        errors = [*loaded.errors, *(e for asset in assets.values() for e in asset.errors)]
        if errors:
            raise SpecError(errors)
        return self._with_assets(loaded, assets)

    def _with_assets(self, scene: Loaded, assets: Mapping[str, Loaded]) -> Loaded:
        """Return a scene whose objects have other assets, which are not on disk."""
        assert isinstance(scene.spec, SceneSpec)
        objects, uses = dict(scene.spec.objects), dict(scene.uses)
        for name, asset in assets.items():
            objects[name] = objects[name].model_copy(update={"asset": asset.path.name})
            uses[str(scene.file(asset.path.name))] = asset
        return replace(scene, spec=scene.spec.model_copy(update={"objects": objects}), uses=uses)

    def _lowered(self, scene: Loaded, drawn: DrawnValues) -> Scene:
        """Lower the scene, in the initial state of the task if the twin is a task."""
        task, spec = self.recipe.task, self.recipe.task_spec
        if task is None or spec is None:
            return lower(scene, _cache())
        moved = drawn.poses.keys()
        start = spec.start
        given = drawn.documents.get("task", {}).get("start", {}).get("joints", {})
        joints = {name: {**start.joints.get(name, {}), **of} for name, of in given.items()}
        kept = Start(
            place={name: place for name, place in start.place.items() if name not in moved},
            pose={name: pose for name, pose in start.pose.items() if name not in moved},
            joints={**start.joints, **joints},
        )
        task_spec = spec.model_copy(update={"start": kept})
        uses = {**task.uses, str(task.file(spec.scene)): scene}
        return task_of(replace(task, spec=task_spec, uses=uses), _cache()).scene


@dataclass(frozen=True, eq=False)
class ValueSampler(VariedScenes):
    """Draws the values of a recipe's cousins and derives the twins that have them.

    Attributes:
        twin: The twin of the recipe.
    """

    twin: Twin = field(kw_only=True)
    _replaced: dict[tuple[tuple[str, Path], ...], tuple[VariedValue, ...]] = field(default_factory=dict, repr=False)

    @classmethod
    def of(cls, recipe: Recipe, out: Path, twin: Twin) -> ValueSampler:
        """Create the sampler of a recipe."""
        carrying = {
            value.field.object
            for value in recipe.varied
            if isinstance(value.distribution, ShiftDistribution) and value.distribution.with_contents
        }
        contents = {name: _contents(twin, recipe.scene_spec, name) for name in sorted(carrying)}
        limits = _arm_limits(twin) if recipe.varied else {}
        context = TwinContext(recipe.scene_spec, twin.scene, recipe.loaded, out, MappingProxyType(contents), limits)
        return cls(recipe, out, context, twin=twin)

    def draw(self, index: int, replaced: Mapping[str, Path]) -> DrawnValues:
        """Draw the values of a cousin in which the files ``replaced`` are the assets of some objects."""
        return draw_values(self._values(replaced), self.source(index), self.context)

    def varied_twin(self, index: int, drawn: DrawnValues, replaced: Mapping[str, Path]) -> Twin | Rejected:
        """Return the twin with drawn values, at rest, or the reasons why it cannot be settled.

        Objects in ``replaced`` keep the twin's asset here. A twin whose values change only pictures is not settled
        again.
        """
        # Texts such as the type of a light can exclude each other; all other values were checked one by one.
        texts = any(v.field.kind is ValueKind.WORD and v.field.effect == "pictures" for v in self.recipe.varied)
        if drawn.same_scene and not drawn.views and not texts:
            return self.twin
        try:
            scene = self._scene(index, drawn, replaced)
            if drawn.same_scene and not drawn.views:
                return self.twin
            lowered = self._lowered(scene, drawn)
            if drawn.same_scene:
                return replace(self.twin, scene=replace(self.twin.scene, cameras=lowered.cameras))
            twin = Twin.of(lowered, self.twin.goal, self.twin.robots.names)
        except SpecError as error:
            return Rejected((_invalid(error.diagnostics[0]),))
        except TwinError as error:
            return Rejected((Reason("restless", str(error)),))
        if not any(place.path[0] == "robots" for v in self.recipe.varied for place in v.field.places):
            twin = replace(twin, robots=self.twin.robots)  # reading the models of robots takes time
        reasons = tuple(self._displaced(twin))
        return Rejected(reasons) if reasons else twin

    def lowered_object(self, index: int, name: str, file: Path, text: str) -> SceneObject:
        """Lower an object whose asset ``file`` has the drawn values in the document ``text``.

        Raises:
            SpecError: If the object is invalid.
        """
        asset = load(self.out / file_of(index, f"{name}{ASSET}"), self.recipe.scene.root, self._known, text=text)
        scene = described(file)
        assert isinstance(scene.spec, SceneSpec)
        return lower(self._with_assets(scene, dict.fromkeys(scene.spec.objects, asset)), _cache()).objects[0]

    def _values(self, replaced: Mapping[str, Path]) -> tuple[VariedValue, ...]:
        """Return the values that vary if some objects have other assets.

        Entries that do not fit a replacement, such as those of links that it lacks, do not apply to it.
        """
        recipe = self.recipe
        if not {value.field.object for value in recipe.varied} & replaced.keys():
            return recipe.varied
        key = tuple(sorted(replaced.items()))
        if key not in self._replaced:
            assets = {name: self._asset(file) for name, file in replaced.items()}
            finder = FieldFinder(recipe.scene, recipe.task, assets)
            self._replaced[key] = tuple(varied_values(recipe.spec, finder, recipe.loaded)[0])
        return self._replaced[key]

    def _asset(self, file: Path) -> Loaded:
        root = self.recipe.scene.root
        return load(file, root, self._known) if is_document(file.name) else Loaded(file, root, None, ())

    def _displaced(self, twin: Twin) -> list[Reason]:
        """Return a reason for each object that moves as the scene with drawn values settles, but not in the twin."""
        reasons = []
        for item in (item for item in twin.scene.objects if not item.fixed):
            far, tilt = _motion(twin, item.name)
            own_far, own_tilt = _motion(self.twin, item.name)
            if far > own_far + DRIFT:
                text = f"`{item.name}` moves {100 * far:.1f} cm as it settles with the drawn values"
                reasons.append(Reason("moved", text, {"moved_m": far}))
            elif tilt > own_tilt + TILT_DEG and not is_ball(item):
                text = f"`{item.name}` tilts by {tilt:.1f} deg as it settles with the drawn values"
                reasons.append(Reason("tilted", text, {"tilted_deg": tilt}))
        return reasons


def _contents(twin: Twin, spec: SceneSpec, name: str) -> tuple[str, ...]:
    """Return the objects that stand on an object, directly or not, and that are not placed relative to it.

    Objects that are welded to the world stand on it if the predicate says so.
    """
    fixed = [item.name for item in twin.scene.objects if item.fixed]
    found, todo = dict[str, None](), [name]
    while todo:
        below = todo.pop()
        above = [
            other for other in fixed if other != below and twin.judge(f"OnTop({other}, {below})", twin.state).value
        ]
        new = [other for other in (*twin.riders(below), *above) if other not in found and other != name]
        found |= dict.fromkeys(new)
        todo += new
    follow = dependents(spec, {name})  # these are placed again wherever it is
    return tuple(item.name for item in twin.scene.objects if item.name in found and item.name not in follow)


def _motion(twin: Twin, name: str) -> tuple[float, float]:
    """Return how far an object moves [m] and tilts [deg] from its document to its state at rest."""
    start, end = twin.scene.object(name).X_WO, twin.state.poses[name]
    return float(np.linalg.norm(end.p - start.p)), tilt_deg(start, end)


def _invalid(finding: Diagnostic) -> Reason:
    return Reason("invalid", f"the drawn values are invalid together: {finding.message} ({finding.path})")


def _cache() -> Cache:
    return Cache.default()


def _arm_limits(twin: Twin) -> dict[str, dict[str, tuple[float, float]]]:
    """Return the limits of arm joints by robot and joint, for the robots whose models are installed."""
    items = {item.name: item for item in twin.robots.items}
    found: dict[str, dict[str, tuple[float, float]]] = {}
    for robot in twin.scene.robots:
        native = mujoco_model(robot)
        joints = {joint.name: joint for joint in items[robot.name].joints} if robot.name in items else {}
        for name in robot.positions:
            joint = joints.get(native.joints.get(name, name) if native is not None else name)
            if joint is not None and joint.limits is not None:
                found.setdefault(robot.name, {})[name] = joint.limits
    return found
