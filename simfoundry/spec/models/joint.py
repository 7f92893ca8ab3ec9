"""Joints between the links of an asset: types of motion, limits, friction, motors and couplings."""

import math
from itertools import combinations, pairwise
from typing import Literal, get_args

from pydantic import Field

from simfoundry.spec.models.base import (
    Model,
    Name,
    NonNegative,
    Number,
    PoseSpec,
    Positive,
    Range,
    Vec3,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.native import JointNative

JointKind = Literal["fixed", "revolute", "prismatic", "continuous", "ball", "free"]
AxisKind = Literal["revolute", "prismatic", "continuous"]


class MimicSpec(Model):
    """The coupling of a joint to a leader joint: position = ``multiplier`` × leader position + ``offset``."""

    joint: Name = Field(description="The leader joint.")
    multiplier: Number = Field(1.0, description="Ratio of this joint's motion to the leader's motion.")
    offset: Number = Field(0.0, description="Position of this joint when the leader is at zero [m, or rad].")


class DriveSpec(Model):
    """A motor that holds a position like a spring or damps motion, up to a maximum force.

    The force is `stiffness` times the deviation from the target, minus `damping` times the velocity.
    """

    stiffness: NonNegative = Field(0.0, description="Force per unit of deviation from the target [N/m, or N m/rad].")
    damping: NonNegative = Field(0.0, description="Opposing force per unit of velocity [N s/m, or N m s/rad].")
    target: Number | None = Field(None, description="Target [m, or rad]; default: the joint's initial position.")
    force_limit: Positive | None = Field(None, description="Maximum force [N, or N m].")

    @consistent
    def _acts(self) -> None:
        if self.stiffness == 0 and self.damping == 0:
            raise fault("sf107", "a drive needs `stiffness` or `damping`")


class _Motion(Model):
    """The axis of a joint, with its limits and dynamics."""

    axis: Vec3 = Field((0.0, 0.0, 1.0), description="Direction of the axis in the child's frame.")
    limits: Range | None = Field(None, description="Lower and upper limit of a prismatic joint [m].")
    limits_deg: Range | None = Field(None, description="Lower and upper limit of a revolute joint [deg].")
    closed: Literal["lower", "upper"] | None = Field(
        None,
        description="The limit at which `Open` and `Closed` treat the joint as closed; default: zero, or the limit "
        "closest to zero.",
    )
    damping: NonNegative = Field(0.0, description="Viscous damping [N s/m, or N m s/rad].")
    friction: NonNegative = Field(0.0, description="Coulomb friction [N, or N m].")
    armature: NonNegative = Field(
        0.0, description="Inertia added to the joint, such as the rotor inertia of a motor [kg, or kg m^2]."
    )
    effort: Positive | None = Field(
        None, description="Maximum force of the joint's actuators, including its drive [N, or N m]; default: unlimited."
    )
    velocity: Positive | None = Field(None, description="Maximum speed of a prismatic joint [m/s]; default: unlimited.")
    velocity_deg: Positive | None = Field(
        None, description="Maximum speed of a revolute or continuous joint [deg/s]; default: unlimited."
    )
    mimic: MimicSpec | None = Field(None, description="Coupling to another joint that this joint follows.")
    drive: DriveSpec | None = Field(None, description="A motor that drives the joint.")
    native: JointNative | None = Field(None, description="Data that only one format knows.")

    def _check_motion(self, kind: JointKind) -> None:
        """Raise an error if the values are inconsistent with the type of motion."""
        if kind == "prismatic" and self.limits is None:
            raise fault("sf107", "a prismatic joint needs `limits`, in meters")
        if kind == "revolute" and self.limits_deg is None:
            raise fault("sf107", "a revolute joint needs `limits_deg`; without limits it is `continuous`")
        for given, name, one in ((self.limits, "limits", "prismatic"), (self.limits_deg, "limits_deg", "revolute")):
            if given is not None and kind != one:
                raise fault("sf107", f"`{name}` applies only to {one} joints, but this joint is {kind}", name)
            if given is not None and given[0] >= given[1]:
                raise fault("sf104", "the lower limit must be less than the upper limit", name)
        if sum(v * v for v in self.axis) < 1e-12:
            raise fault("sf104", "`axis` must not be zero", "axis")
        for name in ("damping", "friction", "armature") if kind == "free" else ():
            if getattr(self, name):
                raise fault("sf107", f"`{name}` has no effect on a free joint", name)
        if self.closed is not None and kind not in ("revolute", "prismatic"):
            raise fault("sf107", f"`closed` refers to a limit, but a {kind} joint has no limits", "closed")
        if self.velocity is not None and kind != "prismatic":
            hint = ", in degrees per second: write `velocity_deg`" if kind in ("revolute", "continuous") else ""
            message = f"`velocity` applies only to prismatic joints, but this joint is {kind}{hint}"
            raise fault("sf107", message, "velocity")
        if self.velocity_deg is not None and kind not in ("revolute", "continuous"):
            hint = ", in meters per second: write `velocity`" if kind == "prismatic" else ""
            message = f"`velocity_deg` applies only to joints that rotate about one axis, but this joint is {kind}"
            raise fault("sf107", message + hint, "velocity_deg")
        for name in ("effort", "mimic", "drive"):
            if getattr(self, name) is not None and kind not in get_args(AxisKind):
                raise fault("sf107", f"`{name}` applies only to joints with one axis, but this joint is {kind}", name)


class _AxisType(Model):
    type: AxisKind = Field(description="Type of motion about or along the axis.")


class AxisSpec(_Motion, _AxisType):
    """One axis of a joint with several axes. Its name is that of a joint with a single axis."""

    @consistent
    def _consistent(self) -> None:
        self._check_motion(self.type)


class _Connection(Model):
    type: JointKind | None = Field(None, description="Type of motion between the parent and the child.")
    parent: Name = Field(description="The link that the joint is attached to.")
    child: Name = Field(description="The link that moves.")
    pose: PoseSpec = Field(
        PoseSpec.model_construct(),
        description="Pose of the child's frame in the parent's frame at joint position zero.",
    )
    axes: dict[Name, AxisSpec] = Field(
        {},
        max_length=6,
        description="Axes of a joint with several axes, such as a planar, cylindrical or universal joint, instead of "
        "`type`. Each axis moves with the axes before it, and positions and predicates refer to it by its name.",
    )


class JointSpec(_Motion, _Connection):
    """A joint between two links, located at the origin of the child's frame."""

    @consistent
    def _consistent(self) -> None:
        exclusive(self, "type", "axes", needed=True)
        if self.type is not None:
            self._check_motion(self.type)
            return
        for name in _Motion.model_fields:
            if getattr(self, name) != _Motion.model_fields[name].default:
                raise fault("sf107", f"`{name}` belongs to one of the `axes`, because this joint has several", name)
        if len(self.axes) < 2:
            raise fault("sf107", "a joint with one axis is written with `type` instead of `axes`", "axes")
        check_axes(self.axes)

    def single_axis(self, name: str) -> "JointSpec":
        """Return one of the axes as a joint with a single axis at the pose of this joint."""
        axis = self.axes[name]
        return JointSpec.model_construct(
            type=axis.type,
            parent=self.parent,
            child=self.child,
            pose=self.pose,
            axes={},
            **{field: getattr(axis, field) for field in _Motion.model_fields},
        )


# Axes whose triple product or cross product, as unit vectors, is below this value count as dependent (0.06 degrees).
_DEPENDENT = 1e-3


def check_axes(axes: dict[str, AxisSpec]) -> None:
    """Raise an error if two of the axes allow the same motion, which would leave the joint without a unique state.

    Raises:
        PydanticCustomError: With the names of the axes.
    """
    slides = {name: axis for name, axis in axes.items() if axis.type == "prismatic"}
    turns = {name: axis for name, axis in axes.items() if axis.type != "prismatic"}
    for kind, found in (("prismatic", slides), ("rotating", turns)):
        names = list(found)
        if len(names) > 3:
            raise fault("sf104", f"a joint has at most three {kind} axes, but this one has {len(names)}", "axes")
        # Rotating axes turn those after them, so that the first and the last of three may be parallel.
        pairs = combinations(names, 2) if kind == "prismatic" else pairwise(names)
        for a, b in pairs:
            if math.hypot(*_cross(_unit(found[a].axis), _unit(found[b].axis))) < _DEPENDENT:
                raise fault("sf104", f"`{a}` and `{b}` allow the same motion, because they are parallel", "axes")
        if kind == "prismatic" and len(names) == 3:
            first, second, third = (_unit(axis.axis) for axis in found.values())
            if abs(sum(a * b for a, b in zip(_cross(first, second), third, strict=True))) < _DEPENDENT:
                raise fault("sf104", "the three prismatic axes are in one plane", "axes")


def _unit(axis: tuple[float, float, float]) -> tuple[float, float, float]:
    length = math.hypot(*axis)
    return axis[0] / length, axis[1] / length, axis[2] / length


def _cross(a: tuple[float, float, float], b: tuple[float, float, float]) -> tuple[float, float, float]:
    return a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]
