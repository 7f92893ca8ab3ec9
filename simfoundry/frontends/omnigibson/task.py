"""The authors' task YAML in: goals, milestones, starts and ranges, as a task on a scene that was imported before."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from simfoundry.frontends.document_data import relative_path, rounded
from simfoundry.frontends.draft import ImportOptions, ModelDraft
from simfoundry.frontends.errors import ImportRefusedError
from simfoundry.frontends.names import NameTable, plain_name
from simfoundry.scene.model import Scene
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.yaml.text import YamlError
from simfoundry.spec.yaml.text import read as read_yaml

BINARY = {
    "OnTop": "OnTop", "OnTopAABB": "OnTop", "Inside": "Inside", "InsideAABB": "Inside", "Under": "Under",
    "NextTo": "NextTo", "Touching": "Touching", "AboveAABB": "Above",
}  # fmt: skip
UNARY = {"Open": "Open", "Lifted": "Lifted", "IsGrasping": "Grasped"}
AGENTS = ("agent", "robot", "robot0")
CONTROL_HZ = 15.0

_DROPPED = {
    "robot_pose": "robots stand in the scene", "robot_xyz_randomization": "robots stand still",
    "robot_z_rot_randomization": "robots stand still", "robot_joint_randomization": "robots start at home",
    "ground_plane_z_offset": "the table stands in the scene", "ground_plane_z_randomization": "the table stands still",
    "camera_look_at_point": "cameras stand in the scene", "camera_randomization": "cameras stand still",
    "group_init_relative_poses": "objects stand in the scene",
    "group_predicate_placement": "starts are ranges of poses",
    "workspace_bounds": "starts are ranges of poses", "additional_objects": "distractors are made by cousins",
    "reward_config": "success is what counts", "hdr_background_name": "backgrounds stand in the scene",
}  # fmt: skip


def read_task(
    path: Path, spec: SceneSpec, scene: Scene, out: Path, options: ImportOptions
) -> tuple[TaskSpec, ModelDraft]:
    """Read the task of a YAML file of the release for a scene; raises :class:`ImportRefusedError`."""
    try:
        document = read_yaml(path)
    except YamlError as error:
        raise ImportRefusedError(path, str(error)) from None
    data = document.data
    config = data.get("og_task_config") if isinstance(data, dict) else None
    if not isinstance(config, dict):
        raise ImportRefusedError(path, "it has no `og_task_config`: it is no task of the release")
    assert options.scene is not None
    return _TaskReader(path, data, config, spec, scene).spec(relative_path(options.scene, out))


class _TaskReader:
    """One task file while it is read."""

    def __init__(
        self, path: Path, data: dict[str, Any], config: dict[str, Any], scene: SceneSpec, lowered: Scene
    ) -> None:
        self.path, self.data, self.config, self.scene, self.lowered = path, data, config, scene, lowered
        self.draft = ModelDraft(str(data.get("task_name") or path.stem), "OmniGibson task")
        self.groups = {str(k): list(v or ()) for k, v in (config.get("semantic_group_mapping") or {}).items()}

    def refused(self, message: str, hint: str = "") -> ImportRefusedError:
        return ImportRefusedError(self.path, message, hint=hint)

    def spec(self, scene_file: str) -> tuple[TaskSpec, ModelDraft]:
        goal = self.goal()
        instruction = self.data.get("language_instruction")
        if not instruction:
            instruction = self.draft.name.replace("_", " ").capitalize() + "."
            self.draft.assumed("instruction", "none is given; the name of the task stands for it")
        steps = (self.config.get("termination_config") or {}).get("max_steps") or 1000
        data: dict[str, Any] = {
            "simfoundry": "task/1", "name": plain_name(self.draft.name, "task"), "scene": Path(scene_file).as_posix(),
            "instruction": str(instruction), "goal": goal, "control_hz": CONTROL_HZ, "horizon": int(steps),
        }  # fmt: skip
        subtasks, start, reset = self.subtasks(), self.start(), self.reset()
        beside = {"subtasks": subtasks, "start": start, "reset": {"objects": reset} if reset else {}}
        data |= {key: value for key, value in beside.items() if value}
        for key, why in _DROPPED.items():
            if self.config.get(key):
                self.draft.dropped(f"`{key}`", why)
        self.wording(str(instruction), goal)
        return TaskSpec.model_validate(rounded(data)), self.draft

    def members(self, group: Any) -> list[str]:
        """The objects of a group, by the names that the scene gives them; agents stay what they are."""
        words = self.groups.get(str(group), [group])
        out: list[str] = []
        for word in map(str, words):
            if word in AGENTS:
                out.append("agent")
                continue
            found = [n for n, o in self.scene.objects.items() if self.means(word, n, o)]
            if not found:
                raise self.refused(f"no object of the scene is `{word}`", "name one by its name or category")
            out += [n for n in found if n not in out]
        return out

    def means(self, word: str, name: str, item: Any) -> bool:
        note = item.origin.note if item.origin is not None else None
        return plain_name(word) in (name, item.category or "") or note == f"`{word}` of the release"

    def predicates(self, key: str) -> list[dict[str, Any]]:
        listed = self.config.get(key) or []
        if not isinstance(listed, list | tuple) or not all(isinstance(p, dict) for p in listed):
            raise self.refused(f"`{key}` is not a list of predicates")
        return [dict(p) for p in listed]

    def goal(self) -> Any:
        """All predicates together; `all` and `any` in their keys are about the objects of a group."""
        if self.predicates("goal_predicates_specific"):
            raise self.refused(
                "`goal_predicates_specific` names objects by number", "write them as `goal_predicates_all`"
            )
        every = [self.condition(p, "all") for p in self.predicates("goal_predicates_all")]
        every += [self.condition(p, "any") for p in self.predicates("goal_predicates_any")]
        if self.predicates("goal_predicates_any"):
            self.draft.changed(
                "`goal_predicates_any`", "each asks for any object of its group, and all of them must hold"
            )
        if not every:
            raise self.refused("its goal is empty: every rollout would succeed at once", "give it goal predicates")
        return every[0] if len(every) == 1 else {"all": tuple(every)}

    def condition(self, predicate: dict[str, Any], quantifier: str) -> Any:
        each = [self.atom(predicate, name) for name in self.members(predicate.get("group"))]
        if not each:
            raise self.refused(f"the group `{predicate.get('group')}` is empty: its predicate would always hold")
        return each[0] if len(each) == 1 else {quantifier: tuple(each)}

    def atom(self, predicate: dict[str, Any], name: str) -> Any:
        """One predicate about one object."""
        state, wanted = str(predicate.get("state")), predicate.get("value", True) is not False
        others = self.members(predicate["other_group"]) if predicate.get("other_group") else []
        if predicate.get("state_kwargs"):
            self.draft.changed(
                f"parameters of {state}",
                "predicates here have thresholds of their own",
                str(predicate["state_kwargs"])[:80],
            )
        if len(others) > 1:
            raise self.refused(f"`{predicate.get('other_group')}` must mean one object, and means {len(others)}")
        if state == "Touching" and "agent" in (name, *others):
            thing = name if name != "agent" else others[0] if others else ""
            if not wanted and thing and thing != "agent":
                return f"Released({thing})"
            robots = list(self.scene.robots)
            if len(robots) != 1:
                raise self.refused("a robot is to touch something", f"the scene must have one robot, not {len(robots)}")
            return f"Touching({robots[0]}, {thing})"
        if state == "IsGrasping":
            text = f"Grasped({others[0] if name == 'agent' and others else name})"
        elif state in BINARY and others and name != "agent":
            text = f"{BINARY[state]}({name}, {others[0]})"
        elif state == "Open" and name != "agent":
            return f"{'Open' if wanted else 'Closed'}({name})"
        elif state in UNARY and name != "agent":
            text = f"{UNARY[state]}({name})"
        else:
            raise self.refused(f"there is no predicate for `{state}` of `{predicate.get('group')}`")
        return text if wanted else {"not": text}

    def subtasks(self) -> dict[str, Any]:
        """Milestones in an order that their `requires` allow."""
        listed = self.predicates("milestone_predicates")
        names = NameTable("step")
        out: dict[str, Any] = {}
        done: set[str] = set()
        while listed:
            ready = next((m for m in listed if set(m.get("requires") or ()) <= done), None)
            if ready is None:
                raise self.refused("its milestones require each other in a ring")
            listed.remove(ready)
            done.add(str(ready.get("name")))
            out[names.name(str(ready.get("name")))] = {"goal": self.condition(ready, "all")}
        return out

    def start(self) -> dict[str, Any]:
        place: dict[str, Any] = {}
        for key in ("init_predicates_all", "init_predicates_any", "init_predicates_specific"):
            for predicate in self.predicates(key):
                if predicate.get("state") != "PlaceOnTop" or predicate.get("value") is False:
                    self.draft.dropped(
                        f"`{key}`: {predicate.get('state')}", "only objects placed on others can be said"
                    )
                    continue
                below = self.members(predicate.get("other_group"))
                members = self.members(predicate.get("group"))
                if len(members) > 1:
                    self.draft.changed(
                        f"`{key}` of `{predicate.get('group')}`", "the release keeps the last object only; so does this"
                    )
                place[members[-1]] = {"on": below[0]}
        joints: dict[str, Any] = {}
        for group, positions in (self.config.get("group_init_joint_positions") or {}).items():
            for name in self.members(group):
                joints[name] = {plain_name(str(k), "joint"): float(v) for k, v in positions.items()}
        return {key: value for key, value in (("place", place), ("joints", joints)) if value}

    def reset(self) -> dict[str, Any]:
        """Ranges around the poses of the scene."""
        widths, turns = (self.config.get(f"group_{k}_randomization") or {} for k in ("xyz", "z_rot"))
        out: dict[str, Any] = {}
        for group in dict.fromkeys([*widths, *turns]):
            half = [abs(float(v)) for v in widths.get(group) or (0, 0, 0)]
            turn = math.degrees(abs(float(turns.get(group) or 0.0)))
            if half[2]:
                self.draft.dropped(
                    f"range of height of `{group}`", "objects start at the height that the scene gives them"
                )
            for name in self.members(group):
                p = [float(v) for v in self.lowered.object(name).X_WO.p]
                region: dict[str, Any] = {k: (p[i] - half[i], p[i] + half[i]) for i, k in enumerate("xy")}
                if turn:
                    region["yaw_deg"] = (-turn, turn)
                out[name] = region
        return out

    def wording(self, instruction: str, goal: Any) -> None:
        """Say where the words ask for `in` and the goal for `on`."""
        if " in " in f" {instruction.lower()} ":
            for text in _texts(goal):
                if text.startswith("OnTop("):
                    why = "the instruction says `in`, and the goal is met on top; taken as it stands"
                    self.draft.assumed(f"`{text}`", why)


def _texts(condition: Any) -> Iterator[str]:
    if isinstance(condition, str):
        yield condition
    elif isinstance(condition, dict):
        for value in condition.values():
            for item in value if isinstance(value, tuple) else (value,):
                yield from _texts(item)
