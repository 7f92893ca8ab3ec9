"""Descriptions of leader arms: which servos they have, and how their positions become those of a robot's joints."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path

from pydantic import BaseModel, ConfigDict, Field, ValidationError, model_validator

from simfoundry.errors import SimfoundryError
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse

# Largest size of a description to read [bytes]; one of two arms takes 500.
MAX_BYTES = 2**16

# The numbers that servos can have (Dynamixel protocol 2.0).
MIN_ID, MAX_ID = 1, 252


class _Strict(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)


class LeaderGripper(_Strict):
    """The servo of a gripper, with its angle when the gripper is open and closed [deg]."""

    id: int = Field(ge=MIN_ID, le=MAX_ID)
    open_deg: float
    closed_deg: float

    def share(self, angle: float) -> float:
        """Return the position from 0 (open) to 1 (closed) for an angle of the servo [rad]."""
        return (math.degrees(angle) - self.open_deg) / (self.closed_deg - self.open_deg)

    @model_validator(mode="after")
    def _differ(self) -> LeaderGripper:
        if self.open_deg == self.closed_deg:
            raise ValueError("`open_deg` and `closed_deg` must differ")
        return self


class LeaderArm(_Strict):
    """The servos of a leader arm.

    The position of a joint is ``sign * (angle of the servo - offset)`` [rad], as in GELLO.

    Attributes:
        ids: The numbers of the servos, in the order of the robot's joints from the base.
        signs: 1 or -1 for each joint.
        offsets: The angle of each servo at which the joint is at 0 [rad].
        gripper: The servo of the gripper, if there is one.
    """

    ids: tuple[int, ...] = Field(min_length=1, max_length=32)
    signs: tuple[int, ...] = ()
    offsets: tuple[float, ...] = ()
    gripper: LeaderGripper | None = None

    @property
    def servos(self) -> tuple[int, ...]:
        """The numbers of all servos."""
        return (*self.ids, *(() if self.gripper is None else (self.gripper.id,)))

    @model_validator(mode="before")
    @classmethod
    def _defaults(cls, data: object) -> object:
        if isinstance(data, dict) and isinstance(data.get("ids"), list | tuple):
            count = len(data["ids"])
            return {"signs": [1] * count, "offsets": [0.0] * count, **data}
        return data

    @model_validator(mode="after")
    def _fit(self) -> LeaderArm:
        for name, values in (("signs", self.signs), ("offsets", self.offsets)):
            if len(values) != len(self.ids):
                raise ValueError(f"`{name}` has {len(values)} values for {len(self.ids)} servos")
        if any(sign not in (1, -1) for sign in self.signs):
            raise ValueError("`signs` must be 1 or -1")
        if len(set(self.servos)) < len(self.servos) or not all(MIN_ID <= each <= MAX_ID for each in self.ids):
            raise ValueError(f"the numbers of servos must differ, and lie between {MIN_ID} and {MAX_ID}")
        return self


class LeaderSpec(_Strict):
    """The leader arms on one line.

    Attributes:
        baud: The speed of the serial line [bit/s].
        arms: Each leader arm, keyed by the robot that it moves.
    """

    baud: int = 57600
    arms: dict[str, LeaderArm] = Field(min_length=1)


def load_leader(path: Path, joints: Mapping[str, int]) -> LeaderSpec:
    """Read the description of leader arms.

    Args:
        path: The file.
        joints: The number of joints of each robot of the task.

    Raises:
        SimfoundryError: If the file is not valid, or if it does not fit the robots.
    """
    try:
        if path.stat().st_size > MAX_BYTES:
            raise SimfoundryError(f"{path} is larger than {MAX_BYTES} bytes; is it the description of a leader arm?")
        spec = LeaderSpec.model_validate(parse(path.read_text(encoding="utf-8")).data)
    except ValidationError as error:
        first = error.errors()[0]
        at = ".".join(map(str, first["loc"]))
        text = str(first["msg"]).removeprefix("Value error, ")
        raise SimfoundryError(f"{path} does not describe leader arms: {f'`{at}`: ' if at else ''}{text}") from None
    except (OSError, ValueError, YamlError) as error:
        raise SimfoundryError(f"{path} does not describe leader arms: {error}") from None
    check_leader(spec, joints, str(path))
    return spec


def check_leader(spec: LeaderSpec, joints: Mapping[str, int], where: str) -> None:
    """Check that leader arms fit the robots of a task.

    Args:
        spec: The leader arms.
        joints: The number of joints of each robot of the task.
        where: The file that describes them.

    Raises:
        SimfoundryError: If they do not fit.
    """
    servos = [servo for arm in spec.arms.values() for servo in arm.servos]
    if len(set(servos)) < len(servos):
        raise SimfoundryError(f"{where} lists a servo for two arms; servos on one line must have different numbers")
    for robot, arm in spec.arms.items():
        if robot not in joints:
            raise SimfoundryError(f"{where} describes a leader of `{robot}`; the task has {', '.join(joints)}")
        if len(arm.ids) != joints[robot]:
            raise SimfoundryError(
                f"{where} lists {len(arm.ids)} servos for `{robot}`, which has {joints[robot]} joints"
            )
