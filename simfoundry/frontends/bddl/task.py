"""Convert a BDDL problem to a task. Names are bound to scene objects, and regions become conditions."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from simfoundry.frontends.bddl.problem import BddlGroup, BddlProblem, BddlRegion, ConditionReader, read_problem
from simfoundry.frontends.document_data import relative_path, rounded
from simfoundry.frontends.draft import ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import rpy_from_quat
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec

BINARY = {
    "on": "OnTop", "ontop": "OnTop", "in": "Inside", "inside": "Inside", "under": "Under", "nextto": "NextTo",
    "touching": "Touching",
}  # fmt: skip
UNARY = {"up": "Lifted", "grasped": "Grasped"}
OPEN, CLOSE = ("open",), ("close", "closed")
_SYNSET = re.compile(r"(.+)\.[nvar]\.\d+(_\d+)?\Z")


def read_bddl_task(
    path: Path, _spec: SceneSpec, scene: Scene, out: Path, options: ImportOptions
) -> tuple[TaskSpec, ModelDraft]:
    """Read a BDDL file as a task for a scene.

    Args:
        path: BDDL file.
        scene: Lowered scene of the task.
        out: File to which the task will be written.
        options: Import options; ``scene`` is the scene document, and ``bound`` assigns objects to unresolved names.

    Raises:
        ImportRefusedError: If the file is invalid or if some elements cannot be resolved. The message lists each
            unresolved element with its line number.
    """
    problem = read_problem(path)
    draft = ModelDraft(problem.name, "BDDL")
    task = _TaskReader(problem, scene, options.bound, draft)
    goal = task.goal()
    start, reset = task.start()
    if task.missing:
        count = "one item is missing" if len(task.missing) == 1 else f"{len(task.missing)} items are missing"
        hint = "add the missing items to the scene, or assign objects to names with `--bind NAME=OBJECT`"
        raise ImportRefusedError(path, f"{count}: {'; '.join(task.missing)}", hint=hint)
    unnumbered = re.sub(r"-\d+\Z", "", problem.name)
    instruction = problem.language or f"{unnumbered.replace('_', ' ').capitalize()}."
    if not problem.language:
        draft.assumed("instruction", "the file specifies no instruction; it is derived from the problem name")
    assert options.scene is not None
    name = plain_name(path.stem if problem.domain == "robosuite" else unnumbered, "task")
    data: dict[str, Any] = {
        "simfoundry": "task/1", "name": name, "scene": relative_path(options.scene, out),
        "instruction": instruction[:500],
        "goal": goal, **({"start": start} if start else {}), **({"reset": {"objects": reset}} if reset else {}),
    }  # fmt: skip
    return TaskSpec.model_validate(rounded(data)), draft


@dataclass
class _TaskReader:
    """A converter from a BDDL problem to a task."""

    problem: BddlProblem
    scene: Scene
    bound: Mapping[str, str]
    draft: ModelDraft
    unbound: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        kinds: dict[str, list[str]] = {}
        for name, kind in self.problem.kinds.items():
            kinds.setdefault(kind.lower(), []).append(name)
        self.conditions = ConditionReader(self._atom, kinds)
        self.missing = self.conditions.missing

    def goal(self) -> Any:
        """Return the goal condition, or None if it could not be resolved.

        The reasons are then listed in ``missing``.
        """
        found = self.conditions.condition(self.problem.goal, {})
        if found is None and not self.missing:
            self.missing.add(self.problem.goal, "the goal is empty, so every rollout would succeed immediately")
        return found

    def _atom(self, group: BddlGroup, name: str, words: list[str]) -> Any:
        """Convert a goal predicate, or return None if one of its parts cannot be resolved."""
        if name in BINARY and len(words) == 2:
            return self._binary(group, BINARY[name], *words)
        if name in (*OPEN, *CLOSE) and len(words) == 1:
            predicate, key = ("Closed", "all") if name in CLOSE else ("Open", "any")
            each = tuple(f"{predicate}({joint})" for joint in self._joints(group, words[0]))
            return {key: each} if len(each) > 1 else next(iter(each), None)
        if name in UNARY and len(words) == 1:
            item_name = self._object(group, words[0])
            return None if item_name is None else f"{UNARY[name]}({item_name})"
        self.missing.add(group, f"the predicate `{name}` is not supported")
        return None

    def _binary(self, group: BddlGroup, predicate: str, first: str, second: str) -> Any:
        item_name = self._object(group, first)
        region = self.problem.regions.get(second)
        if region is not None and region.ranges is not None:
            return None if item_name is None else self._in_rectangle(group, item_name, region)
        target = self._part(group, second, predicate)
        if item_name is None or target is None:
            return None
        text = f"{predicate}({item_name}, {target})"
        if group.head == "on" and self._put_in(target):
            why = "the instruction says `in`, and LIBERO's `On` includes `Inside`, so both are accepted"
            self.draft.changed(f"`{text}`", why)
            return {"any": (text, f"Inside({item_name}, {target})")}
        return text

    def _put_in(self, target: str) -> bool:
        """Return True if the instruction says to put an object into ``target``."""
        noun = re.escape((self.scene.object(target.partition(".")[0]).category or target).rpartition("_")[2])
        between = r"(?:(?!\b(?:on|onto|and)\b|,).)*"
        return re.search(rf"\bin(?:to|side)?\b{between}\b{noun}\b", self.problem.language.lower()) is not None

    def _in_rectangle(self, group: BddlGroup, item_name: str, region: BddlRegion) -> Any:
        """Convert a goal region on a table to an `At` condition for the region's center."""
        if (box := self._rectangle(group, region)) is None:
            return None
        size = f"{100 * (box[2] - box[0]):.0f} x {100 * (box[3] - box[1]):.0f} cm"
        why = "the goal region became an `At` condition for its center, with the usual tolerance of `At`"
        self.draft.changed(f"region `{region.name}`", why, size)
        return f"At({item_name}, {(box[0] + box[2]) / 2:.6g}, {(box[1] + box[3]) / 2:.6g})"

    def _object(self, group: BddlGroup, name: str) -> str | None:
        """Return the scene object for a name, or None if there is no such object."""
        found = bind(name, self.problem, self.scene, self.bound)
        if found is None and name not in self.unbound:
            self.unbound.add(name)
            kind = self.problem.kinds.get(name)
            what = f" (a {_type(kind)})" if kind and kind != name else ""
            self.missing.add(group, f"the scene has no object `{name}`{what}")
        return found

    def _part(self, group: BddlGroup, name: str, predicate: str) -> str | None:
        """Return the scene object or link that corresponds to an object or region name."""
        region = self.problem.regions.get(name)
        owner = self._object(group, region.target if region is not None else name)
        if region is None or owner is None:
            return owner
        links = [link.name for link in self.scene.object(owner).links[1:]]
        found = _alike(region, {link: link for link in links})
        if predicate == "Inside" and len(found) == 1:
            return f"{owner}.{found[0]}"
        if predicate == "Inside" and links:
            self._unclear(group, region, owner, links, found)
            return None
        self.draft.changed(f"region `{name}`", f"the name is interpreted as the entire object `{owner}`")
        return owner

    def _joints(self, group: BddlGroup, name: str) -> list[str]:
        """Return the joints (as ``object.joint``) that correspond to an object or region name."""
        region = self.problem.regions.get(name)
        owner = self._object(group, region.target if region is not None else name)
        if owner is None:
            return []
        joints = {j.name: f"{j.name} {j.child}" for j in self.scene.object(owner).joints if j.has_axis}
        found = list(joints) if region is None or len(joints) < 2 else _alike(region, joints)
        if not joints:
            self.missing.add(group, f"`{owner}` has no joint that can be opened")
        elif region is not None and len(found) != 1:
            self._unclear(group, region, owner, list(joints), found)
            return []
        return [f"{owner}.{joint}" for joint in found]

    def _unclear(self, group: BddlGroup, region: BddlRegion, owner: str, there: list[str], found: list[str]) -> None:
        which = f"both {' and '.join(found)} match" if found else f"none of {', '.join(there)} matches"
        self.missing.add(group, f"{which} the region `{region.name}` of `{owner}`")

    def _rectangle(self, group: BddlGroup, region: BddlRegion) -> tuple[float, float, float, float] | None:
        """Return the axis-aligned bounding rectangle (min x, min y, max x, max y) [m] of a region in the world."""
        owner = self._object(group, region.target)
        if owner is None or region.ranges is None:
            return None
        X_WO = self.scene.object(owner).X_WO
        low_x, low_y, high_x, high_y = region.ranges
        corners = [X_WO.apply([x, y, 0.0]) for x in (low_x, high_x) for y in (low_y, high_y)]  # type: ignore[arg-type]
        xs, ys = ([float(corner[k]) for corner in corners] for k in (0, 1))
        return min(xs), min(ys), max(xs), max(ys)

    def start(self) -> tuple[dict[str, Any], dict[str, Any]]:
        """Return the initial conditions that differ from the scene, and the reset regions."""
        joints: dict[str, dict[str, float]] = {}
        regions: dict[str, Any] = {}
        for group in self.problem.init:
            words = [word.text for word in group.words]
            region = self.problem.regions.get(words[-1]) if words else None
            if group.head in OPEN and len(words) == 1:
                for owner, _, joint in (name.partition(".") for name in self._joints(group, words[0])):
                    joints.setdefault(owner, {})[joint] = _opened(self.scene.object(owner), joint)
            elif group.head in ("on", "ontop") and len(words) == 2 and region is not None and region.ranges:
                self._region(group, words[0], region, regions)
            else:
                self.draft.dropped(f"initial `{group.head}`", "the scene determines the initial state")
        return ({"joints": joints} if joints else {}), regions

    def _region(self, group: BddlGroup, name: str, region: BddlRegion, regions: dict[str, Any]) -> None:
        item_name, box = self._object(group, name), self._rectangle(group, region)
        if item_name is None or box is None:
            return
        item = self.scene.object(item_name)
        if item.fixed:
            self.draft.dropped(f"initial region of `{name}`", "the object is fixed in the scene")
            return
        found: dict[str, Any] = {"x": (box[0], box[2]), "y": (box[1], box[3])}
        if region.yaw is not None:
            now = math.degrees(rpy_from_quat(item.X_WO.q)[2])
            low, high = (math.degrees(yaw) - now for yaw in region.yaw)
            turns = 360 * round(low / 360)
            if abs(low - turns) > 1e-6 or abs(high - turns) > 1e-6:
                found["yaw_deg"] = (low - turns, high - turns)
        regions[item_name] = found


