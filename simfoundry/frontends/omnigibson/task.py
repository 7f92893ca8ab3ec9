"""Read task files from the release that accompanies the SimFoundry paper.

A task file is a YAML with goals, milestones, initial states, and reset ranges. It is read as a task for an imported
scene.
"""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

from simfoundry.frontends.document_data import relative_path, rounded
from simfoundry.frontends.draft import ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.names import NameTable, plain_name
from simfoundry.scene.model import Scene
from simfoundry.spec.models.predicate import texts
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import read as read_yaml

BINARY = {
    "OnTop": "OnTop", "OnTopAABB": "OnTop", "Inside": "Inside", "InsideAABB": "Inside", "Under": "Under",
    "NextTo": "NextTo", "Touching": "Touching", "AboveAABB": "Above",
}  # fmt: skip
UNARY = {"Lifted": "Lifted", "IsGrasping": "Grasped"}
AGENTS = ("agent", "robot", "robot0")

# Control frequency [Hz] of the release's evaluation, which its task files do not specify.
CONTROL_HZ = 15.0

# Default number of steps of a task in the release.
HORIZON = 1000


def read_task(
    path: Path, spec: SceneSpec, scene: Scene, out: Path, options: ImportOptions
) -> tuple[TaskSpec, ModelDraft]:
    """Read a YAML file from the release that accompanies the SimFoundry paper as a task for a scene.

    Raises:
        ImportRefusedError: If the file is invalid.
    """
    try:
        data = read_yaml(path).data
    except YamlError as error:
        raise ImportRefusedError(path, str(error)) from None
    if not isinstance(data, dict) or not isinstance(data.get("og_task_config"), dict):
        raise ImportRefusedError(path, "the file has no `og_task_config`, so it is not a task from the release")
    assert options.scene is not None
    reader = _TaskReader(path, data, spec, scene)
    return reader.spec(relative_path(options.scene, out)), reader.draft


