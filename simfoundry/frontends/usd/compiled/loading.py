"""Load a stage wherever a scene document is expected: checked alike, findings placed at prims."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from simfoundry.frontends.usd.compiled.reading import StageReading, read_stage
from simfoundry.frontends.usd.compiled.stage import StageError
from simfoundry.spec.diagnostics import Diagnostic, Severity
from simfoundry.spec.load import Known, checked
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.text import Document, Node

KIND = "scene/1"


def load_usd(path: Path, known: Known | None = None) -> Loaded:
    """Read and check the scene in a stage; the findings say what is wrong, nothing is raised.

    A finding's file names the prim as USD does, ``scene.usda</World/Objects/cup>``. Files that the scene refers to are
    looked for where its document lies, see :func:`home`.
    """
    try:
        reading = read_stage(path)
    except StageError as error:
        finding = Diagnostic("SF001", Severity.ERROR, error.reason, str(path))
        return Loaded(path, project_root(path), None, (finding,))
    place = home(path, reading.file)
    loaded = Loaded(place, project_root(place).resolve(), None, (), stage_document(path, reading))
    loaded = checked(loaded, KIND, {} if known is None else known)
    return replace(loaded, findings=(*loaded.findings, *_findings(path, reading)))


def _findings(path: Path, reading: StageReading) -> Iterator[Diagnostic]:
    """A finding for each note on the stage."""
    for note in reading.notes:
        about = next((key for key, prim in reading.prims.items() if f"{note.prim}/".startswith(f"{prim}/")), ())
        file = f"{path}<{note.prim}>"
        yield Diagnostic("SF421", Severity.WARNING, note.message, file, path=".".join(about), hint=note.hint)


def home(stage: Path, file: str) -> Path:
    """Return the place of a stage's document: ``file`` below a folder above the stage, or below the current one.

    Beside the stage where it is nowhere: its assets are missing then, too.
    """
    folders = [*stage.absolute().parents, Path.cwd()]
    places = [folder / name for folder in folders for name in dict.fromkeys((file, Path(file).name))]
    found = next((p for p in places if file and p.is_file()), None)
    return found or stage.absolute().parent / (Path(file).name or stage.name)


def stage_document(path: Path, reading: StageReading) -> Document:
    """Return the document of a stage; its members stand at their prims, all else in the file as a whole."""
    files: dict[tuple[Any, ...], str] = {key: f"{path}<{prim}>" for key, prim in reading.prims.items()}
    root = _node(reading.data, (), str(path), files)
    return Document(str(path), "", reading.data, root, ())


def _node(data: Any, at: tuple[Any, ...], file: str, files: Mapping[tuple[Any, ...], str]) -> Node:
    file = files.get(at, file)
    if isinstance(data, dict):
        children = {key: _node(value, (*at, key), file, files) for key, value in data.items()}
        return Node(data, 0, 0, children, dict.fromkeys(data, (0, 0)), file=file)
    if isinstance(data, tuple):
        return Node(data, 0, 0, [_node(value, (*at, k), file, files) for k, value in enumerate(data)], file=file)
    return Node(data, 0, 0, file=file)
