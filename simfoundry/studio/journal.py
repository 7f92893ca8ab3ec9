"""The journal of a session: acts that are not saved are also on disk, so that a killed server loses none of them.

Each change adds a line to a file in the user's state folder, which is emptied as soon as nothing is unsaved. A journal
that still contains something when its program is gone is offered by the next studio that opens the document.
"""

from __future__ import annotations

import hashlib
import json
import os
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

from simfoundry.errors import OutputError, SimfoundryError
from simfoundry.runtime.files import locked_folder
from simfoundry.studio.history import EditHistory, EditStep, TextChange, UnsavedState
from simfoundry.studio.session import StudioSession

# Name of the file in each folder.
FILE = "journal.jsonl"

# Number of studios of one document that keep a journal at the same time. More people share one studio.
SLOTS = 8

# Maximum size of a journal [bytes]; an act takes some hundred bytes, so that this is a million acts.
MAX_BYTES = 256 * 2**20

# What reading a damaged line can raise.
_DAMAGE = (ValueError, KeyError, TypeError, AttributeError, IndexError, RecursionError)


def state_folder() -> Path:
    """Return the folder of all journals: below ``$XDG_STATE_HOME`` or ``~/.local/state``."""
    base = os.environ.get("XDG_STATE_HOME")
    return (Path(base) if base else Path.home() / ".local" / "state") / "simfoundry" / "studio"


def document_folder(document: Path, folder: Path | None = None) -> Path:
    """Return the folder of the state of a document, given by its resolved path, below that of the user by default."""
    key = hashlib.sha256(str(document).encode(errors="surrogateescape")).hexdigest()[:20]
    return (folder or state_folder()) / key


class Journal:
    """The journal of one session, and what earlier sessions of the same document left unsaved.

    Attributes:
        problem: The reason why the journal cannot be written, or an empty string.
    """

    def __init__(self, session: StudioSession, folder: Path | None = None) -> None:
        """Begin a journal, and find those that were left behind.

        Args:
            session: The session.
            folder: The folder of all journals, by default that of the user.
        """
        self.problem = ""
        self._session = session
        self._locks = ExitStack()
        self._stream: IO[bytes] | None = None
        self._left: list[tuple[Path, UnsavedState]] = []
        self._files: dict[Path, str] = {}
        self._done: list[EditStep] = []
        self._undone: list[EditStep] = []
        try:
            self._begin(document_folder(session.path, folder))
        except OSError as error:
            self.problem = f"edits that are not saved are not kept if the studio is killed: {error}"
        self._unsubscribe = session.subscribe(lambda _what: self.record())
        self.record()

    def _begin(self, folder: Path) -> None:
        """Take the first free slot, and lock those that contain something and belong to nobody."""
        for k in range(1, SLOTS + 1):
            slot = folder / str(k)
            if self._stream is not None and not slot.exists():
                continue
            slot.mkdir(parents=True, exist_ok=True, mode=0o700)  # texts may be confidential
            with ExitStack() as locks:
                try:
                    locks.enter_context(locked_folder(slot, "is in use"))
                except OutputError:
                    continue
                left = read_journal(slot / FILE)
                if left is not None:
                    self._left.append((slot / FILE, left))
                elif self._stream is None:
                    self._stream = locks.enter_context((slot / FILE).open("wb"))
                else:
                    continue
                self._locks.push(locks.pop_all())
        if self._stream is None:
            self.problem = (
                f"edits that are not saved are not kept if the studio is killed: all {SLOTS} journals of this document "
                f"are in use; restore or discard what earlier studios left unsaved, or delete {folder}"
            )

    @property
    def unsaved(self) -> tuple[UnsavedState, ...]:
        """Unsaved edits of earlier sessions."""
        return tuple(state for _, state in self._left)

    def restore(self, state: UnsavedState) -> None:
        """Continue from what an earlier session left unsaved.

        Raises:
            SimfoundryError: If there are edits that are not saved, or if a document is outside of the project.
        """
        outside = [path for path in (*state.texts, *state.files) if not path.is_relative_to(self._session.root)]
        if outside:
            raise SimfoundryError(f"{outside[0]} is outside of the project {self._session.root}, so it is not restored")
        self._session.resume(state)
        self.discard(state)

    def discard(self, state: UnsavedState) -> None:
        """Forget what an earlier session left unsaved."""
        for path, left in self._left:
            if left is state:
                path.unlink(missing_ok=True)
        self._left = [(path, left) for path, left in self._left if left is not state]
        if self._stream is None and not self._left:
            self.problem = ""

    def record(self) -> None:
        """Write what has changed since the last call, or empty the journal if nothing is unsaved."""
        with self._session.lock:
            if self._stream is None:
                return
            try:
                if self._session.is_modified:
                    self._append(self._stream)
                elif self._files:
                    self._files, self._done, self._undone = {}, [], []
                    self._stream.seek(0)
                    self._stream.truncate()
                self.problem = ""
            except OSError as error:
                self.problem = f"the journal of unsaved edits cannot be written: {error}"

    def _append(self, stream: IO[bytes]) -> None:
        session = self._session
        asked = {question.path for question in session.questions}  # the merge is repeated, which asks again
        files = {
            path: text for path, text in session.file_texts.items() if path not in asked or path not in self._files
        }
        changed = {str(path): text for path, text in files.items() if self._files.get(path) != text}
        entry: dict[str, Any] = {"files": changed} if changed else {}
        if not self._files:
            entry["texts"] = {str(path): text for path, text in session.texts.items()}
        for key, old, new in (
            ("done", self._done, session.history.done),
            ("undone", self._undone, session.history.undone),
        ):
            kept = _common(old, new)
            if kept < max(len(old), len(new)):
                entry[key] = [kept, [_step_data(step) for step in new[kept:]]]
        if entry:
            stream.write(json.dumps(entry, separators=(",", ":")).encode() + b"\n")
            stream.flush()
            os.fsync(stream.fileno())  # so that not even a crash of the machine loses it
        self._files |= files
        self._done, self._undone = list(session.history.done), list(session.history.undone)

    def close(self) -> None:
        """End the journal. What it contains is offered by the next session."""
        self._unsubscribe()
        with self._session.lock:
            self._stream = None
            self._locks.close()


