"""A session that reads and steps any Newton model."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import newton
import numpy as np
import warp as wp

from simfoundry.geometry.frames import Pose, from_xyzw
from simfoundry.verify import readback as rb

NO_LIMIT = 1e9
"""Joint limits beyond this value mean that the joint has no limits.

Newton's importers write such values for joints without limits.
"""

UNLIMITED = 1e6
"""Newton's value for the effort and velocity limits of joints without these limits."""

_Joint, _Geo = newton.JointType, newton.GeoType
_TYPES = {int(_Joint.PRISMATIC): "prismatic", int(_Joint.REVOLUTE): "revolute", int(_Joint.BALL): "ball"}
_KINDS = {int(_Geo.BOX): "box", int(_Geo.SPHERE): "sphere", int(_Geo.CYLINDER): "cylinder",
          int(_Geo.CAPSULE): "capsule", int(_Geo.MESH): "mesh", int(_Geo.CONVEX_MESH): "mesh"}  # fmt: skip


class Names(NamedTuple):
    """The mapping from an importer's labels to the links, colliders and joints in the scene.

    ``collider`` returns the link and the name of the collider, or None for visuals. ``joint`` returns None for joints
    added by the importer. ``static`` contains the poses of links that Newton merged into the world. ``custom`` is
    True if Newton stores motors, the resistance to spinning and rolling, and the restitution in MuJoCo's custom
    attributes. ``axes`` returns the names of the axes of a joint with several, which Newton sorts: it moves along axes
    before it turns about axes.
    """

    link: Callable[[str], str]
    collider: Callable[[str], tuple[str, str] | None]
    joint: Callable[[str], str | None]
    static: Mapping[str, Pose]
    custom: bool = True
    axes: Callable[[str], Sequence[str]] = lambda label: ()


