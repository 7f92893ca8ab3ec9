"""The vocabulary of actions and observations.

Gymnasium environments, policies, recordings and demonstrations all use these definitions, and the tables in
``docs/signals.md`` are generated from them.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import ClassVar

from simfoundry.spec.diagnostics import nearest


class ActionKind(StrEnum):
    """The quantity that the arm values of an action specify."""

    JOINT_POSITION = "joint_position"
    JOINT_VELOCITY = "joint_velocity"
    JOINT_DELTA = "joint_delta"
    HAND_POSE = "hand_pose"
    HAND_DELTA = "hand_delta"


class HandFrame(StrEnum):
    """The frame in which a hand pose or its change is expressed."""

    BASE = "base"
    WORLD = "world"
    HAND = "hand"


class RotationForm(StrEnum):
    """The representation of a rotation."""

    QUAT_WXYZ = "quat_wxyz"
    ROTVEC = "rotvec"
    RPY = "rpy"
    ROT6D = "rot6d"


# The components of each representation, in order.
ROTATION_ORDER: Mapping[RotationForm, tuple[str, ...]] = {
    RotationForm.QUAT_WXYZ: ("qw", "qx", "qy", "qz"),
    RotationForm.ROTVEC: ("rx", "ry", "rz"),
    RotationForm.RPY: ("roll", "pitch", "yaw"),
    RotationForm.ROT6D: ("r11", "r12", "r13", "r21", "r22", "r23"),
}

# The meaning of each representation. ``rot6d`` lists rows, as in pytorch3d and GR00T.
ROTATIONS: Mapping[RotationForm, str] = {
    RotationForm.QUAT_WXYZ: "unit quaternion with the scalar first; other lengths are normalized",
    RotationForm.ROTVEC: "rotation axis times the angle [rad]",
    RotationForm.RPY: "roll, pitch and yaw about fixed axes [rad], as in URDF",
    RotationForm.ROT6D: "first two rows of the rotation matrix; they are orthonormalized",
}


@dataclass(frozen=True)
class Signal:
    """A quantity that a policy sends or receives.

    Attributes:
        name: The name of the entry.
        meaning: The meaning, as a phrase for documentation.
        shape: The shape of the array, in terms of the scene.
        order: The order of the values.
        unit: The unit of the values.
        frame: The frame of the values, or an empty string if they have none.
        dtype: The NumPy type.
        limits: The range of the values in words.
    """

    name: str
    meaning: str
    shape: str
    order: str
    unit: str
    frame: str
    dtype: str
    limits: str


# Maximum joint velocity in an action [rad/s or m/s]: DROID's 0.2 rad per step at 15 Hz.
MAX_VELOCITY = 3.0

# Maximum change of a joint target in one action [rad or m]: DROID's largest step.
MAX_JOINT_DELTA = 0.2

# Maximum change of a hand target in one action [m, rad]: the output limits of robosuite's OSC_POSE controller.
MAX_TRANSLATION, MAX_ROTATION = 0.05, 0.5

_JOINTS = "the arm's joints, from the base"
_HAND_SHAPE = "(3 + rotation,)"
_HAND_ORDER = "x, y, z, rotation"

# The arm values of an action, by kind. Each robot's gripper value follows them.
ACTIONS: Mapping[ActionKind, Signal] = {
    ActionKind.JOINT_POSITION: Signal(
        "joint_position", "targets of the joints", "(joints,)", _JOINTS, "rad or m", "", "float32",
        "limits of the joint",
    ),
    ActionKind.JOINT_VELOCITY: Signal(
        "joint_velocity", "velocities at which the targets of the joints move", "(joints,)", _JOINTS, "rad/s or m/s",
        "", "float32", f"±{MAX_VELOCITY:g}",
    ),
    ActionKind.JOINT_DELTA: Signal(
        "joint_delta", "changes of the targets of the joints", "(joints,)", _JOINTS, "rad or m", "", "float32",
        f"±{MAX_JOINT_DELTA:g}",
    ),
    ActionKind.HAND_POSE: Signal(
        "hand_pose", "target pose of the hand", _HAND_SHAPE, _HAND_ORDER, "m, rotation", "base (default) or world",
        "float32", "reach of the robot; range of the rotation",
    ),
    ActionKind.HAND_DELTA: Signal(
        "hand_delta", "change of the target pose of the hand", _HAND_SHAPE, _HAND_ORDER, "m, rotation",
        "axes of base (default), world or hand; rotations are about the hand's origin", "float32",
        f"±{MAX_TRANSLATION:g} m, ±{MAX_ROTATION:g} rad",
    ),
}  # fmt: skip

GRIPPER = Signal(
    "gripper",
    "target of the gripper",
    "(1,)",
    "after the values of the arm",
    "0 open, 1 closed",
    "",
    "float32",
    "0 to 1",
)

# What policies and environments observe. Names of robots and cameras precede or follow the entry's name.
OBSERVATIONS: Mapping[str, Signal] = {signal.name: signal for signal in (
    Signal("ROBOT/joints", "positions of the arm's joints", "(joints,)", _JOINTS, "rad or m", "", "float32",
           "limits of the joint, which engines exceed slightly"),
    Signal("ROBOT/gripper", "opening of the gripper", "(1,)", "", "0 open, 1 closed", "", "float32", "0 to 1"),
    Signal("ROBOT/hand", "pose of the hand", "(7,)", "x, y, z, qw, qx, qy, qz", "m, quaternion", "world", "float32",
           ""),
    Signal("objects", "poses of the objects", "(objects, 7)", "objects of the scene; x, y, z, qw, qx, qy, qz",
           "m, quaternion", "world", "float32", ""),
    Signal("joints", "positions of the objects' joints", "(joints,)", "joints of the objects of the scene", "rad or m",
           "", "float32", ""),
    Signal("image/CAMERA", "color image", "(height, width, 3)", "rows from the top; red, green, blue", "sRGB", "camera",
           "uint8", "0 to 255"),
    Signal("depth/CAMERA", "depth along the optical axis", "(height, width)", "rows from the top", "m", "camera",
           "float32", "0 where nothing is visible"),
    Signal("mask/CAMERA", "visible instance", "(height, width)", "rows from the top",
           "index in the scene's objects, followed by its robots, plus 1", "camera", "int32",
           "0 where nothing is visible"),
)}  # fmt: skip


class ImageKind(StrEnum):
    """A kind of camera image."""

    COLOR = "image"
    DEPTH = "depth"
    MASK = "mask"


@dataclass(frozen=True)
class ActionSpace:
    """The meaning of the numbers in an action.

    An action lists, for each robot in the order of the task, the values for the arm and then the gripper target, from 0
    (open) to 1 (closed). Protocols do not transmit the meaning, so each policy has to declare it.

    The text form is the kind, followed by words for the frame, the rotation and normalization where they differ from
    the default, such as ``joint_position``, ``hand_delta:hand:rpy`` or ``joint_delta:normalized``.

    Attributes:
        kind: The quantity.
        frame: The frame of a hand pose or of its change.
        rotation: The representation of rotations in a hand pose or its change.
        normalized: True if all values range from -1 to 1, which stand for the limits in :data:`ACTIONS`.
    """

    kind: ActionKind
    frame: HandFrame = HandFrame.BASE
    rotation: RotationForm = RotationForm.QUAT_WXYZ
    normalized: bool = False

    JOINT_POSITION: ClassVar[ActionSpace]
    JOINT_VELOCITY: ClassVar[ActionSpace]
    JOINT_DELTA: ClassVar[ActionSpace]

    @classmethod
    def parse(cls, text: object) -> ActionSpace:
        """Parse the text form.

        Raises:
            ValueError: If the text does not name an action space. The message lists the valid words.
        """
        if isinstance(text, ActionSpace):
            return text
        head, *words = str(text).split(":")
        if head not in list(ActionKind):
            known = ", ".join(ActionKind)
            raise ValueError(f"unknown action space `{str(text)[:60]}`; available: {known}")
        kind = ActionKind(head)
        space = cls(kind, rotation=_DEFAULT_ROTATION.get(kind, RotationForm.QUAT_WXYZ))
        for word in words:
            space = space._with(word, str(text))
        if len(set(map(_role, words))) < len(words):
            raise ValueError(f"action space `{text}` states the same property twice")
        return space

    def _with(self, word: str, text: str) -> ActionSpace:
        allowed = [*self._frames, *(RotationForm if self.of_hand else ()), "normalized"]
        if word not in allowed:
            hint = nearest(word, allowed) or f"available: {', '.join(allowed)}"
            raise ValueError(f"`{word[:40]}` in action space `{text[:60]}` does not apply to {self.kind}; {hint}")
        if word == "normalized":
            return replace(self, normalized=True)
        if word in list(RotationForm):
            return replace(self, rotation=RotationForm(word))
        return replace(self, frame=HandFrame(word))

    @property
    def _frames(self) -> tuple[HandFrame, ...]:
        if not self.of_hand:
            return ()
        both = (HandFrame.BASE, HandFrame.WORLD)
        return both if self.kind is ActionKind.HAND_POSE else (*both, HandFrame.HAND)

    @property
    def of_hand(self) -> bool:
        """True if the arm values describe the hand rather than the joints."""
        return self.kind in (ActionKind.HAND_POSE, ActionKind.HAND_DELTA)

    @property
    def is_relative(self) -> bool:
        """True if an action specifies a motion, so that no motion is an action of its own."""
        return self.kind in (ActionKind.JOINT_VELOCITY, ActionKind.JOINT_DELTA, ActionKind.HAND_DELTA)

    def arm_size(self, joints: int) -> int:
        """Return the number of arm values for an arm with ``joints`` joints."""
        return 3 + len(ROTATION_ORDER[self.rotation]) if self.of_hand else joints

    def column(self, index: int, joints: int) -> str:
        """Return the name of one value of a robot with ``joints`` joints, such as `joint 2` or `hand qw`."""
        if index == self.arm_size(joints):
            return "gripper"
        if not self.of_hand:
            return f"joint {index + 1}"
        return f"hand {(*'xyz', *ROTATION_ORDER[self.rotation])[index]}"

    def rotation_limits(self) -> list[tuple[float, float]]:
        """Return the range of each rotation value, for which there are 3, 4 or 6."""
        count = len(ROTATION_ORDER[self.rotation])
        if self.rotation in (RotationForm.QUAT_WXYZ, RotationForm.ROT6D):
            return [(-1.0, 1.0)] * count
        most = MAX_ROTATION if self.kind is ActionKind.HAND_DELTA else math.pi
        return [(-most, most)] * count

    def __str__(self) -> str:
        words = [str(self.kind)]
        if self.frame is not HandFrame.BASE:
            words.append(self.frame)
        if self.of_hand and self.rotation is not _DEFAULT_ROTATION[self.kind]:
            words.append(self.rotation)
        return ":".join([*words, *(["normalized"] if self.normalized else [])])


_DEFAULT_ROTATION = {
    ActionKind.HAND_POSE: RotationForm.QUAT_WXYZ,
    ActionKind.HAND_DELTA: RotationForm.ROTVEC,
}

ActionSpace.JOINT_POSITION = ActionSpace(ActionKind.JOINT_POSITION)
ActionSpace.JOINT_VELOCITY = ActionSpace(ActionKind.JOINT_VELOCITY)
ActionSpace.JOINT_DELTA = ActionSpace(ActionKind.JOINT_DELTA)


def _role(word: str) -> str:
    """Return the property that a word specifies."""
    return "rotation" if word in list(RotationForm) else "frame" if word in list(HandFrame) else word


# The poses of the hand that a policy server may receive, by the name of the reading in a policy document.
HAND_READINGS: Mapping[str, tuple[HandFrame, RotationForm]] = {
    "hand": (HandFrame.BASE, RotationForm.RPY),
    "hand_quat": (HandFrame.BASE, RotationForm.QUAT_WXYZ),
    "hand_rotvec": (HandFrame.BASE, RotationForm.ROTVEC),
    "hand_rot6d": (HandFrame.BASE, RotationForm.ROT6D),
    "hand_world": (HandFrame.WORLD, RotationForm.QUAT_WXYZ),
}
