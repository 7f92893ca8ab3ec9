"""Check tasks and recipes: the names in goals, initial states, resets, and axes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from importlib import import_module
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.spec.check.asset import check_joints
from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.check.goal_logic import verdict
from simfoundry.spec.check.names import SceneNames
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.cousins import CousinsSpec, TaskAxis
from simfoundry.spec.models.predicate import parts, texts
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import Start, TaskSpec


def check_task(c: Checker, spec: TaskSpec) -> None:
    """Check a task."""
    scene = c.use(spec.scene, ("scene",), ("scene/1",), (".scene.yaml", ".yaml"))
    names = scene_names(scene)
    _goal(c, names, spec.goal, ("goal",))
    _start(c, names, spec.start, ("start",))
    for name, subtask in spec.subtasks.items():
        _goal(c, names, subtask.goal, ("subtasks", name, "goal"))
        if subtask.start is not None:
            _start(c, names, subtask.start, ("subtasks", name, "start"))
    if spec.horizon < spec.control_hz:
        message = f"an episode of {spec.horizon} control steps at {spec.control_hz:g} Hz lasts less than a second"
        hint = f"`horizon` is the number of control steps; for 40 s, write {round(40 * spec.control_hz)}"
        c.warn("SF433", ("horizon",), message, hint)
    if names is None:
        return
    if not names.robots and spec.origin is None:  # generated tasks inherit this from a scene that a person wrote
        message = f"`{spec.scene}` has no robot, so no policy can be evaluated on this task"
        c.warn("SF442", ("scene",), message, "add one under `robots` in the scene")
    for k, robot in enumerate(spec.robots or ()):
        c.name(robot, names.robots, ("robots", k), "robot")
    for name in spec.reset.objects:
        _moves(c, names, name, ("reset", "objects", name))


def scene_names(scene: Loaded | None) -> SceneNames | None:
    """Return the names in a scene, or None if the scene could not be read."""
    if scene is None or scene.document is None or not isinstance(scene.document.data, dict):
        return None
    return SceneNames(scene, scene.spec if isinstance(scene.spec, SceneSpec) else None)


def _goal(c: Checker, names: SceneNames | None, goal: str | Model, path: Path_) -> None:
    """Check that the names in a goal are valid, and that the goal is not empty.

    An empty goal would succeed immediately.
    """
    if names is not None:
        names.check_condition(c, goal, path)
    empty = [*_empty_groups(goal, path)]
    for at in empty or ([path] if not any(True for _ in texts(goal)) else []):
        never = at[-1] == "any"
        message = "a goal without predicates " + ("never succeeds" if never else "succeeds immediately")
        c.warn("SF404", at, message, "add the condition that must hold, such as `Inside(cup, bowl)`")
    value, excluded = verdict(goal) if not empty else (None, ())
    if value is not None:
        message = f"the goal can never be {'false' if value else 'satisfied'}"
        if len(excluded) == 1:
            message += f", because it requires `{excluded[0]}` and its opposite"
        elif excluded:
            message += f", because {' and '.join(f'`{call}`' for call in excluded[:4])} exclude each other"
        c.warn("SF432", path, message, "correct the predicates, their arguments, or `not`")


def _empty_groups(condition: Any, path: Path_) -> Iterator[Path_]:
    """Yield the path of each `all` and `any` without conditions."""
    tag, below = parts(condition)
    if not below:
        yield (*path, tag)
    for k, item in enumerate(below if tag != "text" else ()):
        yield from _empty_groups(item, (*path, tag) if tag == "not" else (*path, tag, k))


def _start(c: Checker, names: SceneNames | None, start: Start, path: Path_) -> None:
    if names is None:
        return
    for key in ("place", "pose"):
        for name in getattr(start, key):
            _moves(c, names, name, (*path, key, name))
    for name, positions in start.joints.items():
        place_of = (*path, "joints", name)
        if not c.name(name, names.objects, place_of, "object"):
            continue
        asset = names.asset(name)
        if asset is not None:
            check_joints(c, asset, positions, place_of, resting=False)
        elif names.is_known(name):
            c.add("SF201", place_of, f"`{name}` does not have any joints")
    places = {name: place for name, place in start.place.items() if name in names.objects}
    names.check_places(c, places, {name: (*path, "place", name) for name in places})


def _moves(c: Checker, names: SceneNames, name: str, path: Path_) -> None:
    """Check that an object with a different initial pose exists and is not fixed to the world."""
    if c.name(name, names.objects, path, "object") and names.is_fixed(name):
        message = f"`{name}` is fixed in the scene, so its initial pose cannot be changed"
        c.add("SF107", path, message, "remove it here, or remove `fixed` in the scene")


def check_cousins(c: Checker, spec: CousinsSpec) -> None:
    """Check a recipe."""
    twin = c.use(spec.twin, ("twin",), ("scene/1", "task/1"), (".scene.yaml", ".task.yaml", ".yaml"))
    for section, axis in (("object", spec.object), ("distractors", spec.distractors)):
        c.file(axis.library if axis is not None else None, (section, "library"), ())
    _engines(c, spec.task)
    spec_of_twin = twin.spec if twin is not None else None
    names = scene_names(twin.used(spec_of_twin.scene) if twin and isinstance(spec_of_twin, TaskSpec) else twin)
    if names is None:
        return
    for name in spec.parameters:
        c.name(name, names.scene.parameters, ("parameters", name), "parameter of the twin's scene")
    if spec.scene is not None:
        goal = spec_of_twin.goal if isinstance(spec_of_twin, TaskSpec) else {"all": ()}
        if spec.scene.anchor is None and not _stays(goal, names, spec.scene.objects):
            message = "there is no anchor, and the goal of the twin names no object that stays in place"
            c.add("SF107", ("scene",), message, "name the object around which the others are placed in `anchor`")
        if spec.scene.anchor is not None:
            c.name(spec.scene.anchor, names.objects, ("scene", "anchor"), "object")
        for name, sides in spec.scene.objects.items():
            path = ("scene", "objects", name)
            if c.name(name, names.objects, path, "object") and names.is_fixed(name):
                c.add("SF107", path, f"`{name}` is fixed in the twin, so it cannot move", "remove it here")
            if name == spec.scene.anchor:
                c.add("SF107", path, f"`{name}` is the anchor, which must not move", "remove it here")
            if not sides:
                c.add("SF105", path, f"no predicate is allowed for `{name}`", "list at least one, such as `LeftOf`")
    for name, wanted in spec.object.objects.items() if spec.object is not None else ():
        c.name(name, names.objects, ("object", "objects", name), "object")
        if spec.object is not None and "library" in wanted.sources and spec.object.library is None:
            place = ("object", "objects", name, "sources")
            c.add("SF107", place, f"variants of `{name}` come from a library, but no library is given", "set `library`")
    for k, name in enumerate(spec.task.objects if spec.task is not None else ()):
        c.name(name, names.objects, ("task", "objects", k), "object")
    if spec.vary and isinstance(names.scene.spec, SceneSpec):
        _vary(c, spec, names.scene, twin)


def _vary(c: Checker, spec: CousinsSpec, scene: Loaded, twin: Loaded | None) -> None:
    from simfoundry.spec.check.varied_fields import FieldFinder  # only for recipes that vary values
    from simfoundry.spec.check.vary import varied_values

    for problem in varied_values(spec, FieldFinder(scene, twin), c.loaded)[1]:
        c.add(problem.code, ("vary", *problem.at), problem.message, problem.hint)


def _stays(goal: str | Model | dict[str, Any], names: SceneNames, moved: Mapping[str, object]) -> bool:
    """Return True if a goal names an object of the scene that is not moved."""
    named = {a.partition(".")[0] for text, _ in texts(goal) for a in re.findall(r"[a-z][a-z0-9_.]*", text)}
    return any(name in names.objects and name not in moved for name in named)


def _engines(c: Checker, axis: TaskAxis | None) -> None:
    """Check that each simulator named in a recipe, including those from installed packages, can run scenes."""
    if axis is None or "engines" not in axis.model_fields_set:
        return
    worlds = import_module("simfoundry.worlds")  # belongs to a higher layer, and most recipes do not need it
    for k, engine in enumerate(axis.engines):
        try:
            worlds.find_world(engine)
        except SimfoundryError as error:
            c.add("SF106", ("task", "engines", k), str(error))
