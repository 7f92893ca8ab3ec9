"""Load a scene from a document, or from a file format with a frontend."""

from __future__ import annotations

import tempfile
import weakref
from pathlib import Path

from simfoundry.api.scene_document import SceneDocument
from simfoundry.errors import SimfoundryError

IMPORTED = (".urdf", ".xml", ".usd", ".usda", ".usdc", ".usdz", ".json")
"""File suffixes that frontends read."""


def load_scene_document(path: Path) -> SceneDocument:
    """Return the scene document at a path, or the document imported from another format."""
    return _imported(path) if path.suffix.lower() in IMPORTED else SceneDocument.load(path)


def is_compiled_stage(path: Path) -> bool:
    """Return whether a file is a stage that was compiled from a document, which is stored in it."""
    if path.suffix.lower() not in (".usd", ".usda", ".usdc", ".usdz"):
        return False
    from simfoundry.frontends.errors import refusing_faults
    from simfoundry.frontends.usd.compiled.stage import StageError, carrier, open_stage

    try:
        with refusing_faults(path):
            return carrier(open_stage(path)) is not None
    except StageError:
        return False  # the import reports why it cannot be read


def _imported(path: Path) -> SceneDocument:
    from simfoundry.frontends.importer import import_file

    if is_compiled_stage(path):
        document = SceneDocument.load(path)
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
