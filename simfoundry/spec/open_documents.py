"""Load the documents of an editor again and again, as open files are edited and other files change on disk."""

from __future__ import annotations

import os
from pathlib import Path
from typing import NamedTuple

from simfoundry.runtime.file_changes import Stamp, file_stamp
from simfoundry.spec.diagnostics import Severity
from simfoundry.spec.files import Loaded, resolved
from simfoundry.spec.load import Known, load
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.text import Document, parse, read

# Maximum number of documents that are kept, which limits the memory; a project of 100 objects has about as many.
MAX_KEPT = 256


class _Text(NamedTuple):
    version: int
    text: str


class OpenDocuments:
    """The texts that an editor shows in place of files, and the documents that were loaded with them.

    A document is kept until a file that it was read from changes, in the editor or on disk. Documents with errors are
    not kept, because files may be missing that are created later. Other threads may edit and read texts meanwhile.
    """

    def __init__(self) -> None:
        self._texts: dict[str, _Text] = {}
        self._edits = 0
        self._is_outdated = False
        self._known: dict[Path, Known] = {}  # by the folder of the project
        self._read: dict[str, Stamp] = {}  # state in which each file was last read
        # States of the files of each document that is kept, by the identity of the document.
        self._stamps: dict[int, dict[str, Stamp]] = {}

    def edit(self, path: Path, text: str | None) -> None:
        """Use ``text`` in place of the content of a file, or the file itself if ``text`` is None."""
        file = os.path.realpath(path)
        if text is None:
            self._texts.pop(file, None)
        elif (known := self._texts.get(file)) is None or known.text != text:
            self._edits += 1
            self._texts[file] = _Text(self._edits, text)

    def read(self, path: Path) -> Document:
        """Read the open text of a file, or the file itself if it is not open.

        Raises:
            YamlError: If the text could not be read; the error contains the position.
        """
        file = os.path.realpath(path)
        shown = self._texts.get(file)
        return read(path) if shown is None else parse(shown.text, str(path))

    def _noted(self, path: Path) -> Document:
        """Read the text of a file, and note its state before, so that a change meanwhile is noticed."""
        self._read[os.path.realpath(path)] = self.stamp(path)
        return self.read(path)

    @property
    def files(self) -> frozenset[str]:
        """Return the resolved paths of the files that are open."""
        return frozenset(tuple(self._texts))

    def stamp(self, path: Path) -> Stamp:
        """Return what identifies the text of a file, which differs after each edit and each change on disk."""
        file = os.path.realpath(path)
        shown = self._texts.get(file)
        return file_stamp(Path(file)) if shown is None else (shown.version,)

    def load(self, path: Path) -> Loaded:
        """Read and check one document; see :func:`simfoundry.spec.load.load`."""
        root = resolved(project_root(path))
        self._drop_changed()
        known = self._known.setdefault(root, {})
        file = os.path.realpath(path)
        for kind in KINDS:
            kept = known.get((file, kind))
            if kept is not None and kept.path == path:
                return kept
        loaded = load(path, root, known, reader=self._noted)
        if loaded.spec is not None:
            known[file, str(getattr(loaded.spec, "simfoundry"))] = loaded  # noqa: B009
        self._keep()
        return loaded

    def forget(self) -> None:
        """Forget all loaded documents, because files that are not documents, such as meshes, have changed on disk."""
        self._is_outdated = True  # the thread that loads documents may be using them

    def _keep(self) -> None:
        """Note the files of the documents that have been loaded, and drop the documents that are not kept."""
        if sum(map(len, self._known.values())) > MAX_KEPT:
            self._drop_all()
        for known in self._known.values():
            for key, loaded in tuple(known.items()):
                if loaded is None or any(d.severity is Severity.ERROR for d in loaded.all_findings()):
                    del known[key]
                elif id(loaded) not in self._stamps:
                    self._stamps[id(loaded)] = {
                        str(file): self._read.get(os.path.realpath(file), ()) for file in loaded.files()
                    }

    def _drop_all(self) -> None:
        self._known.clear()
        self._stamps.clear()
        self._read.clear()

    def _drop_changed(self) -> None:
        """Drop the documents that were read from files that have changed since."""
        if self._is_outdated:
            self._is_outdated = False
            self._drop_all()
        now: dict[str, Stamp] = {}
        stamps: dict[int, dict[str, Stamp]] = {}
        for known in self._known.values():
            for key, loaded in tuple(known.items()):
                read_from = self._stamps.get(id(loaded))  # missing if an error ended the load
                if read_from is not None and all(self._now(file, now) == stamp for file, stamp in read_from.items()):
                    stamps[id(loaded)] = read_from
                else:
                    del known[key]
        self._stamps = stamps

    def _now(self, path: str, found: dict[str, Stamp]) -> Stamp:
        if path not in found:
            found[path] = self.stamp(Path(path))
        return found[path]
