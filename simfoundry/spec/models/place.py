"""Placement constraints: on the desk, left of the plate, inside the bowl."""

from typing import Annotated, Self

from pydantic import Field, model_validator
from pydantic_core import PydanticCustomError

from simfoundry.spec.models.base import (
    FARTHEST,
    FormerKey,
    Model,
    Name,
    NonNegative,
    Number,
    PartName,
    Point2,
    Vec3,
    exclusive,
)

SIDES = ("left_of", "right_of")
DEPTHS = ("in_front_of", "behind")


class Place(Model):
    """A pose to be solved: the support and the position on it; the object is dropped onto the shapes below it.

    Left, right, front and behind are seen from the scene's viewpoint. Without `xy`, `local_xy` or one of these four,
    the object is at the center of its support. With one of the four, it is aligned with the center of its anchor in
    the other direction.
    """

    on: PartName | None = Field(None, description="Support: an object, or one of its links (`shelf.board`).")
    inside: PartName | None = Field(
        None, description="Container: an object with a cavity, or one of its links (`cabinet.drawer`)."
    )
    xy: Point2 | None = Field(None, description="Position of its frame in the world [m].")
    local_xy: Annotated[Point2 | None, FormerKey("at")] = Field(
        None, description="Position of its frame in the frame of its support [m]."
    )
    left_of: Name | None = Field(None, description="Object to the right of it.")
    right_of: Name | None = Field(None, description="Object to the left of it.")
    in_front_of: Name | None = Field(None, description="Object behind it, farther from the viewer.")
    behind: Name | None = Field(None, description="Object in front of it, nearer to the viewer.")
    gap: NonNegative = Field(0.03, le=FARTHEST, description="Gap to the object beside it [m].")
    yaw_deg: Number | None = Field(None, description="Rotation about z [deg].")
    rpy_deg: Vec3 | None = Field(
        None, description="Roll, pitch, yaw about fixed x, y, z [deg]: Rz(yaw) Ry(pitch) Rx(roll)."
    )

    @model_validator(mode="after")
    def _consistent(self) -> Self:
        exclusive(self, "on", "inside", needed=True)
        exclusive(self, "yaw_deg", "rpy_deg")
        exclusive(self, *SIDES)
        exclusive(self, *DEPTHS)
        beside = next((n for n in (*SIDES, *DEPTHS) if getattr(self, n) is not None), None)
        exclusive(self, "xy", "local_xy", *([beside] if beside else []))
        if beside is None and self.gap != Place.model_fields["gap"].default:
            raise PydanticCustomError("sf107", "`gap` is for left_of, right_of, in_front_of and behind", {"at": "gap"})
        return self
