"""An editing session: the texts of the open documents, their history, their files, and the last good scene.

A session knows nothing of the browser. Views subscribe to it, and acts change it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from threading import RLock
from types import MappingProxyType

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.file_changes import Stamp
from simfoundry.spec.change.edit_data import edited_text
from simfoundry.spec.change.edit_text import prepare_edit
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.files import Loaded
from simfoundry.spec.open_documents import OpenDocuments
from simfoundry.spec.project import project_root
from simfoundry.studio.acts.act import Act, ActEdits, ActError, resolved_path
from simfoundry.studio.disk import DiskQuestion, answered
from simfoundry.studio.history import EditHistory, EditStep, UnsavedState
from simfoundry.studio.open_files import OpenFiles
from simfoundry.studio.reading import Reading, StudioScene, changed_objects, lint_findings, read_session

# Called after each change of a session, with what happened.
Listener = Callable[[str], None]

FROM_DISK = "change on disk"


class StudioSession:
    """The state of one studio, which all its windows share. Methods may be called from several threads.

    Attributes:
        path: The document that was opened, a scene or a task.
        root: The folder of its project. Nothing outside of it is read or written.
        version: A number that increases with each change of the texts or of the findings.
        locked: Names of objects that no act may change.
    """

    def __init__(self, path: Path) -> None:
        """Open a document.

        Raises:
            SimfoundryError: If the file is not a document that can be edited.
        """
        self.path = resolved_path(path)
        self.root = resolved_path(project_root(self.path))
        self.version = 0
        self.locked: frozenset[str] = frozenset()
        if not self.path.is_file():
            raise SimfoundryError(f"{path} is not a file; the studio opens scenes and tasks")
        self._lock = RLock()
        self._documents = OpenDocuments()
        self._history = EditHistory()
        self._files = OpenFiles(self.root)
        self._listeners: list[Listener] = []
        self._stamps: dict[Path, Stamp] = {}  # states of the documents that are used, but not open here
        self._texts: dict[Path, str] = {}
        self._open(self.path)
        self._reading = self._read(self._texts)
        self._scene = self._reading.scene
        self._findings = self._reading.findings
        self._open_used()

    # -- state ------------------------------------------------------------------------------------------------------

    @property
    def lock(self) -> RLock:
        """The lock that is held while the session changes."""
        return self._lock

    @property
    def texts(self) -> Mapping[Path, str]:
        """The texts of the open documents, by resolved path."""
        return MappingProxyType(self._texts)

    @property
    def text(self) -> str:
        """The text of the document that was opened."""
        return self._texts[self.path]

    @property
    def documents(self) -> OpenDocuments:
        """The open documents, for code that loads documents with the texts of the session."""
        return self._documents

    @property
    def reading(self) -> Reading:
        """The meaning of the current texts, which may be invalid."""
        return self._reading

    @property
    def scene(self) -> StudioScene | None:
        """The last good scene, or None if there has not been any."""
        return self._scene

    @property
    def is_current(self) -> bool:
        """True if the last good scene is that of the present texts."""
        return self._reading.scene is not None and self._reading.scene is self._scene

    @property
    def findings(self) -> tuple[Diagnostic, ...]:
        """The findings in the present texts. Those of lints appear once :meth:`examine` has run."""
        return (*self._files.held.values(), *self._findings)

    @property
    def questions(self) -> tuple[DiskQuestion, ...]:
        """The conflicts between edits here and edits on disk that a person has to decide."""
        return self._files.questions

    @property
    def undo_label(self) -> str:
        """The label of the step that would be undone, or an empty string."""
        return self._history.done[-1].label if self._history.done else ""

    @property
    def redo_label(self) -> str:
        """The label of the step that would be redone, or an empty string."""
        return self._history.undone[-1].label if self._history.undone else ""

    @property
    def history(self) -> EditHistory:
        """The steps that can be undone and redone, which only the session changes."""
        return self._history

    @property
    def file_texts(self) -> Mapping[Path, str]:
        """The texts of the files of the open documents, as they were last read or written here."""
        return self._files.texts

    @property
    def is_modified(self) -> bool:
        """True if a text differs from its file."""
        return self._files.is_modified(self._texts)

    def subscribe(self, listener: Listener) -> Callable[[], None]:
        """Call ``listener`` after each change. Returns a function that ends the subscription."""
        self._listeners.append(listener)
        return lambda: self._listeners.remove(listener) if listener in self._listeners else None

    # -- acts -------------------------------------------------------------------------------------------------------

    def apply(self, act: Act, gesture: str = "") -> tuple[str, ...]:
        """Change the texts by an act.

        Args:
            act: The act.
            gesture: Name of the continuous gesture that the act belongs to. Acts of one gesture are undone together.

        Returns:
            Whole sentences about what the act did not change.

        Raises:
            ActError: If the act is not possible, or if ``check`` would find a new error. Nothing is changed.
        """
        with self._lock:
            if self._scene is None or not self.is_current:
                raise ActError(f"the text has an error, so it cannot be edited here: {self._reading.first_error}")
            edits = act.edits(self._scene)
            after = self._edited(edits)
            if after == self._texts:
                return edits.notes
            reading = self._read(after)
            if reading.errors or reading.scene is None:
                self._show_texts(self._texts)
                raise ActError(f"{act.label}: {reading.first_error}")
            if locked := changed_objects(self._scene, reading.scene, self.locked):
                self._show_texts(self._texts)
                raise ActError(f"{act.label}: `{locked[0]}` is locked; unlock it under Capture first")
            step = EditStep.between(act.label, self._texts, after, gesture)
            self._history.push(step, self._texts)
            self._set(after, reading)
        self._notify(act.label)
        return edits.notes

    def end_gesture(self) -> None:
        """End a continuous gesture, so that the next act is undone on its own."""
        with self._lock:
            self._history.end_gesture()

    def undo(self) -> str:
        """Undo the latest step, and return its label, or an empty string if there is nothing to undo."""
        return self._travel(self._history.undo)

    def redo(self) -> str:
        """Redo the step that was undone last, and return its label, or an empty string if there is none."""
        return self._travel(self._history.redo)

    def _travel(self, move: Callable[[Mapping[Path, str]], tuple[EditStep, dict[Path, str]] | None]) -> str:
        with self._lock:
            found = move(self._texts)
            if found is None:
                return ""
            step, texts = found
            self._set(texts, self._read(texts))
        self._notify(step.label)
        return step.label

    def _edited(self, edits: ActEdits) -> dict[Path, str]:
        """Return the texts after edits."""
        for path in edits.texts:
            self._open(path)
        after = {**self._texts, **edits.texts}
        for path, values in edits.values.items():
            loaded = self._loaded(path)
            if loaded is None or loaded.source is None:
                raise ActError(f"{path} cannot be edited here, because it is not open")
            after[self._open(path)] = edited_text(loaded, values, self._documents.read)
        return after

    def _loaded(self, path: Path) -> Loaded | None:
        todo = [self._reading.loaded]
        while todo:
            loaded = todo.pop()
            if resolved_path(loaded.path) == path:
                return loaded
            todo += loaded.uses.values()
        return None

    # -- files ------------------------------------------------------------------------------------------------------

    def diff(self) -> str:
        """Return the unified diff from the files on disk to the texts, which is empty if there is nothing to save."""
        with self._lock:
            return self._files.diff(self._texts)

    def shown_path(self, path: Path) -> str:
        """Return the path of a document relative to the project."""
        return self._files.shown_path(path)

    def save(self) -> tuple[Path, ...]:
        """Write all texts that differ from their files, or none of them, and return the files that were written.

        Raises:
            SimfoundryError: If a file has changed on disk in a way that conflicts, or if it cannot be written.
        """
        with self._lock:
            self.poll()
            written = self._files.write(self._texts)
            self.version += 1
        self._notify("save")
        return written

    def poll(self) -> bool:
        """Take in changes of files on disk, and return True if there were any.

        A text without edits follows its file. Otherwise, both are merged, and conflicts become questions. A file that
        cannot be merged, because it is not valid YAML, is reported as a finding until it changes again.
        """
        with self._lock:
            found = self._files.take_in(self._texts)
            if not self._has_other_change() and found is None:
                return False
            texts = self._texts if found is None else found.texts
            self._history.push(EditStep.between(FROM_DISK, self._texts, texts), self._texts)
            self._set(texts, self._read(texts))
        self._notify(FROM_DISK)
        return True

    def disk_state(self) -> Mapping[Path, tuple[int, ...]]:
        """Return what identifies the states of all files of the session, for a cheap look at changes."""
        return self._files.stamps(resolved_path(file) for file in self._reading.loaded.files())

    def _has_other_change(self) -> bool:
        """Return True if a document that is used, but not open here, has changed since the last call."""
        used = {resolved_path(file) for file in self._reading.loaded.files()} - self._files.paths
        before, self._stamps = self._stamps, {path: self._documents.stamp(path) for path in used}
        return any(before.get(path, stamp) != stamp for path, stamp in self._stamps.items())

    def answer(self, question: DiskQuestion, take_disk: bool) -> None:
        """Decide a question: keep the value of this session, or take that of the file."""
        with self._lock:
            if question not in self._files.questions:
                return
            self._files.questions = tuple(q for q in self._files.questions if q != question)
            texts = dict(self._texts)
            if take_disk:
                texts[question.path] = answered(texts[question.path], question)
                self._history.push(EditStep.between(f"take {question.label}", self._texts, texts), self._texts)
            self._set(texts, self._read(texts))
        self._notify("answer")

    def resume(self, earlier: UnsavedState) -> None:
        """Continue from the state of an earlier session, and take in what has changed on disk since.

        Raises:
            SimfoundryError: If there are edits that are not saved, or if a document is outside of the project.
        """
        with self._lock:
            if self.is_modified:
                raise SimfoundryError("save or undo the edits made here before you restore those of an earlier session")
            for path in (path for path in earlier.texts if path.exists()):
                self._open(path)
            self._files.assume(earlier.files)
            self._history = earlier.history
            self._set(earlier.texts, self._read(earlier.texts))
            self.poll()
        self._notify("restore")

    def go_to(self, path: Path) -> None:
        """Go on with another document of the project, such as a task in the scene that is open.

        Raises:
            SimfoundryError: If the document cannot be read, or is outside of the project.
        """
        with self._lock:
            self.path = self._open(path)
            self._set(self._texts, self._read(self._texts))
        self._notify(f"open {path.name}")

    # -- reading ----------------------------------------------------------------------------------------------------

    def examine(self, checkpoint: Callable[[], None] = lambda: None) -> None:
        """Add the findings of lints, which take longer. ``checkpoint`` can raise an exception to stop.

        What the next act needs to know about the texts is prepared, too, because people wait for acts.
        """
        with self._lock:
            reading, texts = self._reading, tuple(self._texts.values())
        for text in texts:
            prepare_edit(text)
            checkpoint()
        findings = lint_findings(reading, checkpoint)
        with self._lock:
            if reading is not self._reading or findings == self._findings:
                return
            self._findings = findings
            self.version += 1
        self._notify("examine")

    def reread(self) -> None:
        """Read all documents again, because files that are not documents, such as meshes, have changed."""
        with self._lock:
            self._documents.forget()
            self._set(self._texts, self._read(self._texts, afresh=True))
        self._notify("reread")

    def _read(self, texts: Mapping[Path, str], afresh: bool = False) -> Reading:
        self._show_texts(texts)
        earlier = None if afresh else getattr(self, "_scene", None)
        return read_session(self.path, self._documents, texts, earlier)

    def _show_texts(self, texts: Mapping[Path, str]) -> None:
        for path, text in texts.items():
            self._documents.edit(path, text)

    def _set(self, texts: Mapping[Path, str], reading: Reading) -> None:
        self._texts = dict(texts)
        self._reading, self._findings = reading, reading.findings
        if reading.scene is not None:
            self._scene = replace(reading.scene, texts=MappingProxyType(self._texts))
            self._reading = replace(reading, scene=self._scene)
        self._open_used()
        self.version += 1

    def _open(self, path: Path) -> Path:
        """Open a document for editing, and return its resolved path.

        Raises:
            SimfoundryError: If the file is outside of the project or cannot be read.
        """
        path = resolved_path(path)
        if path not in self._files:
            self._texts[path] = self._files.open(path)
        return path

    def _open_used(self) -> None:
        """Open the scene of a task, so that changes of its file are noticed and merged."""
        scene = self._reading.scene
        if scene is not None and resolved_path(scene.loaded.path).is_relative_to(self.root):
            self._open(scene.loaded.path)

    def _notify(self, what: str) -> None:
        for listener in tuple(self._listeners):
            listener(what)
