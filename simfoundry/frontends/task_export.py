"""Export tasks to other formats: BDDL for LIBERO and BEHAVIOR, and the task YAML used in the SimFoundry paper.

A task is rejected if the format would change the meaning of its goal. A note is recorded for each initial condition
that the format cannot express.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import yaml

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import rpy_from_quat
from simfoundry.scene.model import Scene, SceneObject
from simfoundry.spec.models.predicate import Call, parse_call, parts
from simfoundry.spec.models.task import TaskSpec

FORMATS = ("libero", "behavior", "omnigibson")


class TaskExportError(SimfoundryError):
    """Raised if a format cannot express a task."""


@dataclass
class TaskExport:
    """The text of an exported file, with notes on omissions and assumptions."""

    text: str = ""
    notes: list[str] = field(default_factory=list)

    def args(self, call: Call) -> list[str]:
        """Return the objects of a predicate, adding a note if the predicate refers to a part of an object."""
        args = [object_of(arg) for arg in call.args]
        if args != list(call.args):
            self.notes.append(f"{call}: the exported predicate refers to the entire object, not to the part")
        return args


def export_task(spec: TaskSpec, scene: Scene, format_: str) -> TaskExport:
    """Export a task to one of :data:`FORMATS`.

    Raises:
        TaskExportError: If the format cannot express the task.
    """
    export = TaskExport()
    if spec.start.place or spec.start.pose:
        export.notes.append("initial poses: the format always uses the scene's poses")
    if format_ == "omnigibson":
        export.text = _omnigibson(spec, scene, export)
    else:
        export.text = _bddl(spec, scene, is_libero=format_ == "libero", export=export)
    return export


def atoms(condition: Any) -> list[tuple[Call, bool]]:
    """Return the predicates in a conjunction, along with their required truth values.

    Raises:
        TaskExportError: If the condition is not a conjunction of predicates and negated predicates.
    """
    tag, below = parts(condition)
    if tag == "text":
        return [(parse_call(below[0]), True)]
    if tag == "all":
        return [atom for item in below for atom in atoms(item)]
    if tag == "not" and parts(below[0])[0] == "text":
        return [(parse_call(below[0]), False)]
    raise TaskExportError(
        "the goal combines predicates with `any` or negates a compound condition, which only `behavior` supports"
    )


def object_of(name: str) -> str:
    """Return the name of the object in a path such as ``object.part``."""
    return name.partition(".")[0]


def support(scene: Scene, name: str) -> SceneObject:
    """Return the object that supports ``name`` in the scene's relations, or otherwise the first fixed object."""
    for relation in scene.relations:
        if relation.predicate == "OnTop" and relation.args[0] == name:
            return scene.object(object_of(relation.args[1]))
    fixed = next((item for item in scene.objects if item.fixed), None)
    if fixed is None:
        raise TaskExportError(f"could not find the support of `{name}`; add a relation `OnTop({name}, …)` to the scene")
    return fixed


# BDDL ----------------------------------------------------------------------------------------------------------------

_LIBERO = {"OnTop": "On", "Inside": "In", "Open": "Open", "Closed": "Close", "Lifted": "Up"}
_BEHAVIOR = {
    "OnTop": "ontop", "Inside": "inside", "Under": "under", "NextTo": "nextto", "Touching": "touching", "Open": "open",
    "Closed": "open",
}  # fmt: skip
_JOINED = {"all": "and", "any": "or", "not": "not"}
# Predicates that can be omitted: `On` and `In` in the other formats require contact but ignore the gripper.
_UNSAID = ("Released",)


