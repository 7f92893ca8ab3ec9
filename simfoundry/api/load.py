"""Load a scene from a document, or from a file that a frontend reads."""

from __future__ import annotations

import tempfile
import weakref
from pathlib import Path

from simfoundry.api.scene_document import SceneDocument
from simfoundry.errors import SimfoundryError

IMPORTED = (".urdf", ".xml", ".usd", ".usda", ".usdc", ".usdz", ".json")
"""Suffixes of files that frontends read."""


def load_scene_document(path: Path) -> SceneDocument:
    """Return the scene document at a path, or the one that a file of another format becomes."""
    return _imported(path) if path.suffix.lower() in IMPORTED else SceneDocument.load(path)


def _imported(path: Path) -> SceneDocument:
    from simfoundry.frontends.importer import import_file

    if path.suffix.lower().startswith(".usd"):
        from simfoundry.frontends.usd.compiled import load_usd

        loaded = load_usd(path, {})  # a stage that was compiled from a document carries it
        if loaded.spec is not None:
            document = SceneDocument(loaded)
            document.mark_imported(path)
            return document
    if not path.is_file():
        raise SimfoundryError(f"there is no file {path}")
    folder = tempfile.TemporaryDirectory(prefix="simfoundry_")
    report = import_file(path, Path(folder.name) / f"{path.stem}.scene.yaml")
    assert report.out is not None
    document = SceneDocument.load(report.out)
    document.mark_imported(path, Path(folder.name) / f"{path.stem}_files")
    weakref.finalize(document, folder.cleanup)
    return document
