"""The MuJoCo session for USD builds, which opens a build with the loader of the ``mujoco_usd`` target."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import ModuleType

from simfoundry.runtime.plugins import import_file
from simfoundry.verify import readback as rb

_mujoco = import_file(Path(__file__).parents[1] / "mujoco" / "readback.py")
"""The session of the ``mujoco`` target, which the loader's names allow to read this model."""


def open_build(folder: Path, loader: ModuleType) -> rb.Session:
    """Return a session for the stage in ``folder``, which is opened by the loader."""
    return MujocoUsdSession(*loader.load())


class MujocoUsdSession(_mujoco.MujocoSession):  # type: ignore[misc, name-defined]
    """A MuJoCo model that was read from a stage, in which static links do not have parents."""

    def read(self) -> rb.WorldReadback:
        """Return the bodies and the joints. MuJoCo's rule for the friction of pairs is stated in the profile."""
        found: rb.WorldReadback = super().read()
        return replace(found, pairs=None)

    def _held(self, body: int) -> str | None:
        held = str(super()._held(body))
        return None if held == rb.WORLD and "." in self.model.body(body).name else held