def _bddl(spec: TaskSpec, scene: Scene, is_libero: bool, export: TaskExport) -> str:
    names = {o.name: o.name for o in scene.objects} if is_libero else _synsets(scene, export)
    regions: dict[str, list[str]] = {}
    goal = _libero_goal(spec, regions, export) if is_libero else _behavior_goal(spec.goal, names, export)
    if not goal:
        raise TaskExportError("this format cannot express any part of the goal")
    init = list(_libero_init(spec, scene, regions, export) if is_libero else _behavior_init(spec, scene, names, export))
    # LIBERO selects the environment class by problem name and the task by file name.
    name = "LIBERO_Tabletop_Manipulation" if is_libero else f"{spec.name or 'task'}-0"
    sections = [f"(define (problem {name})", f"  (:domain {'robosuite' if is_libero else 'omnigibson'})"]
    if is_libero:
        kinds: dict[bool, list[str]] = {True: [], False: []}
        for item in scene.objects:
            kinds[bool(item.fixed or item.joints)].append(f"{item.name} - {_kind(item)}")
        interest = list(dict.fromkeys(object_of(arg) for call, _ in atoms(spec.goal) for arg in call.args))
        sections += [
            f"  (:language {spec.instruction.replace('(', ' ').replace(')', ' ')})",
            _block(":regions", [line for lines in regions.values() for line in lines]),
            _block(":fixtures", kinds[True]),
            _block(":objects", kinds[False]),
            _block(":obj_of_interest", interest),
        ]
    else:
        listed = [f"{name} - {name.rpartition('_')[0]}" for name in names.values()]
        sections.append(_block(":objects", [*listed, "agent.n.01_1 - agent.n.01"]))
    return "\n".join([*sections, _block(":init", init), f"  (:goal\n    {goal}\n  )", ")", ""])


def _block(name: str, lines: list[str]) -> str:
    return "\n".join([f"  ({name}", *(f"    {line}" for line in lines), "  )"])


def _kind(item: SceneObject) -> str:
    return item.category or item.name


def _synsets(scene: Scene, export: TaskExport) -> dict[str, str]:
    """Return BEHAVIOR's name for each scene object, which consists of a WordNet synset and a number."""
    counts: Counter[str] = Counter()
    names = {}
    for item in scene.objects:
        counts[_kind(item)] += 1
        names[item.name] = f"{_kind(item)}.n.01_{counts[_kind(item)]}"
    export.notes.append("synsets: derived from object categories, as in `cup.n.01`")
    return names


def _libero_goal(spec: TaskSpec, regions: dict[str, list[str]], export: TaskExport) -> str:
    texts = []
    for call, wanted in atoms(spec.goal):
        if call.predicate in _UNSAID:
            export.notes.append(f"{call}: the format ignores the gripper")
        elif call.predicate not in _LIBERO or not wanted:
            raise TaskExportError(f"LIBERO has no predicate for `{'' if wanted else 'not '}{call}`")
        else:
            texts.append(f"({_LIBERO[call.predicate]} {' '.join(_region(arg, regions) for arg in call.args)})")
    return f"(And {' '.join(texts)})" if texts else ""


def _region(name: str, regions: dict[str, list[str]]) -> str:
    """Return the name of an object, or of a region that represents a part of an object."""
    item, dot, part = name.partition(".")
    if not dot:
        return item
    regions[name] = [f"({part}_region (:target {item}))"]
    return f"{item}_{part}_region"


def _behavior_goal(condition: Any, names: dict[str, str], export: TaskExport) -> str | None:
    tag, below = parts(condition)
    if tag == "text":
        call = parse_call(below[0])
        if call.predicate in _UNSAID:
            export.notes.append(f"{call}: the format ignores the gripper")
            return None
        if call.predicate not in _BEHAVIOR or any(object_of(arg) not in names for arg in call.args):
            raise TaskExportError(f"BEHAVIOR has no predicate for `{call}`")
        atom = f"({_BEHAVIOR[call.predicate]} {' '.join('?' + names[arg] for arg in export.args(call))})"
        return f"(not {atom})" if call.predicate == "Closed" else atom
    texts = [text for text in (_behavior_goal(item, names, export) for item in below) if text]
    return f"({_JOINED[tag]} {' '.join(texts)})" if texts else None


def _behavior_init(spec: TaskSpec, scene: Scene, names: dict[str, str], export: TaskExport) -> Iterator[str]:
    for relation in scene.relations:
        if relation.predicate in ("OnTop", "Inside") and all(arg in names for arg in relation.args):
            yield f"({_BEHAVIOR[relation.predicate]} {' '.join(names[arg] for arg in relation.args)})"
    if spec.reset.objects:
        export.notes.append("reset ranges: the format does not support them")


