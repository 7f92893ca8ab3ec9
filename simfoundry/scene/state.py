"""What changes in time: poses of objects and positions of joints."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from simfoundry.scene.frames import Pose
from simfoundry.scene.model import JointType, Scene


@dataclass(frozen=True, eq=False)
class SceneState:
    """Poses ``X_WO`` of the objects by name, and joint positions [rad or m] by ``object.joint``."""

    poses: Mapping[str, Pose]
    joints: Mapping[str, float]

    @classmethod
    def of(cls, poses: Mapping[str, Pose], joints: Mapping[str, float]) -> SceneState:
        """Freeze the two mappings."""
        return cls(MappingProxyType(dict(poses)), MappingProxyType(dict(joints)))

    @classmethod
    def initial(cls, scene: Scene) -> SceneState:
        """The state that the scene itself describes."""
        joints = {
            f"{o.name}.{j.name}": j.position for o in scene.objects for j in o.joints if j.type is not JointType.FIXED
        }
        return cls.of({o.name: o.X_WO for o in scene.objects}, joints)
