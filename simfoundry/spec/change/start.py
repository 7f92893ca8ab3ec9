"""Apply the start of a task to a scene document."""

from __future__ import annotations

from collections.abc import Iterable

from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import Start


def with_starts(spec: SceneSpec, starts: Iterable[Start]) -> SceneSpec:
    """Return the document with its objects moved as the starts specify; later starts override earlier ones."""
    objects = dict(spec.objects)
    for start in starts:
        for name, place in start.place.items():
            objects[name] = objects[name].model_copy(update={"place": place})
        for name, pose in start.pose.items():
            objects[name] = objects[name].model_copy(update={"place": None, "pose": pose})
        for name, joints in start.joints.items():
            objects[name] = objects[name].model_copy(update={"joints": {**objects[name].joints, **joints}})
    return spec.model_copy(update={"objects": objects})
