"""Build products of a scene: target files and in-memory models."""

from __future__ import annotations

import tempfile
import weakref
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.backends import compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.scene.model import Scene
from simfoundry.targets.build import TARGETS, build, report

if TYPE_CHECKING:
    import mujoco
    from pxr import Usd


@dataclass(frozen=True)
class Build:
    """Compiled targets on disk: one folder per target (``folder/<target>``), and ``folder/loss.json``."""

    folder: Path
    scene: Scene
    artifacts: tuple[Artifact, ...]

    @property
    def entries(self) -> dict[str, Path]:
        """The entry file of each target, by target name."""
        return {a.target: self.folder / a.target / a.entry for a in self.artifacts}

    @property
    def losses(self) -> dict[str, Any]:
        """The losses in each target, by target name; this is the content of ``loss.json``."""
        return report(self.scene, list(self.artifacts))


def build_scene(scene: Scene, targets: tuple[str, ...], out: Path, force: bool) -> Build:
    """Compile a scene into one folder per target; if no targets are given, compile it for every format."""
    return Build(out, scene, tuple(build(scene, targets or TARGETS, out, force)))


def mujoco_spec(scene: Scene) -> mujoco.MjSpec:
    """Convert a scene to an editable MuJoCo model."""
    import mujoco

    artifact = compile_scene(scene, "mjcf")
    files = dict(artifact.files)
    included = {name: data for name, data in files.items() if name.endswith(".xml") and name != artifact.entry}
    assets = {name: data for name, data in files.items() if name.startswith("assets/")}
    return mujoco.MjSpec.from_string(files[artifact.entry].decode(), include=included, assets=assets)


def usd_stage(scene: Scene) -> Usd.Stage:
    """Convert a scene to a USD stage.

    The layers are stored in a temporary folder, which is deleted when the stage is garbage-collected.
    """
    from pxr import Usd

    artifact = compile_scene(scene, "usd")
    folder = tempfile.TemporaryDirectory(prefix="simfoundry_")
    artifact.write(Path(folder.name) / "usd")
    stage = Usd.Stage.Open(str(Path(folder.name) / "usd" / artifact.entry))
    weakref.finalize(stage, folder.cleanup)
    return stage