def read_journal(path: Path) -> UnsavedState | None:
    """Read a journal, or return None if it contains nothing. A line that was cut off or damaged ends it."""
    if not path.is_file() or path.stat().st_size > MAX_BYTES:
        return None
    state = UnsavedState({}, {}, EditHistory())
    with path.open("rb") as stream:
        for line in stream:
            if not line.endswith(b"\n"):
                break
            try:
                state = _after(state, json.loads(line))
            except _DAMAGE:
                break
    return state if any(state.files.get(path) != text for path, text in state.texts.items()) else None


def _after(state: UnsavedState, entry: dict[str, Any]) -> UnsavedState:
    """Return the state after one line of a journal."""
    new_files = {Path(path): str(text) for path, text in entry.get("files", {}).items()}
    done, undone = _changed(state.history.done, entry.get("done")), _changed(state.history.undone, entry.get("undone"))
    if "texts" in entry:
        texts = {Path(path): str(text) for path, text in entry["texts"].items()}
        return UnsavedState(texts, new_files, EditHistory(done, undone))
    texts = {**new_files, **state.texts}
    kept = _common(state.history.done, done)
    for step in reversed(state.history.done[kept:]):
        texts = step.backward(texts)
    for step in done[kept:]:
        texts = step.forward(texts)
    return UnsavedState(texts, {**state.files, **new_files}, EditHistory(done, undone))


def _changed(steps: list[EditStep], change: Any) -> list[EditStep]:
    if change is None:
        return list(steps)
    kept, added = change
    return [*steps[: int(kept)], *(_read_step(data) for data in added)]


def _common(old: list[EditStep], new: list[EditStep]) -> int:
    """Return the number of steps with which both lists start."""
    pairs = enumerate(zip(old, new, strict=False))
    return next((k for k, (a, b) in pairs if a is not b), min(len(old), len(new)))


def _step_data(step: EditStep) -> list[Any]:
    changes = [[str(change.path), change.start, change.removed, change.inserted] for change in step.changes]
    return [step.label, step.gesture, changes]


def _read_step(data: list[Any]) -> EditStep:
    label, gesture, changes = data
    read = (TextChange(Path(path), int(start), str(old), str(new)) for path, start, old, new in changes)
    return EditStep(str(label), tuple(read), str(gesture))
