"""The ``asset/1`` document: an object with links, parts, and joints, for use in scenes."""

import math
from functools import cached_property
from itertools import combinations, pairwise
from typing import Literal, get_args

from pydantic import Field

from simfoundry.spec.models.base import (
    COLOR,
    SCALE,
    BodySpec,
    Color,
    DocumentSpec,
    FileName,
    Fraction,
    Interval,
    Material,
    Model,
    Name,
    NonNegative,
    Number,
    Origin,
    Point3,
    PoseSpec,
    Positive,
    Range,
    Scale,
    Vec3,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.native import ActuatorNative, JointNative, LinkNative, PartNative, SensorNative, SiteNative
from simfoundry.spec.models.shapes import PartShape


class PartSpec(Model):
    """A part of a link: a shape or a mesh with a pose in the link's frame."""

    shape: PartShape | None = Field(None, description="A primitive.")
    mesh: FileName | None = Field(None, description="A mesh file (.glb, .obj, .stl, .ply), relative to this document.")
    scale: Scale = Field(1.0, description=SCALE)
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose in the link's frame.")
    material: Name | None = Field(None, description="A name from `materials`; default: the link's material.")
    color: Color | None = Field(None, description=COLOR.format("; default: the link's"))
    use: Literal["both", "visual", "collision"] = Field(
        "both",
        description="A `visual` part is rendered but neither collides nor has mass; a `collision` part collides and "
        "has mass but is not rendered.",
    )
    native: PartNative | None = Field(None, description="Data that only one format knows.")

    @consistent
    def _one_geometry(self) -> None:
        exclusive(self, "shape", "mesh", needed=True)
        if self.mesh is None and self.scale != 1.0:
            raise fault("sf107", "`scale` applies only to meshes; change the dimensions of the shape instead", "scale")


class Inertial(Model):
    """A measured inertia, which replaces the inertia computed from the parts."""

    com: Point3 = Field((0.0, 0.0, 0.0), description="Center of mass in the link's frame [m].")
    inertia: tuple[Number, Number, Number, Number, Number, Number] | None = Field(
        None,
        description="ixx, iyy, izz, ixy, ixz, iyz about the center of mass, in link axes [kg m^2]; default: the "
        "inertia of the parts about their own center of mass.",
    )

    @consistent
    def _of_a_body(self) -> None:
        if self.inertia is not None and not _is_of_a_body(self.inertia):
            rule = "the principal moments must be positive, and none may exceed the sum of the other two"
            raise fault("sf104", f"no rigid body has this inertia: {rule}", "inertia")


# Relative tolerance of the triangle inequality for principal moments; needed because files contain six digits.
ROUNDING = 1e-6


def _is_of_a_body(inertia: tuple[float, float, float, float, float, float]) -> bool:
    """Return True if the tensor is positive definite and its principal moments satisfy the triangle inequality."""
    trace = sum(inertia[:3])
    if not 0 < trace < math.inf:
        return False
    xx, yy, zz, xy, xz, yz = (value / trace for value in inertia)
    # With a trace of 1, c <= (1 - c) (1 + ROUNDING) holds for the greatest moment c if c < most.
    most = (1 + ROUNDING) / (2 + ROUNDING)
    return _is_positive(xx, yy, zz, xy, xz, yz) and _is_positive(most - xx, most - yy, most - zz, -xy, -xz, -yz)


def _is_positive(xx: float, yy: float, zz: float, xy: float, xz: float, yz: float) -> bool:
    """Return True if a symmetric tensor is positive definite, i.e. all leading minors are positive (Sylvester)."""
    minor = xx * yy - xy * xy
    return xx > 0 and minor > 0 and minor * zz + 2 * xy * xz * yz - xx * yz * yz - yy * xz * xz > 0


class LinkSpec(BodySpec):
    """A rigid body of the asset, made of parts. A link without parts needs an `inertial`."""

    parts: dict[Name, PartSpec] = Field({}, description="Parts of the link by name.")
    inertial: Inertial | None = Field(None, description="Measured center of mass and inertia; requires `mass`.")
    gravity_compensation: Fraction = Field(
        0.0, description="Share of the link's weight that is compensated, from 0 to 1: a link with 1 does not fall."
    )
    native: LinkNative | None = Field(None, description="Data that only one format knows.")

    @consistent
    def _mass(self) -> None:
        exclusive(self, "mass", "density")
        if self.inertial is not None and self.mass is None:
            raise fault("sf107", "`inertial` requires `mass`", "inertial")
        if all(part.use == "visual" for part in self.parts.values()) and not self.weighed:
            raise fault("sf107", "a link without collision parts needs `mass` and `inertial.inertia`")

    @property
    def weighed(self) -> bool:
        """Return True if the mass, center of mass and inertia are specified.

        In this case, the parts do not need a mass.
        """
        return self.inertial is not None and self.inertial.inertia is not None


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


class SiteSpec(Model):
    """A named frame on a link, to which sensors and tools can be attached."""

    link: Name = Field(description="The link that the site belongs to.")
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose in the link's frame.")
    native: SiteNative | None = Field(None, description="Data that only one format knows.")


class ActuatorSpec(Model):
    """An actuator of a joint, whose force is `gear` times a function of its control.

    The force is the control (`motor`), `kp` times the deviation of the scaled joint position from the control minus
    `kv` times the scaled velocity (`position`), or `kv` times the deviation of the scaled velocity from the control
    (`velocity`). Position and velocity are scaled by `gear`.
    """

    type: Literal["motor", "position", "velocity"] = Field(description="Quantity that the control commands.")
    joint: Name = Field(description="The joint that the actuator drives; it must have one axis.")
    gear: Number = Field(1.0, description="Ratio of the force at the joint to the force of the actuator.")
    kp: Positive | None = Field(None, description="Position gain of a `position` actuator [N/m, or N m/rad].")
    kv: NonNegative = Field(0.0, description="Velocity gain [N s/m, or N m s/rad].")
    control: Number = Field(0.0, description="Initial control [N, m or m/s, or N m, rad or rad/s].")
    control_range: Interval | None = Field(
        None, description="Minimum and maximum control [N, m or m/s, or N m, rad or rad/s]; default: unlimited."
    )
    force_range: Interval | None = Field(None, description="Minimum and maximum force [N, or N m]; default: unlimited.")
    native: ActuatorNative | None = Field(None, description="Data that only one format knows.")

    @consistent
    def _gains(self) -> None:
        if (self.kp is not None) != (self.type == "position"):
            what = "needs `kp`" if self.type == "position" else "has no `kp`"
            raise fault("sf107", f"a {self.type} actuator {what}", "" if self.kp is None else "kp")
        if self.kv and self.type == "motor":
            raise fault("sf107", "a motor actuator has no `kv`", "kv")
        if not self.kv and self.type == "velocity":
            raise fault("sf107", "a velocity actuator needs a positive `kv`")
        ends = self.control_range
        if ends is not None and not ends[0] <= self.control <= ends[1]:
            raise fault("sf104", "the initial `control` is outside `control_range`", "control")


SENSED_SITE = ("touch", "accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer", "rangefinder")
SENSED_JOINT = ("joint_position", "joint_velocity")
SENSED_FRAME = ("position", "orientation", "linear_velocity", "angular_velocity")


class SensorSpec(Model):
    """A sensor at a site, a joint or a link."""

    type: Literal[
        "touch", "accelerometer", "velocimeter", "gyro", "force", "torque", "magnetometer", "rangefinder",
        "joint_position", "joint_velocity", "position", "orientation", "linear_velocity", "angular_velocity",
    ] = Field(description="Quantity that the sensor measures.")  # fmt: skip
    site: Name | None = Field(None, description="The site that the sensor is attached to.")
    joint: Name | None = Field(None, description="The joint that the sensor measures.")
    link: Name | None = Field(None, description="The link whose frame the sensor measures.")
    noise: NonNegative = Field(0.0, description="Standard deviation of the noise, in the unit of the quantity.")
    cutoff: NonNegative = Field(0.0, description="Largest magnitude of a measurement; 0 is unlimited.")
    native: SensorNative | None = Field(None, description="Data that only one format knows.")

    @consistent
    def _attached(self) -> None:
        exclusive(self, "site", "joint", "link", needed=True)
        places = (
            ("joint",) if self.type in SENSED_JOINT else ("site", "link") if self.type in SENSED_FRAME else ("site",)
        )
        if all(getattr(self, place) is None for place in places):
            listed = " or ".join(f"`{place}`" for place in places)
            raise fault("sf107", f"a sensor of type `{self.type}` needs {listed}")


class AssetSpec(DocumentSpec):
    """A reusable object with one or more links."""

    simfoundry: Literal["asset/1"] = Field(description="The kind and version of this document.")
    category: Name | None = Field(None, description="Category, such as `drawer_cabinet`.")
    materials: dict[Name, Material] = Field({}, description="Materials for the asset's links, by name.")
    links: dict[Name, LinkSpec] = Field(
        min_length=1, description="Rigid bodies of the asset by name; the first one is the root."
    )
    joints: dict[Name, JointSpec] = Field({}, description="Joints between the links, by name.")
    no_contact: tuple[tuple[Name, Name], ...] = Field(
        (),
        max_length=1000,
        description="Pairs of links that do not collide, in addition to links connected by a joint.",
    )
    sites: dict[Name, SiteSpec] = Field({}, description="Named frames on the links, by name.")
    actuators: dict[Name, ActuatorSpec] = Field({}, description="Actuators of the joints, by name.")
    sensors: dict[Name, SensorSpec] = Field({}, description="Sensors at sites, joints and links, by name.")
    origin: Origin | None = Field(None, description="Origin of the asset.")

    @cached_property
    def single_joints(self) -> dict[str, JointSpec]:
        """All joints by name, with each axis of a joint with several axes as a joint of its own, from the parent on."""
        found: dict[str, JointSpec] = {}
        for name, joint in self.joints.items():
            found |= {axis: joint.single_axis(axis) for axis in joint.axes} if joint.axes else {name: joint}
        return found
