"""Attribute errors of placements to the task whose initial state causes them."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.scene.place import needs
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import Start

Starts = Mapping[tuple[str, ...], Start]


def placed_in_task(task: Loaded, starts: Starts, spec: SceneSpec, finding: Diagnostic) -> Diagnostic:
    """Move a finding about a placement to the entry of a task that places the object, or that moves its support.

    Args:
        task: The task document.
        starts: The initial states in the task by their paths, in the order in which they are applied.
        spec: The scene document after applying the initial states.
        finding: A finding from lowering this scene. It is returned unchanged if no entry of the task causes it.
    """
    parts = finding.path.split(".")
    if finding.code != "SF210" or len(parts) != 3:
        return finding
    chain, todo = dict[str, None](), [parts[1]]
    while todo:
        if (name := todo.pop(0)) not in chain:
            chain[name] = None
            place = spec.objects[name].place if name in spec.objects else None
            todo += needs(place) if place is not None else ()
    for name in chain:
        for path, start in reversed(tuple(starts.items())):
            for key in ("place", "pose", "joints"):
                if name in getattr(start, key):
                    return task.finding("SF210", (*path, key, name), finding.message, finding.hint)
    return finding