class NewtonSession(rb.Session):
    """A model on the CPU with Newton's MuJoCo solver, the only Newton solver that supports articulated scenes."""

    def __init__(self, model: newton.Model, names: Names) -> None:
        self.model, self.names = model, names
        bodies = {names.link(label): k for k, label in enumerate(model.body_label)}
        self._bodies = {
            name: k for name, k in bodies.items() if ":" not in name
        }  # names with a colon belong to parts of links
        self._kinds = [int(k) for k in _array(model.joint_type)]
        labels = {names.joint(label): k for k, label in enumerate(model.joint_label)}
        self._joints = {name: (k, 0) for name, k in labels.items() if name is not None and self._kinds[k] in _TYPES}
        for k, label in enumerate(model.joint_label):
            if self._kinds[k] == int(_Joint.D6):
                self._joints |= {name: (k, axis) for axis, name in enumerate(names.axes(label))}
        self._q_start, self._qd_start = _array(model.joint_q_start), _array(model.joint_qd_start)
        self._state, self._next = model.state(), model.state()
        if self._bodies:
            newton.eval_fk(model, model.joint_q, model.joint_qd, self._state)
        self._control = model.control()
        self._solver: newton.solvers.SolverBase | None = None

    def step(self) -> None:
        """Advance the simulation by one step. This solver always uses MuJoCo's own contacts."""
        if self._solver is None:
            self._solver = newton.solvers.SolverMuJoCo(self.model, use_mujoco_cpu=True, enable_multiccd=True)
        self._state.clear_forces()
        self._solver.step(self._state, self._next, self._control, None, self.timestep)
        self._state, self._next = self._next, self._state

    def moment(self, time: float) -> rb.Moment:
        """Return the poses of the root bodies, and the joint positions from the generalized coordinates."""
        q = _array(self._state.joint_q)
        poses = {n: rb.pose_numbers(p) for n, p in self._poses().items() if "." not in n}
        return rb.Moment(time, poses, {n: float(q[self._q_start[k] + axis]) for n, (k, axis) in self._joints.items()})

    def read(self) -> rb.WorldReadback:
        """Return the bodies, the static links and the joints."""
        model, poses, colliders, held = self.model, self._poses(), self._colliders(), self._held()
        mass, com, inertia = (_array(a) for a in (model.body_mass, model.body_com, model.body_inertia))
        links = {
            name: rb.LinkReadback(
                pose=rb.pose_numbers(poses[name]),
                mass=float(mass[k]),
                com=rb.numbers(com[k]),
                inertia=rb.numbers(inertia[k]),
                held=held.get(k),
                colliders=tuple(colliders.get(name, ())),
            )
            for name, k in self._bodies.items()
        }
        static = {name: pose for name, pose in self.names.static.items() if name not in links}
        for name, pose in static.items():
            links[name] = rb.LinkReadback(rb.pose_numbers(pose), colliders=tuple(colliders.get(name, ())))
        joints = {name: self._joint(k, axis) for name, (k, axis) in self._joints.items()}
        driven = None
        if not self.names.custom:
            driven = rb.driven(joints)
        return rb.WorldReadback(
            links, joints, rb.numbers(model.gravity.numpy()[0]), silent=self._silent(), actuators=driven
        )

    def _held(self) -> dict[int, str]:
        """Return the parent of each body, which is given by its first joint.

        Any other joint of the body closes a loop.
        """
        names = {k: self.names.link(label) for k, label in enumerate(self.model.body_label)}
        found: dict[int, str] = {}
        ends = zip(self._kinds, _array(self.model.joint_parent), _array(self.model.joint_child), strict=True)
        for kind, parent, child in ends:
            holder = rb.FREE if kind == int(_Joint.FREE) else names[int(parent)] if parent >= 0 else rb.WORLD
            found.setdefault(int(child), holder)
        return found

    def _silent(self) -> tuple[str, ...]:
        """Return the pairs of bodies whose shapes are all filtered. Shapes that belong to the world have no body."""
        names = {k: name for name, k in self._bodies.items()}
        owners, flags = _array(self.model.shape_body), _array(self.model.shape_flags)
        links = [self.names.link(label).partition(":")[0] for label in self.model.body_label]
        whole = {k: self._bodies.get(link, k) for k, link in enumerate(links)}
        felt = {
            k: whole.get(int(owners[k]), -1)
            for k in range(len(owners))
            if flags[k] & int(newton.ShapeFlags.COLLIDE_SHAPES)
        }
        counts: dict[int, int] = Counter(felt.values())
        filtered: dict[tuple[int, int], int] = Counter()
        for a, b in self.model.shape_collision_filter_pairs:
            one, other = sorted((felt.get(int(a), -1), felt.get(int(b), -1)))
            if one >= 0 and one != other:
                filtered[one, other] += 1
        return tuple(rb.pair_name(names[a], names[b]) for (a, b), n in filtered.items() if n == counts[a] * counts[b])

    def _poses(self) -> dict[str, Pose]:
        body_q = _array(self._state.body_q)
        return dict(self.names.static) | {name: _pose(body_q[k]) for name, k in self._bodies.items()}

    def _colliders(self) -> dict[str, list[rb.ColliderReadback]]:
        model = self.model
        flags, kinds, owners = model.shape_flags.numpy(), model.shape_type.numpy(), model.shape_body.numpy()
        transforms, scales = model.shape_transform.numpy(), model.shape_scale.numpy()
        mu, restitution = model.shape_material_mu.numpy(), model.shape_material_restitution.numpy()
        spinning, rolling = model.shape_material_mu_torsional.numpy(), model.shape_material_mu_rolling.numpy()
        found: dict[str, list[rb.ColliderReadback]] = {}
        for k, label in enumerate(model.shape_label):
            named = self.names.collider(label)
            if named is None or not flags[k] & int(newton.ShapeFlags.COLLIDE_SHAPES):
                continue
            link, name = named
            X_LG = _pose(transforms[k])
            if owners[k] < 0:  # merged into the world
                X_LG = self.names.static[link].inverse() @ X_LG
            kind = _KINDS.get(int(kinds[k]), "other")
            bounds = self._bounds(k, kind, scales[k], X_LG)
            surface: tuple[float | None, ...] = (float(restitution[k]), float(spinning[k]), float(rolling[k]))
            if self.names.custom:  # in MJCF, the solver's own attributes define these
                surface = (None, None, None)
            facts = rb.ColliderReadback(name, kind, bounds, float(mu[k]), *surface)
            found.setdefault(link, []).append(facts)
        return found

    def _bounds(self, shape: int, kind: str, scale: np.ndarray, X_LG: Pose) -> rb.Numbers:
        if kind == "mesh":
            return rb.mesh_bounds(np.asarray(self.model.shape_source[shape].vertices) * scale, X_LG)
        size = 2 * scale if kind == "box" else (scale[0], 2 * scale[1])
        return rb.shape_bounds(kind, size, X_LG)

    def _joint(self, joint: int, axis: int) -> rb.JointReadback:
        """Return the values of a joint or of one of the axes of a joint with several.

        Newton limits a motor to the smaller of its own limit and that of its joint.
        """
        model, dof = self.model, int(self._qd_start[joint]) + axis
        low, high = float(model.joint_limit_lower.numpy()[dof]), float(model.joint_limit_upper.numpy()[dof])
        X_CJ = _pose(model.joint_X_c.numpy()[joint])
        start, ball = int(self._q_start[joint]) + axis, self._kinds[joint] == int(_Joint.BALL)
        gains = float(model.joint_target_ke.numpy()[dof]), float(model.joint_target_kd.numpy()[dof])
        drive: rb.Numbers | None = None if self.names.custom else ()
        if any(gains) and not self.names.custom:
            drive = (*gains, float(model.joint_target_q.numpy()[start]))
        effort, velocity = (
            (value,) if value < UNLIMITED else ()
            for value in (float(model.joint_effort_limit.numpy()[dof]), float(model.joint_velocity_limit.numpy()[dof]))
        )
        return rb.JointReadback(
            type=_TYPES.get(
                self._kinds[joint], "prismatic" if axis < model.joint_dof_dim.numpy()[joint][0] else "revolute"
            ),
            axis=None if ball else rb.numbers(X_CJ.rotation @ model.joint_axis.numpy()[dof]),
            limits=(low, high) if max(abs(low), abs(high)) < NO_LIMIT and not ball else (),
            damping=float(model.joint_damping.numpy()[dof]),
            friction=float(model.joint_friction.numpy()[dof]),
            armature=float(model.joint_armature.numpy()[dof]),
            position=rb.numbers(from_xyzw(model.joint_q.numpy()[start : start + 4]))
            if ball
            else float(model.joint_q.numpy()[start]),
            drive=drive,
            effort=None if drive is None else effort if drive else (),
            max_effort=None if drive else effort,
            max_velocity=velocity,
        )


def quiet() -> None:
    """Silence Warp, which would otherwise print a message for every kernel that is loaded."""
    wp.config.quiet = True


def _array(values: wp.array | None) -> np.ndarray:
    """Return the values as an array, which is empty if the model has no bodies or joints and Newton stores None."""
    return np.zeros(0) if values is None else np.asarray(values.numpy())


def _pose(transform: np.ndarray) -> Pose:
    return Pose.of(transform[:3], from_xyzw(transform[3:]))
