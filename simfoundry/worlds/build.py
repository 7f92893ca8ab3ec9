"""A scene to a build folder: one folder a target, and one report of what was lost."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from simfoundry.backends import BACKENDS
from simfoundry.backends.artifact import Artifact
from simfoundry.errors import OutputError
from simfoundry.files import strangers, write_atomically
from simfoundry.scene.model import Scene
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import find_target
from simfoundry.targets.report import report

TARGETS = tuple(sorted(BACKENDS))
"""The targets of a build where nobody says which: the plain backends."""


LOSSES = "loss.json"
"""What became of each field in each target, in the build folder; see :func:`simfoundry.targets.report.report`."""


def build(scene: Scene, targets: Iterable[str], out: Path, force: bool = False) -> list[Artifact]:
    """Compile ``scene`` for every target into ``out/<target>`` and write ``out/loss.json``.

    A target is a name (a backend or a simulator) or the path of a profile. Everything is compiled before anything is
    written; each folder is replaced in one step. Raises :class:`OutputError` where a folder holds files that no build
    wrote, unless ``force``.
    """
    found = [find_target(name) for name in dict.fromkeys(targets)]
    artifacts = [compile_target(scene, target) for target in {t.name: t for t in found}.values()]
    for artifact in artifacts if not force else ():
        _ensure_ours(out / artifact.target)
    for artifact in artifacts:
        artifact.write(out / artifact.target)
    text = json.dumps(report(scene, artifacts), indent=2, ensure_ascii=False) + "\n"
    write_atomically(out / LOSSES, text.encode())
    return artifacts


def _ensure_ours(folder: Path) -> None:
    """Raise :class:`OutputError` where ``folder`` holds what its own manifest does not name."""
    if not folder.is_dir():
        return
    manifest = folder / "manifest.json"
    try:
        written = list(json.loads(manifest.read_bytes())["files"])
    except (OSError, ValueError, KeyError, TypeError):
        written = []
    foreign = strangers(folder, [*written, *(["manifest.json"] if written else [])])
    if foreign:
        names = ", ".join(foreign[:3])
        raise OutputError(f"{folder} holds files that no build wrote ({names}); choose another folder, or say --force")
