"""Devices that are files on Linux: SpaceMice (hidraw) and serial lines."""

from __future__ import annotations

import errno
import os
import termios
import tty
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.teleop.links.link import Channel, FileChannel

# Vendors of SpaceMice: Logitech for those before 2013, and 3Dconnexion. The former also makes other mice, so its
# products are listed (libspnav and spacenavd).
VENDORS = {
    0x256F: None,
    0x046D: (0xC603, 0xC605, 0xC606, 0xC621, 0xC623, 0xC625, 0xC626, 0xC627, 0xC628, 0xC629, 0xC62B),
}

HIDRAW = Path("/sys/class/hidraw")


def find_space_mouse(folder: Path = HIDRAW) -> Path:
    """Return the file of the first SpaceMouse.

    Raises:
        OSError: If there is none.
    """
    for device in sorted(folder.glob("hidraw*"), key=lambda path: (len(path.name), path.name)):
        try:
            lines = (device / "device" / "uevent").read_text(encoding="utf-8", errors="replace").splitlines()
        except OSError:
            continue
        ids = next((line.partition("=")[2].split(":") for line in lines if line.startswith("HID_ID=")), [])
        if len(ids) == 3 and _is_space_mouse(int(ids[1], 16), int(ids[2], 16)):
            return Path("/dev") / device.name
    raise OSError(errno.ENODEV, "no SpaceMouse is plugged in")


def _is_space_mouse(vendor: int, product: int) -> bool:
    products = VENDORS.get(vendor, ())
    return products is None or product in products


def open_hid(path: Path | None) -> Channel:
    """Open a SpaceMouse; by default, the first one.

    Raises:
        OSError: If it cannot be opened. Without permission, the message says how to get it.
    """
    path = path or find_space_mouse()
    try:
        return FileChannel(os.open(path, os.O_RDONLY | os.O_NONBLOCK))
    except PermissionError:
        rule = 'KERNEL=="hidraw*", ATTRS{idVendor}=="256f", MODE="0660", TAG+="uaccess"'
        hint = (
            f"no permission for {path}; write `{rule}` to /etc/udev/rules.d/90-spacemouse.rules, and plug it in again"
        )
        raise OSError(errno.EACCES, hint) from None


def baud_constant(baud: int) -> int:
    """Return the constant of a speed [bit/s].

    Raises:
        SimfoundryError: If the system does not know it.
    """
    known = {
        int(name[1:]): int(value) for name, value in vars(termios).items() if name[:1] == "B" and name[1:].isdigit()
    }
    if not baud or baud not in known:
        speeds = ", ".join(str(speed) for speed in sorted(known) if speed >= 9600)
        raise SimfoundryError(f"a serial line cannot have {baud} bit/s; known speeds: {speeds}")
    return known[baud]


def open_serial(path: Path, baud: int) -> Channel:
    """Open a serial line with 8 data bits, no parity and one stop bit.

    Raises:
        OSError: If it cannot be opened, or if it is not a serial line.
    """
    descriptor = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(descriptor)
        speed = baud_constant(baud)
        modes = termios.tcgetattr(descriptor)
        modes[4] = modes[5] = speed
        termios.tcsetattr(descriptor, termios.TCSANOW, modes)
    except termios.error as error:
        os.close(descriptor)
        raise OSError(error.args[0], f"{path} is not a serial line") from None
    return FileChannel(descriptor)
