"""A scene to a build folder: one folder a target, and one report of what was lost."""

from __future__ import annotations

import json
from collections.abc import Iterable
from pathlib import Path

from simfoundry.backends import BACKENDS, compile_scene
from simfoundry.backends.artifact import Artifact
from simfoundry.errors import OutputError
from simfoundry.files import strangers, write_atomically
from simfoundry.scene.model import Scene

TARGETS = tuple(sorted(BACKENDS))


def build(scene: Scene, targets: Iterable[str], out: Path, force: bool = False) -> list[Artifact]:
    """Compile ``scene`` for every target into ``out/<target>`` and write ``out/loss.json``.

    Everything is compiled before anything is written; each folder is replaced in one step. Raises
    :class:`OutputError` where a folder holds files that no build wrote, unless ``force``.
    """
    artifacts = [compile_scene(scene, target) for target in dict.fromkeys(targets)]
    for artifact in artifacts if not force else ():
        _ensure_ours(out / artifact.target)
    for artifact in artifacts:
        artifact.write(out / artifact.target)
    report = json.dumps(losses_by_target(artifacts), indent=2, ensure_ascii=False) + "\n"
    write_atomically(out / "loss.json", report.encode())
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


def losses_by_target(artifacts: Iterable[Artifact]) -> dict[str, list[dict[str, str]]]:
    """Per target, every field that is approximated or dropped, with the reason: what ``loss.json`` holds."""
    return {
        artifact.target: [
            {"path": loss.path, "fidelity": loss.fidelity.value, "reason": loss.reason} for loss in artifact.losses
        ]
        for artifact in artifacts
    }
