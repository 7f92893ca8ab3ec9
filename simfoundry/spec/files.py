"""Resolve files that documents refer to, and check existence, file type, and project containment."""

from __future__ import annotations

import os
import re
from pathlib import Path

from simfoundry.spec.diagnostics import nearest

MESH_SUFFIXES = (".glb", ".obj", ".stl", ".ply")
ASSET_SUFFIX = ".asset.yaml"
PICTURE_SUFFIXES = (".png", ".jpg", ".jpeg", ".tif", ".tiff", ".npy")
MAX_PATH = 512
"""Longest file reference [characters]: well below the 4096 of Linux, to leave room for the project folder."""

_PACKAGE = re.compile(r"pkg:([A-Za-z_][A-Za-z0-9_]*)/(.+)\Z", re.DOTALL)
_ROBOT = re.compile(r"(menagerie|robot_descriptions):([a-z0-9_]+)(?:/([A-Za-z0-9_./-]+))?\Z")


class FileError(Exception):
    """Error with the reason why a document cannot use a file."""

    def __init__(self, code: str, message: str, hint: str = "") -> None:
        super().__init__(message)
        self.code, self.hint = code, hint


def is_document(reference: str) -> bool:
    """Return True if an object's ``asset`` is an asset document rather than a mesh."""
    return reference.lower().endswith(ASSET_SUFFIX)


def packaged_model(reference: str) -> tuple[str, str, str | None] | None:
    """Return the package, robot, and path of a model that a package downloads on first use; None for other files.

    The packages are ``menagerie`` (mujoco-menagerie) and ``robot_descriptions``.
    """
    found = _ROBOT.match(reference)
    return None if found is None else (found[1], found[2], found[3])


def located(reference: str, document: Path) -> Path:
    """Return the file that ``reference`` in ``document`` refers to: a relative path, or ``pkg:package/path``.

    Raises :class:`FileError` if the package does not exist.
    """
    named = _PACKAGE.match(reference)
    if named is None:
        return (document.parent / reference).resolve()
    from importlib.util import find_spec

    package, path = named.groups()
    spec = find_spec(package)  # locates the folder without running any code
    if spec is None or not spec.submodule_search_locations:
        hint = f"install it (`pip install {package}`), or give a path relative to this document"
        raise FileError("SF203", f"the package `{package}` is not installed", hint)
    folder = Path(spec.submodule_search_locations[0]).resolve()
    target = (folder / path).resolve()
    if not target.is_relative_to(folder):
        raise FileError("SF204", f"`{reference}` is outside the package", "name a file of the package")
    return target


def reachable(reference: str, document: Path, root: Path, suffixes: tuple[str, ...]) -> Path:
    """Return the file that ``reference`` refers to, which must be in the project ``root`` or an installed package.

    Raises :class:`FileError` otherwise.
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
        raise FileError("SF203", f"`{reference}` cannot be reached: {reason}") from None


def _found(reference: str, target: Path, root: Path, suffixes: tuple[str, ...]) -> Path:
    if Path(reference).is_absolute() or not target.is_relative_to(root):
        hint = (
            f"files must be inside the project, {root}; copy it there and give a relative path{_or_mark(target, root)}"
        )
        raise FileError("SF204", f"`{reference}` is outside the project", hint)
    if suffixes and not reference.lower().endswith(suffixes):
        raise FileError("SF203", f"`{reference}` is not a file of the right kind", f"valid: {', '.join(suffixes)}")
    if target.is_file() or (not suffixes and target.is_dir()):
        return target
    folder = target.parent
    if not folder.is_dir():
        raise FileError("SF203", f"there is no file `{reference}`", f"there is no folder `{folder.name}`")
    near = [p.name for p in folder.iterdir() if p.name.lower().endswith(suffixes or "")]
    hint = nearest(target.name, near) or f"there is none in the folder `{folder.name}`"
    raise FileError("SF203", f"there is no {'file' if suffixes else 'folder'} `{reference}`", hint)


def _or_mark(target: Path, root: Path) -> str:
    """Suggest a project marker in a folder that contains both files, for a document without a project."""
    from simfoundry.spec.project import Project

    common = Path(os.path.commonpath([target.parent, root]))
    if Project(root).is_marked or not target.is_file() or common == Path(common.anchor):
        return ""
    return f", or put an empty `simfoundry.yaml` into {common}"


def shown(reference: str, document: Path) -> Path:
    """Return the path of a file for display, relative if the path of the document is."""
    plain, target = Path(os.path.normpath(document.parent / reference)), located(reference, document)
    return plain if plain.resolve() == target else target
