"""Search for the files that an imported file refers to, only in its folder and its packages."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from simfoundry.frontends.errors import ImportRefusedError

MAX_FILE_BYTES = 500_000_000
"""Largest file size [bytes], which bounds memory use; meshes and textures of scenes are smaller."""

LEVELS = 5
"""Number of parent folders that are searched for a package: ROS nests share/package/robots/name/urdf."""

MAX_REFERENCE = 1000
"""Longest reference [characters]; file systems allow fewer."""

_PACKAGE = re.compile(r"(?:package|model)://(.*)\Z", re.DOTALL)


class NotFoundError(Exception):
    """Error with the reason why a referenced file is not available, as the end of a sentence."""


@dataclass(frozen=True)
class FileSearch:
    """Looks up files that ``file`` refers to, below ``root`` or in the folder of one of ``packages``."""

    file: Path
    packages: Mapping[str, Path] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        """Return the folder that must contain all files: the package of the file, or its parent folder."""
        folder = self.file.resolve().parent
        for candidate in (folder, *folder.parents[:LEVELS]):
            if any((candidate / mark).exists() for mark in ("package.xml", ".git", "simfoundry.yaml")):
                return candidate
        return folder.parent if folder.parent != Path(folder.anchor) else folder

    def find(self, reference: str, folder: Path | None = None) -> Path:
        """Return the file of a reference relative to ``folder`` (by default the folder of the file).

        Raises :class:`NotFoundError`.
        """
        if "\0" in reference or len(reference) > MAX_REFERENCE:
            raise NotFoundError("is no file name")
        reference = reference.replace("\\", "/")
        package = _PACKAGE.match(reference)
        candidates = self._in_package(unquote(package[1])) if package else self._beside(reference, folder)
        outside = False
        for candidate, root in candidates:
            target = candidate.resolve()
            if not target.is_file():
                continue
            if not target.is_relative_to(root.resolve()):
                outside = True
                continue
            if target.stat().st_size > MAX_FILE_BYTES:
                raise NotFoundError(f"is larger than {MAX_FILE_BYTES // 1_000_000} MB")
            return target
        if outside:
            hint = "name the folder that it belongs to with `--package NAME=PATH`"
            raise NotFoundError(f"lies outside {self.root}; {hint}")
        if package:
            name = package[1].lstrip("/").partition("/")[0]
            raise NotFoundError(f"is not found; say where its package lies: `--package {name}=PATH`")
        raise NotFoundError("does not exist")

    def need(self, reference: str, file: Path, line: int, folder: Path | None = None) -> Path:
        """Return the file of a reference on a line of ``file``; raises :class:`ImportRefusedError` with that line."""
        try:
            return self.find(reference, folder)
        except NotFoundError as error:
            raise missing_file(file, line, reference, error) from None

    def _beside(self, reference: str, folder: Path | None) -> Iterator[tuple[Path, Path]]:
        reference = reference.removeprefix("file://")
        yield (folder or self.file.resolve().parent) / reference, self.root
        yield from ((place / reference, place) for place in self.packages.values())

    def _in_package(self, path: str) -> Iterator[tuple[Path, Path]]:
        """Yield candidates for ``package://NAME/REST``: named packages, then parent folders, then without the name."""
        path = path.lstrip("/")
        name, _, rest = path.partition("/")
        if name in ("", ".", ".."):
            return
        if name in self.packages:
            yield self.packages[name] / rest, self.packages[name]
            return
        here = self.file.resolve().parent
        above = [here, *here.parents[:LEVELS]]
        for folder in above:
            if folder.name == name:
                yield folder / rest, folder
            yield folder / name / rest, folder / name
        yield from ((place / path, place) for place in self.packages.values())
        yield from ((folder / path, self.root) for folder in above[:3])


def missing_file(file: Path, line: int, reference: str, error: NotFoundError) -> ImportRefusedError:
    """Return the error for a file that refers to an unavailable file."""
    return ImportRefusedError(file, f"`{reference[:120]}` {error}", line)
