"""The files that a scene is compiled to."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.backends.artifact import Artifact
from simfoundry.scene.model import Scene
from simfoundry.targets.build import report


@dataclass(frozen=True)
class Build:
    """The compiled targets on disk, with one folder per target (``folder/<target>``), and ``folder/loss.json``."""

    folder: Path
    scene: Scene
    artifacts: tuple[Artifact, ...]

    @property
    def entries(self) -> dict[str, Path]:
        """The entry file of each target, by target name."""
        return {a.target: self.folder / a.target / a.entry for a in self.artifacts}

    @property
    def losses(self) -> dict[str, Any]:
        """The losses in each target, by target name. This is the content of ``loss.json``."""
        return report(self.scene, list(self.artifacts))
