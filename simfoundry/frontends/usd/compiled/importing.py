"""``simfoundry import`` of a stage that was compiled from a scene: the scene document, as the stage has it now."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from simfoundry.errors import OutputError
from simfoundry.frontends.errors import refusing_faults
from simfoundry.frontends.usd.compiled.loading import home, stage_document
from simfoundry.frontends.usd.compiled.reading import read_stage
from simfoundry.frontends.usd.compiled.stage import StageError
from simfoundry.frontends.usd.compiled.values import StageNote
from simfoundry.frontends.usd.compiled.write_back import written_into
from simfoundry.runtime.files import write_atomically
from simfoundry.spec.change.flatten import relocated
from simfoundry.spec.check.validate import validate
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_yaml


@dataclass(frozen=True)
class Imported:
    """The text of a document; ``notes`` say what of the stage is not in it.

    ``disputed`` are paths at which the document says something else than both the compiled stage and the edited one:
    the stage's word stands there now.
    """

    text: str
    notes: tuple[StageNote, ...] = ()
    disputed: tuple[str, ...] = ()


def import_usd(path: Path, original: Path | None = None, into: Path | None = None) -> Imported:
    """The document of the stage at ``path``; where nothing was edited, the one that was compiled.

    With ``original``, that document with what was edited, and nothing else, otherwise: comments stay, and an overlay
    stays one. Without, a document that stands alone in canonical form, to lie in the folder ``into``. Raises
    :class:`StageError` and :class:`SpecError`.
    """
    reading = read_stage(path)
    spec, findings = validate(SceneSpec, stage_document(path, reading))
    if spec is None:
        raise SpecError(findings)
    if original is None:
        folder = home(path, reading.file).parent
        data = relocated({k: v for k, v in reading.data.items() if k != "extends"}, SceneSpec, folder, into or folder)
        return Imported(to_yaml(SceneSpec.model_validate(data)), reading.notes)
    written = written_into(original, reading.before, reading.data, reading.renamed)
    if written.name != reading.data["name"]:
        raise StageError(f"{path} was compiled from `{reading.data['name']}`, and {original} is `{written.name}`")
    return Imported(written.text, reading.notes, written.disputed)


def import_stage(path: Path, out: Path, onto: Path | None = None, force: bool = False) -> Imported:
    """Write the document of the stage at ``path`` to ``out``: ``onto`` with what was edited, or one that stands alone.

    Where ``out`` is there, it is what the edits go into, unless ``force``. Raises :class:`OutputError` where a document
    would be written away from the files that it refers to.
    """
    original = onto or (out if out.exists() and not force else None)
    if original is not None and original.absolute().parent != out.absolute().parent:
        raise OutputError(f"write {out.name} beside {original}: what that refers to is relative to its folder")
    with refusing_faults(path):
        imported = import_usd(path, original, out.parent)
    if original is None or not out.exists() or out.read_text(encoding="utf-8") != imported.text:
        write_atomically(out, imported.text.encode())
    return imported