def bind(name: str, problem: BddlProblem, scene: Scene, bound: Mapping[str, str]) -> str | None:
    """Return the scene object for a name in a problem, or None if there is no match.

    Names in ``bound`` take precedence. They are followed by objects with the same name, and then by objects whose type
    and number match.
    """
    if name in bound:
        return bound[name]
    there = {item.name: item for item in scene.objects}
    kind = problem.kinds.get(name, "")
    short = plain_name(_type(kind))
    alike = [other for other, its in problem.kinds.items() if its == kind]
    number = alike.index(name) if name in alike else 0
    for candidate in (plain_name(name), f"{short}_{number + 1}", short if len(alike) == 1 else ""):
        if candidate in there:
            return candidate
    of_kind = [item.name for item in scene.objects if kind and plain_name(item.category) == short]
    return of_kind[number] if number < len(of_kind) else None


def _type(kind: str) -> str:
    """Return the base word of a type, such as `mug` for the synset `mug.n.04`."""
    return _SYNSET.sub(r"\1", kind)


def _opened(item: SceneObject, name: str) -> float:
    """Return the position [rad or m] of an open joint.

    The open position is the limit that is farther from zero, or a quarter turn if the joint has no limits.
    """
    joint = next(j for j in item.joints if j.name == name)
    return max(joint.limits, key=abs) if joint.limits is not None else math.pi / 2


def _alike(region: BddlRegion, parts: Mapping[str, str]) -> list[str]:
    """Return the part that has the same name as a region, or otherwise all parts whose names share a word with it."""
    exact = region.name.removesuffix("_region")
    if exact in parts:
        return [exact]
    words = _words(region.name)
    return [name for name, called in parts.items() if words & _words(called)]


def _words(name: str) -> set[str]:
    """Return the words in a name that help distinguish between parts."""
    return set(plain_name(name).split("_")) - {"region", "side", "joint", "link", "contain", "init", "drawer"}
