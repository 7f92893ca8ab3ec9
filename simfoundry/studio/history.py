"""Steps of editing that can be undone and redone without end, as changes of texts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

# Texts of documents by resolved path.
Texts = Mapping[Path, str]


@dataclass(frozen=True)
class TextChange:
    """A change of one text: ``removed``, which starts at the character ``start``, becomes ``inserted``."""

    path: Path
    start: int
    removed: str
    inserted: str

    @classmethod
    def between(cls, path: Path, before: str, after: str) -> TextChange:
        """Return the smallest single change that turns one text into another."""
        start = _common_length(before, after)
        shortest = min(len(before), len(after)) - start
        same = _common_length(before[len(before) - shortest :][::-1], after[len(after) - shortest :][::-1])
        return cls(path, start, before[start : len(before) - same], after[start : len(after) - same])

    @property
    def inverse(self) -> TextChange:
        """Return the change that undoes this one."""
        return TextChange(self.path, self.start, self.inserted, self.removed)

    def apply(self, text: str) -> str:
        """Return the text after the change.

        Raises:
            ValueError: If the text does not have the content that the change replaces.
        """
        end = self.start + len(self.removed)
        if text[self.start : end] != self.removed:
            raise ValueError(f"the change does not fit the text of {self.path}")
        return text[: self.start] + self.inserted + text[end:]


def _common_length(a: str, b: str) -> int:
    """Return the number of characters with which both texts start."""
    low, high = 0, min(len(a), len(b))
    while low < high:  # comparing slices is much faster than comparing characters
        middle = (low + high + 1) // 2
        low, high = (middle, high) if a[:middle] == b[:middle] else (low, middle - 1)
    return low


@dataclass(frozen=True)
class EditStep:
    """One step of editing.

    Attributes:
        label: What happened, such as ``move mug``.
        changes: The changes of texts, at most one for each document.
        gesture: Name of the continuous gesture that the step belongs to, such as that of a slider, or empty.
    """

    label: str
    changes: tuple[TextChange, ...]
    gesture: str = ""

    @classmethod
    def between(cls, label: str, before: Texts, after: Texts, gesture: str = "") -> EditStep:
        """Return the step from some texts to others. Texts that are only in ``before`` do not change."""
        changed = (path for path in after if after[path] != before[path])
        return cls(label, tuple(TextChange.between(path, before[path], after[path]) for path in changed), gesture)

    def forward(self, texts: Texts) -> dict[Path, str]:
        """Return the texts after the step."""
        return {**texts, **{change.path: change.apply(texts[change.path]) for change in self.changes}}

    def backward(self, texts: Texts) -> dict[Path, str]:
        """Return the texts before the step."""
        return {**texts, **{change.path: change.inverse.apply(texts[change.path]) for change in self.changes}}


@dataclass
class EditHistory:
    """The steps that were taken, oldest first, and those that were undone, of which the last is redone first."""

    done: list[EditStep] = field(default_factory=list)
    undone: list[EditStep] = field(default_factory=list)

    @property
    def labels(self) -> tuple[str, ...]:
        """The labels of the steps that can be undone, oldest first."""
        return tuple(step.label for step in self.done)

    def push(self, step: EditStep, before: Texts) -> None:
        """Add a step that has been taken, which replaces the latest step of the same gesture.

        Args:
            step: The step.
            before: The texts before it.
        """
        self.undone.clear()
        if self.done and step.gesture and self.done[-1].gesture == step.gesture:
            start = self.done.pop().backward(before)
            step = EditStep.between(step.label, start, step.forward(before), step.gesture)
        if step.changes:
            self.done.append(step)

    def end_gesture(self) -> None:
        """Let the next step be a step of its own, even if it has the gesture of the latest one."""
        if self.done and self.done[-1].gesture:
            last = self.done.pop()
            self.done.append(EditStep(last.label, last.changes))

    def undo(self, texts: Texts) -> tuple[EditStep, dict[Path, str]] | None:
        """Return the latest step and the texts before it, or None if there is no step."""
        if not self.done:
            return None
        step = self.done[-1]
        before = step.backward(texts)
        self.undone.append(self.done.pop())
        return step, before

    def redo(self, texts: Texts) -> tuple[EditStep, dict[Path, str]] | None:
        """Return the step that was undone last and the texts after it, or None if there is no step."""
        if not self.undone:
            return None
        step = self.undone[-1]
        after = step.forward(texts)
        self.done.append(self.undone.pop())
        return step, after


@dataclass(frozen=True, eq=False)
class UnsavedState:
    """The state of a session with edits that are not saved, from which another session can continue.

    Attributes:
        texts: The texts by resolved path.
        files: The texts of the files, as the session last saw them.
        history: The steps that can be undone and redone.
    """

    texts: dict[Path, str]
    files: dict[Path, str]
    history: EditHistory
