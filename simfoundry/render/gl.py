"""Choose a renderer. GL drivers are tried in a separate process, so that this process can still use any of them."""

from __future__ import annotations

import os
import subprocess
import sys
from enum import StrEnum
from functools import cache

from simfoundry.errors import SimfoundryError

_PROBE = """
import importlib, mujoco
gl = importlib.import_module("mujoco.{engine}").GLContext(64, 64)
gl.make_current()
mujoco.MjrContext(mujoco.MjModel.from_xml_string("<mujoco/>"), mujoco.mjtFontScale.mjFONTSCALE_100)
print("drawn")
"""


class Engine(StrEnum):
    """A renderer: MuJoCo with one of two GL drivers, SimFoundry's ray caster, or the first of them that works."""

    AUTO = "auto"
    EGL = "egl"
    OSMESA = "osmesa"
    RAYCAST = "raycast"


DRIVERS = (Engine.EGL, Engine.OSMESA)


class RenderError(SimfoundryError):
    """Raised if an image cannot be rendered as requested. The message states the reason and the fix."""


def choose_engine(engine: Engine | str = Engine.AUTO) -> Engine:
    """Return the engine to use. ``auto`` selects the first engine that works.

    Raises:
        RenderError: If the requested engine does not work on this machine.
    """
    try:
        wanted = Engine(engine)
    except ValueError:
        raise RenderError(f"unknown render engine {engine!r}; available engines: {', '.join(Engine)}") from None
    if wanted is Engine.AUTO:
        drivers = sorted(DRIVERS, key=lambda driver: driver != os.environ.get("MUJOCO_GL", "").lower())
        return next((driver for driver in drivers if _obstacle(driver) is None), Engine.RAYCAST)
    if wanted is not Engine.RAYCAST and (reason := _obstacle(wanted)) is not None:
        raise RenderError(f"{wanted} is not available ({reason}); use 'raycast', which requires no GL driver")
    return wanted


def working_drivers() -> list[str]:
    """Return the GL drivers that MuJoCo can use on this machine."""
    return [driver.value for driver in DRIVERS if _obstacle(driver) is None]


def _obstacle(engine: Engine) -> str | None:
    """Return the reason why MuJoCo cannot use a driver in this process, or None if the driver works."""
    platform = os.environ.get("PYOPENGL_PLATFORM", "").lower()
    if platform not in ("", engine.value):  # PyOpenGL uses a single driver for the lifetime of a process
        return f"this process already uses the GL driver {platform!r}"
    return _probe(engine)


@cache
def _probe(engine: Engine) -> str | None:
    """Return the reason why a driver does not work, or None if it works.

    The driver is tried in a separate process, because a process cannot use another driver after a failed attempt.
    """
    own = {k: v for k, v in os.environ.items() if k not in ("MUJOCO_GL", "PYOPENGL_PLATFORM")}
    command = [sys.executable, "-c", _PROBE.format(engine=engine.value)]
    try:
        done = subprocess.run(command, env=own, capture_output=True, text=True, timeout=60, check=False)
    except (OSError, subprocess.TimeoutExpired) as error:
        return f"the trial run failed: {error}"
    if "drawn" in done.stdout:
        return None
    lines = done.stderr.strip().splitlines()
    return lines[-1] if lines else f"the trial run ended with status {done.returncode}"