def _libero_init(spec: TaskSpec, scene: Scene, regions: dict[str, list[str]], export: TaskExport) -> Iterator[str]:
    for name, region in spec.reset.objects.items():
        below = support(scene, name)
        X_SW = below.X_WO.inverse()
        points = [X_SW.apply([x, y, 0.0]) for x in region.x for y in region.y]  # type: ignore[arg-type]
        (x0, x1), (y0, y1) = ((min(p[k] for p in points), max(p[k] for p in points)) for k in (0, 1))
        now = rpy_from_quat(scene.object(name).X_WO.q)[2]
        low, high = (now + math.radians(yaw) for yaw in region.yaw_deg)
        regions[f"{name} init"] = [
            f"({name}_init_region (:target {below.name})",
            f"  (:ranges (({x0:.6g} {y0:.6g} {x1:.6g} {y1:.6g}))) (:yaw_rotation (({low:.6g} {high:.6g}))))",
        ]
        yield f"(On {name} {below.name}_{name}_init_region)"
    for joint in (f"{item}.{name}" for item, names in spec.start.joints.items() for name in names):
        export.notes.append(f"initial position of {joint}: the format supports only `open`, not a position")
        yield f"(Open {_region(joint, regions)})"


# The authors' task YAML ----------------------------------------------------------------------------------------------

_STATES = {
    "OnTop": "OnTop", "Inside": "Inside", "Under": "Under", "NextTo": "NextTo", "Touching": "Touching", "Open": "Open",
    "Closed": "Open", "Lifted": "Lifted", "Grasped": "IsGrasping", "Released": "Touching",
}  # fmt: skip


def _omnigibson(spec: TaskSpec, scene: Scene, export: TaskExport) -> str:
    goal = [_predicate(call, wanted, scene, export) for call, wanted in atoms(spec.goal)]
    milestones: list[dict[str, Any]] = []
    for name, subtask in spec.subtasks.items():
        try:
            found = [_predicate(call, wanted, scene, export) for call, wanted in atoms(subtask.goal)]
        except TaskExportError as error:
            export.notes.append(f"subtask `{name}`: {error}")
            continue
        requires = [m["name"] for m in milestones][-1:]
        milestones += [
            {"name": name if len(found) == 1 else f"{name}_{k + 1}", **one, "requires": requires}
            for k, one in enumerate(found)
        ]
    used = {n for one in (*goal, *milestones) for n in (one["group"], one["other_group"]) if n and n != "robot"}
    used |= set(spec.reset.objects)
    config: dict[str, Any] = {
        "type": "PickPlaceTask",
        "activity_name": spec.name or "task",
        "semantic_group_mapping": {"robot": ["agent"]} | {name: [name] for name in sorted(used)},
        "goal_predicates_all": goal,
        "goal_predicates_any": None,
        "milestone_predicates": milestones or None,
        **_ranges(spec, scene, export),
        "termination_config": {"max_steps": spec.horizon},
    }
    if spec.start.joints:
        config["group_init_joint_positions"] = {k: dict(v) for k, v in spec.start.joints.items()}
    names = {"task_name": spec.name or "task", "language_instruction": spec.instruction}
    return str(yaml.safe_dump(names | {"og_task_config": config}, sort_keys=False, allow_unicode=True))


def _predicate(call: Call, wanted: bool, scene: Scene, export: TaskExport) -> dict[str, Any]:
    if call.predicate not in _STATES:
        raise TaskExportError(f"the authors' release has no state that corresponds to `{call}`")
    args = export.args(call)
    objects = {item.name for item in scene.objects}
    group, other = (*(arg if arg in objects else "robot" for arg in args), None)[:2]
    if call.predicate in ("Grasped", "Released"):
        group, other = "robot", args[0]
    if call.predicate in ("Closed", "Released"):
        wanted = not wanted
    state = {"state": _STATES[call.predicate], "state_kwargs": None, "value": wanted}
    return state | {"group": group, "other_group": other}


def _ranges(spec: TaskSpec, scene: Scene, export: TaskExport) -> dict[str, Any]:
    """Return reset ranges as half widths around the poses in the scene.

    The task format of the SimFoundry paper does not support any other ranges.
    """
    widths: dict[str, list[float]] = {}
    turns: dict[str, float] = {}
    for name, region in spec.reset.objects.items():
        p = scene.object(name).X_WO.p
        half = [max(abs(end - float(p[k])) for end in ends) for k, ends in enumerate((region.x, region.y))]
        if any(abs(abs(ends[0] - p[k]) - abs(ends[1] - p[k])) > 1e-6 for k, ends in enumerate((region.x, region.y))):
            export.notes.append(f"region of `{name}`: it is not centered on the pose in the scene, so it is widened")
        widths[name] = [round(h, 6) for h in half] + [0.0]
        turn = math.radians(max(abs(y) for y in region.yaw_deg))
        if turn:
            turns[name] = round(turn, 6)
    found = {"group_xyz_randomization": widths, "group_z_rot_randomization": turns}
    return {key: value for key, value in found.items() if value}
