"""Many states of one scene as arrays."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.poses import Index, Poses
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState


def _nothing() -> Mapping[str, Array]:
    return MappingProxyType({})


@dataclass(frozen=True, eq=False)
class StateBatch:
    """``n`` states of one scene.

    ``poses`` are X_WO by object; ``joints`` are positions [rad or m] by ``object.joint``, shape (n,); ``motions`` are
    those of ball and free joints as in :class:`SceneState`; ``robots`` are positions of a robot's joints by
    ``robot.joint``, shape (n,); ``speeds`` [m/s] by object, shape (n,). Everything else is as in the scene, at rest.
    """

    n: int
    poses: Mapping[str, Poses]
    joints: Mapping[str, Array] = field(default_factory=_nothing)
    motions: Mapping[str, Poses] = field(default_factory=lambda: MappingProxyType({}))
    robots: Mapping[str, Array] = field(default_factory=_nothing)
    speeds: Mapping[str, Array] = field(default_factory=_nothing)

    @classmethod
    def of(cls, scene: Scene, states: Sequence[SceneState]) -> StateBatch:
        """Return the states in their order; values missing from a state are those of the scene."""
        initial = SceneState.initial(scene)
        arms = {f"{r}.{j}" for s in states for r, joints in s.robots.items() for j in joints}
        complete = {r: [s.robots.get(r) for s in states] for s in states[:1] for r in s.robots}
        if any(joints is None for every in complete.values() for joints in every):
            raise ValueError(
                "only some of the states have positions of the robots' joints; give them for all states or for none"
            )
        return cls(
            len(states),
            {n: _stacked([s.poses.get(n, pose) for s in states]) for n, pose in initial.poses.items()},
            {n: np.array([s.joints.get(n, at) for s in states]) for n, at in initial.joints.items()},
            {n: _stacked([s.motions.get(n, at) for s in states]) for n, at in initial.motions.items()},
            {n: np.array([s.robots[n.partition(".")[0]][n.partition(".")[2]] for s in states]) for n in sorted(arms)},
            {
                n: np.array([s.speeds.get(n, 0.0) for s in states])
                for n in sorted({k for s in states for k in s.speeds})
            },
        )

    def at(self, index: Index) -> StateBatch:
        """Select states."""

        def taken(arrays: Mapping[str, Array]) -> dict[str, Array]:
            return {name: values[index] for name, values in arrays.items()}

        poses, motions = ({n: x.at(index) for n, x in m.items()} for m in (self.poses, self.motions))
        return StateBatch(len(index), poses, taken(self.joints), motions, taken(self.robots), taken(self.speeds))


def _stacked(poses: Sequence[Pose]) -> Poses:
    return Poses.of(np.array([x.p for x in poses]).reshape(-1, 3), np.array([x.q for x in poses]).reshape(-1, 4))
