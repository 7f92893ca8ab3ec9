"""Many states of one scene as arrays, and vectorised rigid poses."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from simfoundry.scene.frames import Array, Pose
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState

Index = NDArray[np.int64]


class Poses(NamedTuple):
    """n poses ``X_AB``: positions ``p`` [m], shape (n, 3), and rotation matrices ``R``, shape (n, 3, 3)."""

    p: Array
    R: Array

    @classmethod
    def of(cls, p: Array, q: Array) -> Poses:
        """From positions (n, 3) and quaternions wxyz (n, 4) of any length but 0."""
        return cls(np.asarray(p, dtype=np.float64), rotations(np.asarray(q, dtype=np.float64)))

    @classmethod
    def constant(cls, pose: Pose, n: int) -> Poses:
        """One pose n times."""
        return cls(np.broadcast_to(pose.p, (n, 3)), np.broadcast_to(pose.rotation, (n, 3, 3)))

    def __matmul__(self, other: Poses) -> Poses:
        return Poses(self.p + rotate(self.R, other.p), self.R @ other.R)

    def times(self, pose: Pose) -> Poses:
        """``X_AC`` with one ``X_BC`` for all."""
        if pose.is_identity:
            return self
        return Poses(self.p + self.R @ pose.p, self.R @ pose.rotation)

    def inverse(self) -> Poses:
        """The n ``X_BA``."""
        turned = self.R.transpose(0, 2, 1)
        return Poses(-rotate(turned, self.p), turned)

    def at(self, index: Index) -> Poses:
        """Those of some states."""
        return Poses(self.p[index], self.R[index])


def rotate(turn: Array, v: Array) -> Array:
    """Each vector by its rotation: (n, 3, 3), (n, 3) to (n, 3)."""
    return np.asarray((turn @ v[:, :, None])[:, :, 0])


def rotations(q: Array) -> Array:
    """Rotation matrices, shape (n, 3, 3), of quaternions wxyz, shape (n, 4)."""
    w, x, y, z = (q / np.linalg.norm(q, axis=1, keepdims=True)).T
    out = np.empty((len(q), 3, 3))
    out[:, 0, 0], out[:, 0, 1], out[:, 0, 2] = 1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)
    out[:, 1, 0], out[:, 1, 1], out[:, 1, 2] = 2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)
    out[:, 2, 0], out[:, 2, 1], out[:, 2, 2] = 2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)
    return out


def turns(axis: Array, angle: Array) -> Array:
    """Rotation matrices, shape (n, 3, 3), about one unit axis by angles [rad], shape (n,)."""
    x, y, z = axis
    skew = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])
    s, c = np.sin(angle)[:, None, None], np.cos(angle)[:, None, None]
    return np.asarray(np.eye(3) + s * skew + (1 - c) * (skew @ skew))


def _nothing() -> Mapping[str, Array]:
    return MappingProxyType({})


@dataclass(frozen=True, eq=False)
class StateBatch:
    """``n`` states of one scene.

    ``poses`` are X_WO by object; ``joints`` positions [rad or m] by ``object.joint``, shape (n,), and ``motions`` of
    ball and free joints as in :class:`SceneState`; ``robots`` positions of a robot's joints by ``robot.joint``, shape
    (n,); ``speeds`` [m/s] by object, shape (n,). What is not mentioned is as the scene describes it, at rest.
    """

    n: int
    poses: Mapping[str, Poses]
    joints: Mapping[str, Array] = field(default_factory=_nothing)
    motions: Mapping[str, Poses] = field(default_factory=lambda: MappingProxyType({}))
    robots: Mapping[str, Array] = field(default_factory=_nothing)
    speeds: Mapping[str, Array] = field(default_factory=_nothing)

    @classmethod
    def of(cls, scene: Scene, states: Sequence[SceneState]) -> StateBatch:
        """The states in their order; what one of them does not mention is as the scene describes it."""
        initial = SceneState.initial(scene)
        arms = {f"{r}.{j}" for s in states for r, joints in s.robots.items() for j in joints}
        complete = {r: [s.robots.get(r) for s in states] for s in states[:1] for r in s.robots}
        if any(joints is None for every in complete.values() for joints in every):
            raise ValueError("some of the states say where the robots' joints are, and some do not")
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
        """Some of the states."""

        def taken(arrays: Mapping[str, Array]) -> dict[str, Array]:
            return {name: values[index] for name, values in arrays.items()}

        poses, motions = ({n: x.at(index) for n, x in m.items()} for m in (self.poses, self.motions))
        return StateBatch(len(index), poses, taken(self.joints), motions, taken(self.robots), taken(self.speeds))


def _stacked(poses: Sequence[Pose]) -> Poses:
    return Poses.of(np.array([x.p for x in poses]).reshape(-1, 3), np.array([x.q for x in poses]).reshape(-1, 4))
