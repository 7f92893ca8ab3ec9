"""The ``asset/1`` document: an object with links, parts, and joints, for use in scenes."""

import math
from functools import cached_property
from typing import Literal

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
    Point3,
    PoseSpec,
    Positive,
    Scale,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.joint import (
    JointSpec,
)
from simfoundry.spec.models.native import ActuatorNative, LinkNative, PartNative, SensorNative, SiteNative
from simfoundry.spec.models.origin import Origin
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
