"""Check recipes: their axes must refer to names in the twin."""

from __future__ import annotations

from simfoundry.spec.check.checker import Checker
from simfoundry.spec.check.names import SceneNames
from simfoundry.spec.check.task import scene_names
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.cousins import CousinsSpec
from simfoundry.spec.models.task import TaskSpec


def check_cousins(c: Checker, spec: CousinsSpec) -> None:
    """Check a recipe."""
    twin = c.use(spec.twin, ("twin",), ("scene/1", "task/1"), (".scene.yaml", ".task.yaml", ".yaml"))
    if spec.object is not None and spec.object.library is not None:
        c.file(spec.object.library, ("object", "library"), ())
    if spec.distractors is not None and spec.distractors.library is not None:
        c.file(spec.distractors.library, ("distractors", "library"), ())
    names = _names(twin)
    if names is None:
        return
    if spec.scene is not None:
        if spec.scene.anchor is not None:
            c.name(spec.scene.anchor, names.objects, ("scene", "anchor"), "object")
        for name, sides in spec.scene.objects.items():
            path = ("scene", "objects", name)
            if c.name(name, names.objects, path, "object"):
                _free(c, names, name, path)
            if name == spec.scene.anchor:
                c.add("SF107", path, f"`{name}` is the anchor, which stays where it is", "remove it here")
            if not sides:
                c.add("SF105", path, f"no predicate is allowed for `{name}`", "list one, as `LeftOf`")
    for name, wanted in spec.object.objects.items() if spec.object is not None else ():
        c.name(name, names.objects, ("object", "objects", name), "object")
        if spec.object is not None and "library" in wanted.sources and spec.object.library is None:
            place = ("object", "objects", name, "sources")
            c.add("SF107", place, f"variants of `{name}` come from a library, and there is none", "give `library`")
    for k, name in enumerate(spec.task.objects if spec.task is not None else ()):
        c.name(name, names.objects, ("task", "objects", k), "object")


def _names(twin: Loaded | None) -> SceneNames | None:
    """Return the names in the scene of the twin."""
    if twin is None or not isinstance(twin.spec, TaskSpec):
        return scene_names(twin)
    return scene_names(twin.used(twin.spec.scene))


def _free(c: Checker, names: SceneNames, name: str, path: tuple[str, ...]) -> None:
    item = names.spec.objects.get(name) if names.spec is not None else None
    if item is not None and item.fixed:
        c.add("SF107", path, f"`{name}` is fixed in the twin, so it cannot move", "remove it here")
