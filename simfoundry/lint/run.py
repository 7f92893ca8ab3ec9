"""All lints of a document."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from simfoundry.spec.check.allow import sift, unused
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.loaded import Loaded


def lint(loaded: Loaded, seen: set[Path] | None = None) -> tuple[Diagnostic, ...]:
    """The findings of a document without errors and of those that it uses, each document once.

    What its ``allow`` silences is left out; an entry of it that silences nothing is a finding. Documents in ``seen``
    are passed over; those that are looked at are added to it.
    """
    seen = set() if seen is None else seen
    if loaded.spec is None or loaded.document is None or loaded.errors:
        return ()
    path = Path(loaded.document.file).absolute()
    if path in seen:
        return ()
    seen.add(path)
    findings = [d for used in loaded.uses.values() for d in lint(used, seen)]
    kept, silenced = sift(_lints(loaded), loaded.spec.allow)
    findings += kept
    # An entry that a document took over from its base may silence something there alone.
    idle = unused(loaded.document, loaded.spec.allow, [*loaded.silenced, *silenced])
    findings += [d for d in idle if d.file == loaded.document.file]
    return tuple(findings)


def _lints(loaded: Loaded) -> Iterator[Diagnostic]:
    """The findings of one document."""
    kind = getattr(loaded.spec, "simfoundry", "")
    if kind in ("scene/1", "asset/1"):
        yield from _of_shapes(loaded)
    elif kind == "task/1":
        yield from _of_task(loaded)


def _of_shapes(loaded: Loaded) -> Iterator[Diagnostic]:
    """Of a scene or an asset: what lowering refuses, and of a scene without that what will not work."""
    from simfoundry.assets.textures import document_faults
    from simfoundry.lint.meshes import mesh_faults
    from simfoundry.lint.report import warning
    from simfoundry.spec.models.scene import SceneSpec

    faults = list(mesh_faults(loaded, loaded.spec))  # type: ignore[arg-type]
    yield from faults
    for path, wrong in document_faults(loaded, loaded.spec):  # type: ignore[arg-type]
        hint = "put the file there, or remove its name from the mesh; the surface is shown plain"
        yield warning(loaded, "SF412", path, wrong, hint)
    if not isinstance(loaded.spec, SceneSpec) or any(d.severity is Severity.ERROR for d in faults):
        return
    from simfoundry.lint.contacts import overlaps, unsupported
    from simfoundry.lint.places import misplaced
    from simfoundry.lint.relations import broken
    from simfoundry.lint.sketch import sketch
    from simfoundry.lint.views import unseen

    drawn = sketch(loaded)
    for findings in (misplaced, overlaps, unsupported, unseen, broken):
        yield from findings(loaded, drawn)


def _of_task(loaded: Loaded) -> Iterator[Diagnostic]:
    from simfoundry.lint.tasks import lint_task
    from simfoundry.spec.models.scene import SceneSpec
    from simfoundry.spec.models.task import TaskSpec

    spec = loaded.spec
    assert isinstance(spec, TaskSpec)
    scene = loaded.used(spec.scene)
    if scene is not None and isinstance(scene.spec, SceneSpec):
        yield from lint_task(loaded, spec, scene)
