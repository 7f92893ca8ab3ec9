"""Leader arms of Dynamixel servos, such as GELLO and JoyLo, which are read over a serial line.

Servos speak version 2.0 of their protocol (https://emanual.robotis.com/docs/en/dxl/protocol2/). Each request reads the
present position of all servos, and each servo answers with a status packet:

=======  ==========  =======================================================================
byte     value       meaning
=======  ==========  =======================================================================
0 to 3   FF FF FD 00 header
4        1 to 252    number of the servo
5, 6     8           number of bytes that follow, in little-endian order
7        55          status
8        0           error; the highest bit is an alert, which does not affect the position
9 to 12              present position, int32 in little-endian order, 4096 for each turn
13, 14               CRC-16 of all bytes before it
=======  ==========  =======================================================================

If the bytes after the length contain FF FF FD, another FD follows it.
"""

from __future__ import annotations

import math
import struct
from collections.abc import Mapping

import numpy as np

from simfoundry.teleop.commands import Command
from simfoundry.teleop.device import MAX_NUMBER, InvalidPacketError
from simfoundry.teleop.devices.joints import LeaderDevice
from simfoundry.teleop.leader import LeaderArm

HEADER = b"\xff\xff\xfd\x00"
SYNC_READ, STATUS, BROADCAST = 0x82, 0x55, 0xFE

# Address and size of the present position in the control table of the X series.
PRESENT_POSITION, POSITION_BYTES = 132, 4

# Positions for each turn of the X series.
TURN = 4096

# Largest number of bytes after the length: a status packet has 8, and 9 if it is stuffed; a request for the most servos
# that a line can have, which some adapters return, has 259.
MAX_STATUS, MAX_REQUEST = 32, 259


class DynamixelLeader(LeaderDevice):
    """Leader arms of Dynamixel servos.

    Attributes:
        request: The packet that asks all servos for their positions.
    """

    def __init__(self, joints: Mapping[str, int], arms: Mapping[str, LeaderArm]) -> None:
        """Read leader arms, keyed by the robot that each of them moves, whose number of joints is in ``joints``."""
        super().__init__(joints)
        self._arms = arms
        self._owner = {servo: robot for robot, arm in arms.items() for servo in arm.servos}
        self._angles: dict[str, dict[int, float]] = {robot: {} for robot in arms}
        self._rest = b""
        self.request = sync_read(tuple(self._owner))

    def packets(self, data: bytes) -> list[bytes]:
        """Return the complete packets with a correct check sum."""
        found, rest = [], self._rest + data
        while (start := rest.find(HEADER)) >= 0:
            if rest[:start].strip(b"\x00"):  # a line that idles low reads as zeros
                self.refuse("there are bytes between packets")
            rest = rest[start:]
            if len(rest) < 7:
                break
            length = int.from_bytes(rest[5:7], "little")
            end = 7 + length
            if 3 <= length <= (MAX_REQUEST if rest[4] == BROADCAST else MAX_STATUS):
                if len(rest) < end:
                    break
                if crc16(rest[: end - 2]) == int.from_bytes(rest[end - 2 : end], "little"):
                    found.append(rest[:end])
                    rest = rest[end:]
                    continue
                self.refuse("its check sum is wrong")
            else:
                self.refuse("its length is not that of a status packet")
            rest = rest[len(HEADER) :]  # the next packet may begin within a damaged one
        if HEADER not in rest:
            if rest[: 1 - len(HEADER)].strip(b"\x00"):
                self.refuse("there are bytes between packets")
            rest = rest[1 - len(HEADER) :]
        self._rest = rest
        return found

    def parse(self, packet: bytes, time: float) -> list[Command]:
        """Return the targets of an arm, once all of its servos have answered."""
        servo, content = packet[4], packet[7:-2].replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")
        if servo == BROADCAST or content[0] != STATUS:
            return []  # some adapters return the requests that are sent
        if len(content) < 2 or content[1] & 0x7F:
            raise InvalidPacketError("a servo reports an error")
        if len(content) != 2 + POSITION_BYTES or servo not in self._owner:
            raise InvalidPacketError("it is not the position of a servo of the leader")
        angle = struct.unpack("<i", content[2:])[0] / TURN * 2 * math.pi
        if abs(angle) > MAX_NUMBER:
            raise InvalidPacketError("the position is farther than a servo turns")
        robot = self._owner[servo]
        angles, arm = self._angles[robot], self._arms[robot]
        angles[servo] = angle
        if len(angles) < len(arm.servos):
            return []
        self._angles[robot] = {}
        positions = np.array([angles[servo] for servo in arm.ids])
        gripper = arm.gripper.share(angles[arm.gripper.id]) if arm.gripper is not None else None
        return self.targets(robot, np.array(arm.signs) * (positions - np.array(arm.offsets)), gripper, time)

    def is_sign_of_life(self, commands: list[Command]) -> bool:
        """A leader works while all of its servos answer."""
        return bool(commands)


def _table() -> tuple[int, ...]:
    values = []
    for k in range(256):
        crc = k << 8
        for _ in range(8):
            crc = (crc << 1) ^ 0x8005 if crc & 0x8000 else crc << 1
        values.append(crc & 0xFFFF)
    return tuple(values)


_CRC = _table()


def crc16(data: bytes) -> int:
    """Return the check sum of a packet: CRC-16 with the polynomial 0x8005, from 0, most significant bit first."""
    crc = 0
    for byte in data:
        crc = ((crc << 8) & 0xFFFF) ^ _CRC[(crc >> 8) ^ byte]
    return crc


def _packet(servo: int, content: bytes) -> bytes:
    stuffed = content.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")
    head = HEADER + struct.pack("<BH", servo, len(stuffed) + 2) + stuffed
    return head + struct.pack("<H", crc16(head))


def sync_read(servos: tuple[int, ...]) -> bytes:
    """Return the request for the positions of servos."""
    return _packet(BROADCAST, struct.pack("<BHH", SYNC_READ, PRESENT_POSITION, POSITION_BYTES) + bytes(servos))


def status_packet(servo: int, position: int, error: int = 0) -> bytes:
    """Return the answer of a servo at a position [1/4096 turns]."""
    return _packet(servo, struct.pack("<BBi", STATUS, error, position))
