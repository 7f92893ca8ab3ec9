"""SF412: mesh textures that cannot be used."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.lint.lints import Lint, Subject
from simfoundry.lint.report import warning
from simfoundry.spec.diagnostics import Diagnostic

HINT = "add the file, or remove its name from the mesh; the surface is rendered without a texture"


def lost_textures(subject: Subject) -> Iterator[Diagnostic]:
    """Find textures of meshes that are missing or cannot be read."""
    from simfoundry.assets.textures import document_faults

    for path, wrong in document_faults(subject.loaded, subject.loaded.spec):  # type: ignore[arg-type]
        yield warning(subject.loaded, "SF412", path, wrong, HINT)


LINT = Lint("SF412", ("scene/1", "asset/1"), lost_textures)
