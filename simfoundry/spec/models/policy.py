"""The ``policy/1`` document: a policy server and the conventions that its protocol does not define."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Annotated, Any, Literal

from pydantic import AfterValidator, Field, StringConstraints
from pydantic_core import PydanticCustomError

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import Registry
from simfoundry.spec.models.base import (
    NAME,
    VARIABLE,
    WIRE_KEY,
    DocumentSpec,
    ImageSize,
    Model,
    Name,
    Number,
    Positive,
    consistent,
    fault,
)
from simfoundry.spec.models.signals import ActionSpace

# Key in a message to the policy, such as ``observation/wrist_image_left``.
WireKey = Annotated[str, StringConstraints(pattern=WIRE_KEY, max_length=128)]


def _variable(text: str) -> str:
    """Reject a text that is not a variable name. The error does not quote the text, because it may be a secret key."""
    if re.match(VARIABLE, text) is None or len(text) > 128:
        raise fault("sf104", "expected the name of an environment variable (uppercase), not the key itself")
    return text


# Name of an environment variable; only capitals are allowed, so that a key pasted by accident is rejected.
Variable = Annotated[str, AfterValidator(_variable), Field(json_schema_extra={"pattern": VARIABLE})]

Whole = Annotated[int, Field(ge=0, le=100)]

Reading = Literal["joints", "gripper", "joints_gripper", "hand", "hand_quat", "hand_rotvec", "hand_rot6d", "hand_world"]


# Words of an action space, which policies and datasets write as separate keys.
ActionKindWord = Literal["joint_position", "joint_velocity", "joint_delta", "hand_pose", "hand_delta"]
FrameWord = Annotated[
    Literal["base", "world", "hand"] | None,
    Field(description="Frame of a hand pose or of its change; default: `base`."),
]
RotationWord = Annotated[
    Literal["quat_wxyz", "rotvec", "rpy", "rot6d"] | None,
    Field(
        description="Rotation in a hand pose or its change; default: `quat_wxyz` for `hand_pose`, `rotvec` for "
        "`hand_delta`."
    ),
]
NormalizedFlag = Annotated[
    bool, Field(description="Whether arm values range from -1 to 1, which stand for the limits of the action space.")
]


@dataclass(frozen=True)
class PolicyProtocol:
    """A protocol for policy servers.

    Attributes:
        open: Function that creates a :class:`~simfoundry.evaluate.policies.base.Policy` from a document.
        schemes: Schemes that an address may start with; the first one is the default.
        port: Default port.
        has_path: True if an address may contain a path.
        tells_state: False if the server itself defines the robot state that it receives.
        short_form: Additional keys of the document represented by the short form ``NAME:ADDRESS?…``.
    """

    open: Callable[[PolicySpec], Any]
    schemes: tuple[str, ...]
    port: int
    has_path: bool = True
    tells_state: bool = True
    short_form: Mapping[str, Any] = field(default_factory=dict)


# Registry of policy server protocols by name; each protocol is imported when a document uses it.
PROTOCOLS: Registry[PolicyProtocol] = Registry(
    "simfoundry.policies",
    {
        "openpi": "simfoundry.evaluate.policies.openpi:OPENPI",
        "roboarena": "simfoundry.evaluate.policies.openpi:ROBOARENA",
        "groot": "simfoundry.evaluate.policies.groot:GROOT",
    },
    PolicyProtocol,
)


def _protocol(name: str) -> str:
    if name not in PROTOCOLS:
        expected = " or ".join(f"'{known}'" for known in PROTOCOLS.names())
        raise PydanticCustomError("literal_error", "expected {expected}", {"expected": expected})
    try:
        PROTOCOLS.load(name)
    except SimfoundryError as error:
        raise fault("sf104", str(error)) from None
    return name


# Name of a built-in protocol, or of a protocol provided by an installed package.
ProtocolName = Annotated[
    str,
    StringConstraints(pattern=NAME, max_length=64),
    AfterValidator(_protocol),
    Field(json_schema_extra={"examples": list(PROTOCOLS.built_in)}),
]

_ADDRESS = re.compile(r"(?:([a-z]+)://)?(\[[0-9a-fA-F:.]+\]|[A-Za-z0-9_.-]+)(?::([0-9]{1,5}))?(/[!-~]*)?")


def address_uri(protocol: str, address: str) -> str:
    """Return the full form of an address, such as ``ws://localhost:8000`` for ``localhost``.

    Raises:
        ValueError: If the address is not valid for the protocol.
    """
    found = _ADDRESS.fullmatch(address)
    known = PROTOCOLS.load(protocol)
    schemes = known.schemes
    if found is None:
        raise ValueError(f"`{address}` is not a valid address, such as `{schemes[0]}://localhost:{known.port}`")
    scheme, host, port, path = found.groups()
    if scheme is not None and scheme not in schemes:
        raise ValueError(
            f"an address for {protocol} must start with `{'://` or `'.join(schemes)}://`, not `{scheme}://`"
        )
    if port is not None and not 0 < int(port) < 65536:
        raise ValueError(f"port {port} is invalid; ports range from 1 to 65535")
    if path is not None and not known.has_path:
        raise ValueError(f"an address for {protocol} must not contain a path")
    number = "" if port is None and (scheme == "wss" or path) else f":{port or known.port}"
    return f"{scheme or schemes[0]}://{host}{number}{path or ''}"


class CameraView(Model):
    """An image that the policy gets from a camera in the scene, resized without distortion and padded with black."""

    camera: Name = Field(description="A camera in the scene.")
    size: ImageSize = Field(description="Width and height that the policy expects [px].")
    kind: Literal["image", "depth", "mask"] = Field(
        "image",
        description="Color image, depth [m], or instance mask. Depth and masks are resized to the nearest pixel.",
    )
    render: ImageSize | None = Field(
        None, description="Width and height of the rendered image before resizing [px]; default: `size`."
    )


class GripperConvention(Model):
    """The gripper values that the policy uses, in both observations and actions."""

    open: Number = Field(0.0, description="Value for a fully open gripper.")
    closed: Number = Field(1.0, description="Value for a fully closed gripper.")
    threshold: Number | None = Field(
        None,
        description="Closing fraction, 0 to 1, above which the gripper closes fully; by default, intermediate "
        "positions are used.",
    )

    @consistent
    def _apart(self) -> None:
        if self.open == self.closed:
            raise fault("sf104", "`open` and `closed` must differ", "closed")
        if self.threshold is not None and not 0 < self.threshold < 1:
            raise fault("sf104", "`threshold` must be between 0 and 1", "threshold")


class PolicySpec(DocumentSpec):
    """A policy on a server: its address and the conventions that its protocol does not specify."""

    simfoundry: Literal["policy/1"] = Field(description="The kind and version of this document.")
    protocol: ProtocolName = Field(
        description="Server protocol: `openpi`, `roboarena`, `groot`, or a protocol from an installed package."
    )
    address: Annotated[str, StringConstraints(min_length=1, max_length=300)] = Field(
        description="Server address, such as `localhost:8000`, `wss://policies.example.org` or `tcp://10.0.0.7:5555`."
    )
    action_space: ActionKindWord = Field(
        description="How to interpret the arm values in an action; protocols do not specify this."
    )
    frame: FrameWord = None
    rotation: RotationWord = None
    normalized: NormalizedFlag = False
    control_hz: Positive | None = Field(
        None, le=1000, description="Number of actions per second [Hz]; default: the control frequency of the task."
    )
    velocity_unit: Positive | None = Field(
        None,
        description="Velocity [rad/s or m/s] that corresponds to the value 1, if velocities range from -1 to 1; "
        "DROID uses 3. By default, velocities are in rad/s or m/s.",
    )
    horizon: Annotated[int, Field(ge=1, le=1000)] = Field(
        description="Number of steps of each action chunk to execute before the policy is queried again."
    )
    cameras: dict[WireKey, CameraView] = Field(
        {}, description="Camera views by the key that the policy expects for each image."
    )
    state: dict[WireKey, Reading] | None = Field(
        None, description="Robot state values by the key that the policy expects for each; default: as in DROID."
    )
    gripper: GripperConvention = Field(
        GripperConvention(threshold=0.5), description="Gripper values that the policy uses."
    )
    timeout: Positive = Field(60.0, le=86400, description="Timeout for a response [s].")
    warm_up: Positive = Field(
        600.0,
        le=86400,
        description="Timeout for the first response on a connection [s]; the server may need extra time to compile its "
        "model.",
    )
    retries: Whole = Field(3, description="Maximum number of attempts per rollout to restore a lost connection.")
    api_key: Variable | None = Field(
        None, description="Name of the environment variable that contains the server's API key, not the key itself."
    )

    @property
    def space(self) -> ActionSpace:
        """The full meaning of an action."""
        words = (self.action_space, self.frame, self.rotation, "normalized" if self.normalized else None)
        return ActionSpace.parse(":".join(word for word in words if word is not None))

    @consistent
    def _fits(self) -> None:
        try:
            address_uri(self.protocol, self.address)
        except ValueError as error:
            raise fault("sf104", str(error), "address") from None
        if self.velocity_unit is not None and (self.action_space != "joint_velocity" or self.normalized):
            kind = f"{'normalized ' * self.normalized}{self.action_space}"
            raise fault("sf107", f"`velocity_unit` has no effect on {kind.replace('_', ' ')}s", "velocity_unit")
        for key in ("frame", "rotation"):
            if getattr(self, key) is not None and not self.action_space.startswith("hand"):
                raise fault("sf107", f"`{key}` has no effect on {self.action_space.replace('_', ' ')}s", key)
        if self.frame == "hand" and self.action_space == "hand_pose":
            raise fault(
                "sf104", "a pose of the hand cannot be in the frame of the hand; use `base` or `world`", "frame"
            )
        if self.state is not None and not PROTOCOLS.load(self.protocol).tells_state:
            raise fault("sf107", f"a {self.protocol} server defines its own robot state; remove `state`", "state")
