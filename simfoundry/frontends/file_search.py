"""The files that an imported file names: found in its folder or its packages, and nowhere else."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import unquote

from simfoundry.frontends.errors import ImportRefusedError

MAX_FILE_BYTES = 500_000_000
LEVELS = 5
"""How many folders up a package is looked for."""

_PACKAGE = re.compile(r"(?:package|model)://(.*)\Z", re.DOTALL)


class NotFoundError(Exception):
    """Why a file that another names is not to be had; the message is the end of a sentence."""


@dataclass(frozen=True)
class Search:
    """Where the files that ``file`` names may lie: below ``root``, or in the folder of one of ``packages``."""

    file: Path
    packages: Mapping[str, Path] = field(default_factory=dict)

    @property
    def root(self) -> Path:
        """The folder that everything must lie below: the package that the file belongs to, or one folder up."""
        folder = self.file.resolve().parent
        for candidate in (folder, *folder.parents[:LEVELS]):
            if any((candidate / mark).exists() for mark in ("package.xml", ".git", "simfoundry.yaml")):
                return candidate
        return folder.parent if folder.parent != Path(folder.anchor) else folder

    def find(self, reference: str, folder: Path | None = None) -> Path:
        """The file that ``reference`` means, in ``folder`` (by default that of the file); raises NotFoundError."""
        if "\0" in reference or len(reference) > 1000:
            raise NotFoundError("is no file name")
        reference = reference.replace("\\", "/")
        package = _PACKAGE.match(reference)
        candidates = self._packaged(unquote(package[1])) if package else self._beside(reference, folder)
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
            raise NotFoundError(
                f"lies outside {self.root}; name the folder that it belongs to with `--package NAME=PATH`"
            )
        if package:
            name = package[1].lstrip("/").partition("/")[0]
            raise NotFoundError(f"is not found; say where its package lies: `--package {name}=PATH`")
        raise NotFoundError("does not exist")

    def _beside(self, reference: str, folder: Path | None) -> Iterator[tuple[Path, Path]]:
        reference = reference.removeprefix("file://")
        yield (folder or self.file.resolve().parent) / reference, self.root
        for place in self.packages.values():
            yield place / reference, place

    def _packaged(self, path: str) -> Iterator[tuple[Path, Path]]:
        """Candidates for ``package://NAME/REST``: named packages, then folders upward, then without any name."""
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
        for place in self.packages.values():
            yield place / path, place
        for folder in above[:3]:
            yield folder / path, self.root


def refused(file: Path, line: int, reference: str, error: NotFoundError) -> ImportRefusedError:
    """The error for a file that is needed and not to be had."""
    return ImportRefusedError(file, f"`{reference[:120]}` {error}", line)