class _TaskReader:
    """A reader for a single task file."""

    def __init__(self, path: Path, data: dict[str, Any], spec: SceneSpec, scene: Scene) -> None:
        self.path, self.data, self.scene_spec, self.scene = path, data, spec, scene
        self.config: dict[str, Any] = data["og_task_config"]
        self.draft = ModelDraft(str(data.get("task_name") or path.stem), "OmniGibson task")
        self.groups = {str(k): list(v or ()) for k, v in (self.config.get("semantic_group_mapping") or {}).items()}

    def refused(self, message: str, hint: str = "") -> ImportRefusedError:
        return ImportRefusedError(self.path, message, hint=hint)

    def spec(self, scene_file: str) -> TaskSpec:
        goal, instruction = self.goal(), self.data.get("language_instruction")
        if not instruction:
            instruction = self.draft.name.replace("_", " ").capitalize() + "."
            self.draft.assumed("instruction", "the file specifies no instruction; it is derived from the task name")
        steps = (self.config.get("termination_config") or {}).get("max_steps") or HORIZON
        data: dict[str, Any] = {
            "simfoundry": "task/1", "name": plain_name(self.draft.name, "task"), "scene": scene_file,
            "instruction": str(instruction), "goal": goal, "control_hz": CONTROL_HZ, "horizon": int(steps),
        }  # fmt: skip
        reset = self.reset()
        optional = {"subtasks": self.subtasks(), "start": self.start(), "reset": {"objects": reset} if reset else {}}
        data |= {key: value for key, value in optional.items() if value}
        unsupported: dict[str, str] = read_yaml(Path(__file__).with_name("unsupported.yaml")).data
        for key, why in unsupported.items():
            if self.config.get(key):
                self.draft.dropped(f"`{key}`", why)
        on_top = [text for text, _ in texts(goal) if text.startswith("OnTop(")]
        for text in on_top if " in " in f" {str(instruction).lower()} " else ():
            why = "the instruction says `in`, but the goal requires `OnTop`; the goal is kept unchanged"
            self.draft.assumed(f"`{text}`", why)
        return TaskSpec.model_validate(rounded(data))

    def members(self, group: Any) -> list[str]:
        """Return the scene names of the objects in a group, in which `agent` stands for the robot."""
        out: dict[str, None] = {}
        for word in map(str, self.groups.get(str(group), [group])):
            found = ["agent"] if word in AGENTS else self.objects_called(word)
            if not found:
                raise self.refused(f"the scene has no object `{word}`", "refer to an object by its name or category")
            out |= dict.fromkeys(found)
        return list(out)

    def objects_called(self, word: str) -> list[str]:
        """Return the objects with the given category or name.

        The original name in the imported file is also accepted.
        """

        def matches(name: str, item: Any) -> bool:
            note = item.origin.note if item.origin is not None else None
            return plain_name(word) in (name, item.category or "") or note == f"`{word}` of the release"

        return [name for name, item in self.scene_spec.objects.items() if matches(name, item)]

    def predicates(self, key: str) -> list[dict[str, Any]]:
        listed = self.config.get(key) or []
        if not isinstance(listed, list | tuple) or not all(isinstance(p, dict) for p in listed):
            raise self.refused(f"`{key}` is not a list of predicates")
        return [dict(p) for p in listed]

    def goal(self) -> Any:
        """Return the conjunction of all goal predicates.

        The suffixes `all` and `any` in the keys of the predicates refer to the objects in each group.
        """
        if self.predicates("goal_predicates_specific"):
            message = "`goal_predicates_specific` refers to objects by number, which is not supported"
            raise self.refused(message, "use `goal_predicates_all` instead")
        every = [self.condition(p, "all") for p in self.predicates("goal_predicates_all")]
        some = [self.condition(p, "any") for p in self.predicates("goal_predicates_any")]
        if some:
            why = "each predicate applies to any object in its group, and all predicates must be true"
            self.draft.changed("`goal_predicates_any`", why)
        if not every + some:
            raise self.refused("the goal is empty, so every rollout would succeed immediately", "add goal predicates")
        return (every + some)[0] if len(every + some) == 1 else {"all": tuple(every + some)}

    def condition(self, predicate: dict[str, Any], quantifier: str) -> Any:
        each = [self.atom(predicate, name) for name in self.members(predicate.get("group"))]
        if not each:
            raise self.refused(f"the group `{predicate.get('group')}` is empty, so its predicate would always be true")
        return each[0] if len(each) == 1 else {quantifier: tuple(each)}

    def atom(self, predicate: dict[str, Any], name: str) -> Any:
        """Convert a predicate for a single object."""
        state, is_wanted = str(predicate.get("state")), predicate.get("value", True) is not False
        others = self.members(predicate["other_group"]) if predicate.get("other_group") else []
        if predicate.get("state_kwargs"):
            why = "predicates use SimFoundry's thresholds instead"
            self.draft.changed(f"parameters of {state}", why, str(predicate["state_kwargs"])[:80])
        if len(others) > 1:
            group = predicate.get("other_group")
            raise self.refused(f"`{group}` must match exactly one object, but it matches {len(others)}")
        if state == "Touching" and "agent" in (name, *others):
            return self.touched_by_robot(name if name != "agent" else (others or [""])[0], is_wanted)
        if state == "IsGrasping" and name == "agent" and others:
            name = others[0]
        if state in UNARY and (name != "agent" or state == "IsGrasping"):
            text = f"{UNARY[state]}({name})"
        elif state in BINARY and others and name != "agent":
            text = f"{BINARY[state]}({name}, {others[0]})"
        elif state == "Open" and name != "agent":
            return f"{'Open' if is_wanted else 'Closed'}({name})"
        else:
            raise self.refused(f"the state `{state}` of `{predicate.get('group')}` has no corresponding predicate")
        return text if is_wanted else {"not": text}

    def touched_by_robot(self, item: str, is_wanted: bool) -> str:
        if not is_wanted and item not in ("", "agent"):
            return f"Released({item})"
        robots = list(self.scene_spec.robots)
        if len(robots) != 1:
            raise self.refused("a condition refers to the robot", f"the scene must have one robot, not {len(robots)}")
        return f"Touching({robots[0]}, {item})"

    def subtasks(self) -> dict[str, Any]:
        """Return the milestones as subtasks, ordered so that each milestone follows the milestones that it requires."""
        listed, names = self.predicates("milestone_predicates"), NameTable("step")
        out: dict[str, Any] = {}
        done: set[str] = set()
        while listed:
            ready = next((m for m in listed if set(m.get("requires") or ()) <= done), None)
            if ready is None:
                raise self.refused("the milestones require each other in a cycle")
            listed.remove(ready)
            done.add(str(ready.get("name")))
            out[names.name(str(ready.get("name")))] = {"goal": self.condition(ready, "all")}
        return out

    def start(self) -> dict[str, Any]:
        place: dict[str, Any] = {}
        keys = ("init_predicates_all", "init_predicates_any", "init_predicates_specific")
        for key, predicate in ((k, p) for k in keys for p in self.predicates(k)):
            if predicate.get("state") != "PlaceOnTop" or predicate.get("value") is False:
                self.draft.dropped(f"`{key}`: {predicate.get('state')}", "only `PlaceOnTop` is supported")
                continue
            below, members = self.members(predicate.get("other_group")), self.members(predicate.get("group"))
            if len(members) > 1:
                what = f"`{key}` of `{predicate.get('group')}`"
                self.draft.changed(what, "only the last object is placed, as in the release")
            place[members[-1]] = {"on": below[0]}
        joints: dict[str, Any] = {}
        for group, positions in (self.config.get("group_init_joint_positions") or {}).items():
            for name in self.members(group):
                joints[name] = {plain_name(str(k), "joint"): float(v) for k, v in positions.items()}
        return {key: value for key, value in (("place", place), ("joints", joints)) if value}

    def reset(self) -> dict[str, Any]:
        """Return the reset ranges, centered at the poses in the scene."""
        widths, turns = (self.config.get(f"group_{k}_randomization") or {} for k in ("xyz", "z_rot"))
        out: dict[str, Any] = {}
        for group in dict.fromkeys([*widths, *turns]):
            half = [abs(float(v)) for v in widths.get(group) or (0, 0, 0)]
            turn = math.degrees(abs(float(turns.get(group) or 0.0)))
            if half[2]:
                self.draft.dropped(f"height range of `{group}`", "objects start at their height in the scene")
            for name in self.members(group):
                p = self.scene.object(name).X_WO.p.tolist()
                region: dict[str, Any] = {k: (p[i] - half[i], p[i] + half[i]) for i, k in enumerate("xy")}
                out[name] = region | ({"yaw_deg": (-turn, turn)} if turn else {})
        return out
