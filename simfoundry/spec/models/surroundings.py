"""Cameras, lights and the background of a scene."""

import math
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from simfoundry.spec.models.base import (
    COLOR,
    CameraPose,
    Color,
    FileName,
    ImageSize,
    Model,
    NonNegative,
    PartName,
    Point3,
    PoseSpec,
    Positive,
    Vec3,
    consistent,
    exclusive,
    fault,
)
from simfoundry.spec.models.capture import FocalLength, ImagePoint

if TYPE_CHECKING:
    pass


# Widest and narrowest field of view [deg]; at 179 degrees, the focal length is 1 % of half the image height.
FieldOfView = Annotated[float, Field(ge=0.01, le=179, allow_inf_nan=False)]


class CameraSpec(Model):
    """A pinhole camera."""

    size: ImageSize = Field(description="Width and height of the image [px].")
    fov_deg: FieldOfView | None = Field(
        None,
        description="Vertical field of view [deg], as `fovy` in MuJoCo; the pixels are square. Replaces `fx` and `fy`.",
    )
    fx: FocalLength | None = Field(None, description="Focal length in x [px].")
    fy: FocalLength | None = Field(None, description="Focal length in y [px].")
    cx: ImagePoint | None = Field(None, description="Principal point in x [px]; default: (width - 1) / 2, the center.")
    cy: ImagePoint | None = Field(None, description="Principal point in y [px]; default: (height - 1) / 2, the center.")
    pose: CameraPose = Field(description="Pose in the world, or in the mount's frame if `mount` is set.")
    mount: PartName | None = Field(
        None,
        description="Frame that the camera is attached to: a robot link (`arm.hand`), an object, or an object's link.",
    )

    @consistent
    def _one_lens(self) -> None:
        exclusive(self, "fov_deg", "fx", needed=True)
        exclusive(self, "fov_deg", "fy", needed=True)

    @property
    def focal_lengths(self) -> tuple[float, float]:
        """The focal lengths in x and y [px]."""
        if self.fx is not None and self.fy is not None:
            return self.fx, self.fy
        assert self.fov_deg is not None
        focal = self.size[1] / 2 / math.tan(math.radians(self.fov_deg) / 2)
        return focal, focal


# Greatest relative intensity of a light, below which simulators can store it in single precision.
MAX_INTENSITY = 1e6


class LightSpec(Model):
    """A light source."""

    type: Literal["distant", "point", "dome"] = Field(description="Kind of light: parallel rays, a point, or a dome.")
    intensity: NonNegative = Field(
        1.0,
        le=MAX_INTENSITY,
        description="Relative intensity; 1 fully lights a white surface that faces the light.",
    )
    color: Color = Field((1.0, 1.0, 1.0), description=COLOR.format(""))
    direction: Vec3 = Field((0.0, 0.0, -1.0), description="Direction in which the rays of a distant light travel.")
    xyz: Point3 = Field((0.0, 0.0, 2.0), description="Position of a point light [m].")
    texture: FileName | None = Field(
        None,
        description="Panorama around a dome light (.hdr, .exr, .png, .jpg), relative to this document: an "
        "equirectangular image whose center is in the direction of x and whose top is in that of z of `frame`. `color` "
        "tints it.",
    )
    frame: PartName | None = Field(
        None, description="Frame of the position or direction: a name from `frames`; default: the world."
    )

    @consistent
    def _shines_somewhere(self) -> None:
        if self.texture is not None and self.type != "dome":
            raise fault("sf107", f"`texture` applies only to dome lights, but this light is {self.type}", "texture")
        if math.hypot(*self.direction) < 1e-6:
            raise fault("sf104", "`direction` must not be zero", "direction")


class BackgroundSpec(Model):
    """The visual surroundings of the scene. Nothing collides with them."""

    mesh: FileName | None = Field(None, description="A mesh (.glb, .obj, .stl, .ply), relative to this document.")
    splat: FileName | None = Field(
        None, description="A 3D Gaussian splat (.ply, .spz, .glb, .usd), relative to this document."
    )
    pose: PoseSpec = Field(PoseSpec.model_construct(), description="Pose in the world.")
    scale: Positive = Field(1.0, description="Length of one unit in the file [m].")

    @consistent
    def _one_file(self) -> None:
        exclusive(self, "mesh", "splat", needed=True)
