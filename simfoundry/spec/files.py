"""Loaded documents, and checks that the files they refer to exist, are of the right type, and are in the project."""

from __future__ import annotations

import os
import re
from collections.abc import Iterable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.errors import PicklableError, SimfoundryError
from simfoundry.spec.diagnostics import Diagnostic, Severity, nearest, similar_fixes
from simfoundry.spec.models.base import DocumentSpec
from simfoundry.spec.yaml.text import Document, Mark

if TYPE_CHECKING:
    from simfoundry.spec.compose.expand import Reuse

MESH_SUFFIXES = (".glb", ".obj", ".stl", ".ply")
ASSET_SUFFIX = ".asset.yaml"
TEXTURE_SUFFIXES = (".png", ".jpg", ".jpeg")
PANORAMA_SUFFIXES = (".hdr", ".exr", *TEXTURE_SUFFIXES)
# Formats of Gaussian splats: those of trainers, SPZ (Niantic), glTF, and USD.
SPLAT_SUFFIXES = (".ply", ".spz", ".glb", ".usda", ".usdc", ".usd")
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy", ".exr")
# Maximum length of a file reference [characters]; well below Linux's 4096, to leave room for the project folder.
MAX_PATH = 512

_PACKAGE = re.compile(r"pkg:([A-Za-z_][A-Za-z0-9_]*)/(.+)\Z", re.DOTALL)
_ROBOT = re.compile(r"(menagerie|robot_descriptions):([a-z0-9_]+)(?:/([A-Za-z0-9_./-]+))?\Z")


class FileError(PicklableError):
    """Raised if a document cannot use a file.

    The message states the reason, and ``mark`` is the wrong part of the path, if it is known.
    """

    def __init__(self, code: str, message: str, hint: str = "", mark: Mark | None = None) -> None:
        super().__init__(message)
        self.code, self.hint, self.mark = code, hint, mark


def is_document(reference: str) -> bool:
    """Return True if an object's ``asset`` is an asset document rather than a mesh."""
    return reference.lower().endswith(ASSET_SUFFIX)


def packaged_model(reference: str) -> tuple[str, str, str | None] | None:
    """Return the package, robot, and path of a model that a package downloads on first use, or None for other files.

    The packages are ``menagerie`` (mujoco-menagerie) and ``robot_descriptions``.
    """
    found = _ROBOT.match(reference)
    return found and (found[1], found[2], found[3])


def resolved(path: Path) -> Path:
    """Return a path without symbolic links. Unlike :meth:`Path.resolve`, this also works if the links form a cycle."""
    return Path(os.path.realpath(path))


def located(reference: str, document: Path) -> Path:
    """Return the file that ``reference`` in ``document`` refers to: a relative path, or ``pkg:package/path``.

    Raises:
        FileError: If the package does not exist.
    """
    named = _PACKAGE.match(reference)
    if named is None:
        return (document.parent / reference).resolve()
    from importlib.util import find_spec

    package, path = named.groups()
    spec = find_spec(package)  # locates the folder without running any code
    if spec is None or not spec.submodule_search_locations:
        hint = f"install it (`pip install {package}`), or give a path relative to this document"
        raise FileError("SF203", f"the `{package}` package is not installed", hint)
    folder = Path(spec.submodule_search_locations[0]).resolve()
    target = (folder / path).resolve()
    if not target.is_relative_to(folder):
        raise FileError("SF204", f"`{reference}` is outside the package", "name a file in the package")
    return target


def reachable(reference: str, document: Path, root: Path, suffixes: tuple[str, ...]) -> Path:
    """Return the file that ``reference`` refers to.

    Raises:
        FileError: If the file is neither in the project ``root`` nor in an installed package.
    """
    if "\0" in reference or "\\" in reference or len(reference) > MAX_PATH:
        hint = f"separate folders with `/`, and use at most {MAX_PATH} characters"
        raise FileError("SF204", f"`{reference[:MAX_PATH]}` is not a portable path", hint)
    try:
        packaged = _PACKAGE.match(reference) is not None
        target = located(reference, document)
        return _found(reference, target, target.parent if packaged else root, suffixes)
    except (OSError, RuntimeError) as error:  # a cycle of links, an unreadable folder, or a long name
        reason = getattr(error, "strerror", None) or "its symbolic links form a cycle"
        raise FileError("SF203", f"`{reference}` could not be accessed: {reason}") from None


