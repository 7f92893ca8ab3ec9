"""The keys of the page. They are positions on a keyboard (``KeyboardEvent.code``), so layouts do not matter."""

from __future__ import annotations

from collections.abc import Mapping

from simfoundry.teleop.commands import Control

# The direction in which each key moves the hand, in the axes of the operator: forward, left, up.
MOVES: Mapping[str, tuple[int, int, int]] = {
    "KeyW": (1, 0, 0), "KeyS": (-1, 0, 0),
    "KeyA": (0, 1, 0), "KeyD": (0, -1, 0),
    "KeyR": (0, 0, 1), "KeyF": (0, 0, -1),
}  # fmt: skip

# The axis about which each key turns the hand, in the same axes.
TURNS: Mapping[str, tuple[int, int, int]] = {
    "KeyJ": (-1, 0, 0), "KeyL": (1, 0, 0),
    "KeyI": (0, 1, 0), "KeyK": (0, -1, 0),
    "KeyQ": (0, 0, 1), "KeyE": (0, 0, -1),
}  # fmt: skip

# Keys that slow motions down while they are held.
SLOW = ("ShiftLeft", "ShiftRight")

GRIPPER, SWITCH = "Space", "Tab"

CONTROLS: Mapping[str, Control] = {
    "Enter": Control.SAVE,
    "Backspace": Control.DISCARD,
    "KeyT": Control.RETRY,
    "KeyP": Control.PAUSE,
    "KeyM": Control.MARK,
}

KNOWN = frozenset((*MOVES, *TURNS, *SLOW, GRIPPER, SWITCH, *CONTROLS))

HELP = (
    "**W S** forward and back · **A D** left and right · **R F** up and down · **Q E** turn · **I K** tilt "
    "· **J L** roll · **Shift** slow · **Space** gripper · **Tab** next arm"
)
CONTROLS_HELP = "**Enter** save · **Backspace** discard · **T** retry · **P** pause · **M** mark"
