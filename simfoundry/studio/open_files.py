"""The files of a session: what they contained when they were last read or written, and how the texts differ from that.

The texts themselves belong to the session, which passes them to each function. All paths are resolved.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.change.text_diff import unified_diff
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.studio.disk import DiskChanges, DiskFile, DiskQuestion, encoded, file_stamp, taken_in

Texts = Mapping[Path, str]

# Number of lines around a change in a diff, so that the change of one value fits beside the scene without scrolling.
CONTEXT = 1


class OpenFiles:
    """The files of the documents that a session has opened.

    Attributes:
        root: The folder of the project. Nothing outside of it is read or written.
        held: Findings about files whose changes on disk cannot be taken in.
        questions: The conflicts between edits and changes on disk that a person has to decide.
    """

    def __init__(self, root: Path) -> None:
        self.root = root
        self.held: dict[Path, Diagnostic] = {}
        self.questions: tuple[DiskQuestion, ...] = ()
        self._files: dict[Path, DiskFile] = {}

    def __contains__(self, path: Path) -> bool:
        return path in self._files

    @property
    def paths(self) -> frozenset[Path]:
        """The paths of the files."""
        return frozenset(self._files)

    @property
    def texts(self) -> dict[Path, str]:
        """The texts of the files, as they were last read or written."""
        return {path: file.text for path, file in self._files.items()}

    def open(self, path: Path) -> str:
        """Read a file for editing, and return its text.

        Raises:
            SimfoundryError: If the file is outside of the project or cannot be read.
        """
        if not path.is_relative_to(self.root):
            raise SimfoundryError(f"{path} is outside of the project {self.root}, so it is not edited here")
        self._files[path] = file = DiskFile.read(path)
        return file.text

    def assume(self, texts: Texts) -> None:
        """Take texts for those that were last read, as in an earlier session, so that the files are looked at again."""
        self._files |= {path: DiskFile(path, encoded(text), (0,)) for path, text in texts.items()}

    def is_modified(self, texts: Texts) -> bool:
        """Return True if a text differs from its file."""
        return any(texts[path] != file.text for path, file in self._files.items())

    def shown_path(self, path: Path) -> str:
        """Return the path of a document relative to the project."""
        return path.relative_to(self.root).as_posix() if path.is_relative_to(self.root) else str(path)

    def diff(self, texts: Texts) -> str:
        """Return the unified diff from the files to the texts, which is empty if there is nothing to save."""
        shown = ((self.shown_path(path), path, file) for path, file in sorted(self._files.items()))
        return "".join(unified_diff(file.text, texts[path], name, name, CONTEXT) for name, path, file in shown)

    def stamps(self, also: Iterable[Path]) -> Mapping[Path, tuple[int, ...]]:
        """Return what identifies the states of the files, and of others."""
        return {path: file_stamp(path) for path in (*self._files, *also)}

    def take_in(self, texts: Texts) -> DiskChanges | None:
        """Take in the changes of the files, and return the texts merged with them, or None if nothing has changed."""
        found = taken_in(self._files, texts, self.held, self.questions)
        is_same = (found.texts, found.held, found.questions) == (texts, self.held, self.questions)
        self._files = dict(found.files)
        self.held, self.questions = dict(found.held), found.questions
        return None if is_same else found

    def write(self, texts: Texts) -> tuple[Path, ...]:
        """Write all texts that differ from their files, or none of them, and return the files that were written.

        Raises:
            SimfoundryError: If a change on disk could not be taken in, or if a file cannot be written.
        """
        from simfoundry.runtime.files import write_all_in_place, write_in_place

        if self.held:
            held = next(iter(self.held.values()))
            raise SimfoundryError(f"{held.file} was not saved, because {held.message}; correct it there first")
        if self.questions:
            raise SimfoundryError("answer the questions about changes on disk before you save")
        deleted = [path for path in self._files if not path.exists()]
        changed = {p: f for p, f in self._files.items() if f.text != texts[p] and p not in deleted}
        try:
            write_all_in_place({p: (f.data, encoded(texts[p])) for p, f in changed.items()})
            for path in deleted:
                write_in_place(path, encoded(texts[path]))
        except OSError as error:
            folder = Path(error.filename).parent if error.filename else self.root
            reason = f"a file in {folder} cannot be written ({error.strerror or error})"
            raise SimfoundryError(f"{reason}; the edits stay in the studio") from None
        for path in (*changed, *deleted):
            self._files[path] = DiskFile.read(path)
        return (*changed, *deleted)