def _found(reference: str, target: Path, root: Path, suffixes: tuple[str, ...]) -> Path:
    if Path(reference).is_absolute() or not target.is_relative_to(root):
        hint = f"files must be inside the project, {root}; copy the file there and use a relative path"
        raise FileError("SF204", f"`{reference}` is outside the project", hint + _or_mark(target, root))
    if suffixes and not reference.lower().endswith(suffixes):
        message = f"`{reference}` does not have a supported file type"
        raise FileError("SF203", message, f"supported: {', '.join(suffixes)}")
    if target.is_file() or (not suffixes and target.is_dir()):
        return target
    if target.exists():
        found = "a folder" if target.is_dir() else "a file" if target.is_file() else "a pipe or a device"
        expected = "file" if suffixes else "folder"
        raise FileError("SF203", f"`{reference}` is not a {expected}", f"it is {found}; name a {expected}")
    folder = target.parent
    message = f"{'file' if suffixes else 'folder'} `{reference}` does not exist"
    if folder.is_dir():
        near = [p.name for p in folder.iterdir() if p.name.lower().endswith(suffixes or "")]
        hint = nearest(target.name, near) or f"folder `{folder.name}` does not contain any such file"
        mark = Mark(target.name, len(reference) - len(target.name), similar_fixes(target.name, near))
        raise FileError("SF203", message, hint, mark if reference.endswith(target.name) else None)
    raise FileError("SF203", message, f"folder `{folder.name}` does not exist", _missing_folder(reference, folder))


def _missing_folder(reference: str, folder: Path) -> Mark | None:
    """Return the mark for the first folder of a path that does not exist, or None if the path does not name it."""
    while not folder.parent.is_dir() and folder != folder.parent:
        folder = folder.parent
    named = [part.start() for part in re.finditer(rf"(?<![^/]){re.escape(folder.name)}(?=/)", reference)]
    if not named:
        return None
    near = [p.name for p in folder.parent.iterdir() if p.is_dir()]
    return Mark(folder.name, named[0], similar_fixes(folder.name, near))


def _or_mark(target: Path, root: Path) -> str:
    """Suggest adding a project marker to a folder that contains both files, if the document has no project."""
    from simfoundry.spec.project import Project

    common = Path(os.path.commonpath([target.parent, root]))
    if Project(root).is_marked or not target.is_file() or common == Path(common.anchor):
        return ""
    return f", or create an empty `simfoundry.yaml` in {common}"


def shown(reference: str, document: Path) -> Path:
    """Return the path of a file for display. The path is relative if the document's own path is relative."""
    plain, target = Path(os.path.normpath(document.parent / reference)), located(reference, document)
    return plain if resolved(plain) == target else target


@dataclass(frozen=True)
class Loaded:
    """A document that has been read and checked.

    ``spec`` is the typed content, including everything that the document extends, or None if there are errors.
    ``document`` is the underlying text, or None if it could not be read. ``bases`` are the files that the document
    extends. ``uses`` contains, by resolved path, the documents that it refers to: assets, and the scene of a task.
    ``silenced`` contains the warnings suppressed by the document's ``allow``. ``reuse`` records what the document
    reuses, or is None if it does not reuse anything. ``source`` is the text itself, before it was joined with its bases
    and written out.
    """

    path: Path
    root: Path
    spec: DocumentSpec | None
    findings: tuple[Diagnostic, ...]
    document: Document | None = None
    bases: tuple[Path, ...] = ()
    uses: dict[str, Loaded] = field(default_factory=dict)
    silenced: tuple[Diagnostic, ...] = ()
    reuse: Reuse | None = None
    source: Document | None = None
    _located: dict[str, Path] = field(default_factory=dict, init=False, repr=False, compare=False)

    @property
    def parameters(self) -> dict[str, Any]:
        """Return the values of the parameters of a scene, by name."""
        return self.document.section("parameters") if self.document is not None else {}

    @property
    def errors(self) -> list[Diagnostic]:
        """Return the errors in this document and in the documents that it uses."""
        return [d for d in self.all_findings() if d.severity is Severity.ERROR]

    def all_findings(self) -> list[Diagnostic]:
        """Return the findings for this document and for the documents that it uses."""
        return [*self.findings, *(d for used in self.uses.values() for d in used.all_findings())]

    def files(self) -> list[Path]:
        """Return all files that were read: this document, its bases, and the files of documents that it uses."""
        included = self.reuse.files if self.reuse is not None else ()
        return [self.path, *self.bases, *included, *(file for used in self.uses.values() for file in used.files())]

    def finding(self, code: str, path: tuple[str | int, ...], message: str, hint: str = "") -> Diagnostic:
        """Return an error at a location in this document."""
        if self.document is None:
            return Diagnostic(code, Severity.ERROR, message, str(self.path), 0, 0, ".".join(map(str, path)), hint)
        return self.document.finding(code, path, message, hint)

    def file(self, reference: str) -> Path:
        """Return the file that a path in this document refers to."""
        found = self._located.get(reference)
        if found is None:
            found = self._located[reference] = located(reference, self.path)
        return found

    def used(self, reference: str) -> Loaded | None:
        """Return the document that a path in this document refers to, if it was read."""
        return self.uses.get(str(self.file(reference)))

    def shown(self, reference: str) -> Path:
        """Return the path of a file for display. The path is relative if this document's own path is relative."""
        return shown(reference, self.path)


def files_below(paths: Iterable[Path], suffix: str, noun: str) -> Iterator[Path]:
    """Yield the files in ``paths`` and, for each folder, the files below it whose names end in ``suffix``."""
    for path in paths:
        inside = sorted(path.rglob(f"*{suffix}")) if path.is_dir() else [path]
        if not inside:
            raise SimfoundryError(f"{path} does not contain any {noun} (files whose names end in {suffix})")
        yield from inside
