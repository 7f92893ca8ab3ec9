"""Rename anything in all documents of the project that name it."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path

from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.names.plan import plan_rename
from simfoundry.spec.names.rename import RenameError
from simfoundry.studio.acts.act import ActEdits, ActError
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class RenameSymbol:
    """Rename what the scene calls ``old``, in every document that names it.

    Attributes:
        old: The name, with its section if several things have it, such as ``objects.mug`` or ``materials.oak``.
        new: The new name.
        kind: The kind, such as ``object``, if several things have the name; otherwise empty.
    """

    old: str
    new: str
    kind: str = ""

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"rename {self.old} to {self.new}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the new texts of all documents that name it."""
        texts = {os.path.realpath(path): text for path, text in scene.texts.items()}
        try:
            plan = plan_rename(scene.loaded.path, self.old, self.new, self.kind, texts)
        except RenameError as error:
            raise ActError(str(error)) from None
        except SpecError as error:
            raise ActError(f"cannot rename `{self.old}`: {error.diagnostics[0].message}") from None
        return ActEdits(texts={Path(os.path.realpath(e.file)): e.after for e in plan.edits}, notes=plan.notes)
