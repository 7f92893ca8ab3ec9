"""Run all lints on documents."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from simfoundry.spec.check.documents import sift, unused
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.files import Loaded


def lint(loaded: Loaded, seen: set[Path] | None = None) -> tuple[Diagnostic, ...]:
    """Return the findings of a document without errors and of the documents that it uses, each document once.

    Findings suppressed by its ``allow`` are left out; an entry that suppresses nothing is a finding. Documents in
    ``seen`` are skipped; those that are checked are added to it.
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
    # An entry inherited from a base document may suppress a finding only there.
    idle = unused(loaded.document, loaded.spec.allow, [*loaded.silenced, *silenced])
    findings += [d for d in idle if d.file == loaded.document.file]
    return tuple(findings)


def _lints(loaded: Loaded) -> Iterator[Diagnostic]:
    """Return the findings of one document: the errors of lowering, or if there are none, those of the lints."""
    kind = getattr(loaded.spec, "simfoundry", "")
    if kind not in ("scene/1", "asset/1", "task/1"):
        return
    from simfoundry.lint.draft import asset_faults, drafted_start
    from simfoundry.lint.lints import LINTS, Subject

    try:
        subject = Subject(loaded, None if kind == "asset/1" else drafted_start(loaded))
    except SpecError as error:  # for a task or a used document, the scene's own check reports this
        yield from (d for d in error.diagnostics if loaded.document is not None and d.file == loaded.document.file)
        return
    if kind == "asset/1":
        yield from asset_faults(loaded)
    for one in LINTS.load_all().values():
        if kind in one.kinds:
            yield from one.find(subject)
