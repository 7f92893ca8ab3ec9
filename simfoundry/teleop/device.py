"""The contract of devices: they turn packets into commands, and refuse packets that cannot be meant."""

from __future__ import annotations

import json
import math
from abc import ABC, abstractmethod
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.spec.models.signals import ActionSpace
from simfoundry.teleop.commands import Command

# Largest packet [bytes]. Two tracked controllers take 500 bytes.
MAX_PACKET = 4096

# Largest number in a packet [m or rad]; robots on tables are far smaller, and larger numbers lose precision.
MAX_NUMBER = 1e3


class InvalidPacketError(ValueError):
    """Raised for a packet that a device refuses. The text completes the sentence "a packet was refused: …"."""


class TeleopDevice(ABC):
    """A device. It keeps the state of its keys and axes, and does not know how its packets arrive.

    Attributes:
        name: The name of the device, as in ``--device``.
        title: What people call it.
        space: The meaning of the actions that its commands lead to.
        refused: The number of refused packets, by reason.
        last_refusal: The reason of the last refusal, or an empty string after an accepted packet.
        heard_at: The time of the last packet that shows that the device works [s], or None.
    """

    name: str
    title: str
    space: ActionSpace

    def __init__(self) -> None:
        self.refused: Counter[str] = Counter()
        self.last_refusal = ""
        self.heard_at: float | None = None

    @property
    def silence_s(self) -> float | None:
        """The longest time between two packets of a working device [s], or None if it may be silent."""
        return None

    def feed(self, data: bytes, time: float) -> list[Command]:
        """Return the commands in data that arrived at a time [s]. Invalid packets are counted, and have none."""
        commands: list[Command] = []
        for packet in self.packets(data):
            try:
                found = self.parse(packet, time)
            except InvalidPacketError as error:
                self.refuse(str(error))
                continue
            if self.is_sign_of_life(found):
                self.heard_at, self.last_refusal = time, ""
            commands += found
        return commands

    def refuse(self, reason: str) -> None:
        """Count a refused packet."""
        self.refused[reason] += 1
        self.last_refusal = reason

    def is_sign_of_life(self, commands: list[Command]) -> bool:
        """Return True if a valid packet with these commands shows that the device works."""
        return True

    def packets(self, data: bytes) -> Iterable[bytes]:
        """Return the packets that the data completes. By default, data are one packet."""
        return (data,)

    @abstractmethod
    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the commands in a packet.

        Raises:
            InvalidPacketError: If the packet is not valid.
        """

    @abstractmethod
    def release(self) -> list[Command]:
        """Return the commands for a device that is lost: nothing moves until it is back."""


def json_object(packet: bytes) -> dict[str, Any]:
    """Return the JSON object in a packet.

    Raises:
        InvalidPacketError: If there is none.
    """
    if len(packet) > MAX_PACKET:
        raise InvalidPacketError(f"it is longer than {MAX_PACKET} bytes")
    try:
        found = json.loads(packet)
    except (ValueError, RecursionError):
        raise InvalidPacketError("it is not JSON") from None
    if not isinstance(found, dict):
        raise InvalidPacketError("it is not a JSON object")
    return found


def number(value: object, name: str) -> float:
    """Return a finite number of a packet.

    Raises:
        InvalidPacketError: If the value is something else.
    """
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise InvalidPacketError(f"`{name}` is not a number")
    if abs(value) > MAX_NUMBER or not math.isfinite(value):
        raise InvalidPacketError(f"`{name}` is not a number between -{MAX_NUMBER:g} and {MAX_NUMBER:g}")
    return float(value)


def numbers(value: object, name: str, count: int) -> Array:
    """Return finite numbers of a packet, shape (count,).

    Raises:
        InvalidPacketError: If the value is something else.
    """
    if not isinstance(value, list) or len(value) != count:
        length = f"has {len(value)} numbers" if isinstance(value, list) else "is not a list"
        raise InvalidPacketError(f"`{name}` {length} instead of {count}")
    return np.array([number(each, name) for each in value])


class JumpFilter:
    """A filter for positions that jump farther than a person can move, which glitches of sensors cause.

    A device that is really elsewhere, such as after a cable was plugged in again, is believed once several packets in a
    row agree.
    """

    # Number of refused packets in a row, all close to each other, after which they are believed.
    PATIENCE = 5

    # Time after which the position can be anywhere [s].
    FORGET_S = 0.5

    def __init__(self, limits: Sequence[float] | float) -> None:
        """Accept changes up to the limits between two packets, in the unit of the values."""
        self._limits = np.asarray(limits, dtype=np.float64)
        self._accepted: tuple[float, Array] | None = None
        self._refused: list[Array] = []

    def check(self, values: Array, time: float) -> None:
        """Accept values, or refuse them.

        Raises:
            InvalidPacketError: If they jump.
        """
        if self._accepted is not None:
            before, last = self._accepted
            is_near = bool((np.abs(values - last) <= self._limits).all())
            if not is_near and time - before <= self.FORGET_S:
                self._refuse(values)
        self._accepted, self._refused = (time, values), []

    def _refuse(self, values: Array) -> None:
        agree = not self._refused or bool((np.abs(values - self._refused[-1]) <= self._limits).all())
        self._refused = [*self._refused, values] if agree else [values]
        if len(self._refused) < self.PATIENCE:
            raise InvalidPacketError("it jumps farther than a person moves")

    def forget(self) -> None:
        """Accept any position next."""
        self._accepted, self._refused = None, []


class LineSplitter:
    """A splitter of a byte stream into lines, which never holds more than one packet."""

    def __init__(self, refuse: Callable[[str], object]) -> None:
        """Report lines that are too long to a function."""
        self._refuse, self._rest, self._is_skipping = refuse, b"", False

    def lines(self, data: bytes) -> list[bytes]:
        """Return the lines that the data completes, without empty ones."""
        *done, rest = (self._rest + data).split(b"\n")
        if self._is_skipping and done:
            done, self._is_skipping = done[1:], False
        if self._is_skipping:
            rest = b""
        elif len(rest) > MAX_PACKET:
            self._refuse(f"it is longer than {MAX_PACKET} bytes")
            rest, self._is_skipping = b"", True
        self._rest = rest
        return [line for line in done if line.strip()]
