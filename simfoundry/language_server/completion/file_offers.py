"""Offer the files of a project that a document can refer to."""

from __future__ import annotations

import os
import re
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from lsprotocol import types

from simfoundry.language_server.completion.insertion import Offer
from simfoundry.spec.check.scene import ROBOT_SUFFIXES
from simfoundry.spec.files import (
    ASSET_SUFFIX,
    MESH_SUFFIXES,
    PANORAMA_SUFFIXES,
    PICTURE_SUFFIXES,
    SPLAT_SUFFIXES,
    TEXTURE_SUFFIXES,
    FileError,
    located,
)
from simfoundry.spec.models.kinds import suffix
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.text import Path_

# Suffixes of the files that a key refers to, by the kind of document and key, or by the key. A folder has none.
_SUFFIXES: dict[str, tuple[str, ...]] = {
    "asset": (ASSET_SUFFIX, *MESH_SUFFIXES),
    "mesh": MESH_SUFFIXES,
    "visual": MESH_SUFFIXES,
    "splat": SPLAT_SUFFIXES,
    "texture": TEXTURE_SUFFIXES,
    "lights.texture": PANORAMA_SUFFIXES,
    "scene": (suffix("scene/1"),),
    "truth": (suffix("scene/1"),),
    "twin": (suffix("scene/1"), suffix("task/1")),
    "color": PICTURE_SUFFIXES,
    "image": PICTURE_SUFFIXES,
    "library": (),
    **ROBOT_SUFFIXES,
}

# Folders and files that are listed at most, so that a large project cannot delay an answer.
MAX_FOLDERS = 400
MAX_ENTRIES = 4000


@dataclass(frozen=True)
class _Listing:
    """The folders and files in a folder, in order."""

    folders: tuple[str, ...] = ()
    files: tuple[str, ...] = ()


@lru_cache(maxsize=2 * MAX_FOLDERS)
def _listed(folder: Path, changed: int) -> _Listing:  # noqa: ARG001 - used only as a cache key
    folders, files = list[str](), list[str]()
    with os.scandir(folder) as entries:
        for count, entry in enumerate(entries):
            if count >= MAX_ENTRIES:
                break
            if not entry.name.startswith((".", "__")) and "\\" not in entry.name and entry.name.isprintable():
                (folders if entry.is_dir(follow_symlinks=False) else files).append(entry.name)
    return _Listing(tuple(sorted(folders)), tuple(sorted(files)))


def _list(folder: Path) -> _Listing:
    """Return the content of a folder, which is read again only after it has changed."""
    try:
        return _listed(folder, folder.stat().st_mtime_ns)
    except OSError:
        return _Listing()


def suffixes_of(kind: str, path: Path_) -> tuple[str, ...]:
    """Return the suffixes of the files that the value at a path may refer to; a folder has none."""
    if path[-1] == "extends":
        return (suffix(f"{kind}/1"),)
    return _SUFFIXES.get(f"{path[0]}.{path[-1]}", _SUFFIXES.get(str(path[-1]), ()))


def file_offers(document: Path, suffixes: tuple[str, ...], typed: str) -> Iterator[Offer]:
    """Yield the files with one of the suffixes, or the folders if there are none, near files first.

    The folder that is already typed is listed by itself, so that one can go on step by step. Files outside of the
    project are not offered.
    """
    package = re.match(r"pkg:\w+/(?:.*/)?", typed)
    if package is not None:
        yield from _in_folder(_of_package(package[0], document), package[0], suffixes)
        return
    root = project_root(document).resolve()
    here = document.parent.resolve()
    step = typed[: typed.rfind("/") + 1]
    if step and not step.startswith("/"):
        folder = (here / step).resolve()
        if folder.is_relative_to(root):
            yield from _in_folder(folder, step, suffixes)
    for prefix, folder in _folders(root, here):
        if prefix == step and step:
            continue
        if not suffixes and prefix and not prefix.endswith("../"):
            yield _offer(prefix.removesuffix("/"), types.CompletionItemKind.Folder, prefix)
        for name in _list(folder).files if suffixes else ():
            if name.lower().endswith(suffixes) and (name != document.name or folder != here):
                yield _offer(prefix + name, types.CompletionItemKind.File, prefix)


def _relative(folder: Path, here: Path) -> str:
    """Return the path of a folder relative to another one, with a slash at the end, or an empty string for itself."""
    path = os.path.relpath(folder, here).replace(os.sep, "/")
    return "" if path == "." else f"{path}/"


def _folders(root: Path, here: Path) -> list[tuple[str, Path]]:
    """Return the folders of a project with their paths relative to one of them, those near it first."""
    found = dict[Path, None]()
    for start in (here, *here.parents):
        level = [start] if start.is_relative_to(root) else []
        while level and len(found) < MAX_FOLDERS:
            found.update(dict.fromkeys(level))
            below = (folder / name for folder in level for name in _list(folder).folders)
            level = [folder for folder in below if folder not in found]
    return sorted(((_relative(folder, here), folder) for folder in [*found][:MAX_FOLDERS]), key=_distance)


def _distance(folder: tuple[str, Path]) -> int:
    return folder[0].count("/")


def _in_folder(folder: Path | None, prefix: str, suffixes: tuple[str, ...]) -> Iterator[Offer]:
    listing = _list(folder) if folder is not None else _Listing()
    for name in listing.folders:
        yield _offer(f"{prefix}{name}/" if suffixes else f"{prefix}{name}", types.CompletionItemKind.Folder, prefix)
    for name in listing.files if suffixes else ():
        if name.lower().endswith(suffixes):
            yield _offer(prefix + name, types.CompletionItemKind.File, prefix)


def _of_package(prefix: str, document: Path) -> Path | None:
    try:
        return located(f"{prefix}.", document)
    except (FileError, OSError, RuntimeError, ValueError):
        return None


def _offer(path: str, kind: types.CompletionItemKind, prefix: str) -> Offer:
    detail = "folder" if kind is types.CompletionItemKind.Folder else _WORDS.get(Path(path).suffix.lower(), "file")
    if path.endswith(".yaml"):
        detail = path.rpartition("/")[2].split(".")[-2]
    return Offer(path, kind, detail=detail, group=1 + prefix.count("../"))


_WORDS = {
    **dict.fromkeys(MESH_SUFFIXES, "mesh"),
    **dict.fromkeys(PICTURE_SUFFIXES, "image"),
    **dict.fromkeys((".hdr", ".exr"), "panorama"),
}
