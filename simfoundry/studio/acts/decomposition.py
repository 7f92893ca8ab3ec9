"""State what a person knows about the objects in a capture: the next reconstruction respects it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from simfoundry.spec.change.edit_data import edited_text
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.files import Loaded
from simfoundry.spec.load import load
from simfoundry.spec.models.capture import CaptureSpec, Decomposition, Pixel
from simfoundry.spec.project import project_root
from simfoundry.spec.yaml.text import Document, parse, read
from simfoundry.studio.acts.act import ActEdits, ActError, resolved_path
from simfoundry.studio.reading import StudioScene


@dataclass(frozen=True)
class CaptureFrame:
    """A frame of a capture document."""

    document: Path
    frame: str


Pieces = dict[str, tuple[Pixel, ...]]
Occlusions = dict[str, tuple[str, ...]]


@dataclass(frozen=True)
class MergePieces:
    """State that several objects are one piece, which has the name of the first.

    Attributes:
        source: The frame of the capture.
        pixels: A pixel (column, row) on each object, by name.
    """

    source: CaptureFrame
    pixels: Mapping[str, Pixel] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"merge {' and '.join(self.pixels)}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the new text of the capture document."""
        if len(self.pixels) < 2:
            raise ActError("at least two objects are needed to merge them")
        loaded, given = _decomposition(scene, self.source)
        kept, *others = self.pixels
        pieces = dict(given.pieces)
        merged = [pixel for name, at in self.pixels.items() for pixel in pieces.get(name, (at,))]
        pieces = {name: pixels for name, pixels in pieces.items() if name not in others}
        pieces[kept] = tuple(dict.fromkeys(merged))
        occludes: Occlusions = {}
        for name, hidden in given.occludes.items():
            owner = kept if name in others else name
            known = [kept if each in others else each for each in hidden]
            occludes[owner] = tuple(dict.fromkeys(n for n in [*occludes.get(owner, ()), *known] if n != owner))
        return _edits(loaded, self.source, pieces, given.ignore, occludes)


@dataclass(frozen=True)
class SplitPiece:
    """State that what is one object in the scene is several.

    Attributes:
        source: The frame of the capture.
        name: The object.
        parts: Pixels (column, row) on each of its parts, by the name of the part.
    """

    source: CaptureFrame
    name: str
    parts: Mapping[str, tuple[Pixel, ...]] = field(default_factory=dict)

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"split {self.name}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the new text of the capture document."""
        if len(self.parts) < 2 or not all(self.parts.values()):
            raise ActError("mark at least one point on each of two parts to split an object")
        loaded, given = _decomposition(scene, self.source)
        taken = [name for name in self.parts if name != self.name and name in given.pieces]
        if taken:
            raise ActError(f"the capture already has a piece `{taken[0]}`; choose another name")
        pieces = {name: pixels for name, pixels in given.pieces.items() if name != self.name}
        occludes = given.occludes if self.name in self.parts else _without(given.occludes, self.name)
        return _edits(loaded, self.source, {**pieces, **dict(self.parts)}, given.ignore, occludes)


@dataclass(frozen=True)
class IgnorePiece:
    """State that what was found is not an object.

    Attributes:
        source: The frame of the capture.
        name: The object.
        pixel: A pixel (column, row) on it.
    """

    source: CaptureFrame
    name: str
    pixel: Pixel

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"ignore {self.name} in the capture"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the new text of the capture document."""
        loaded, given = _decomposition(scene, self.source)
        pieces = {name: pixels for name, pixels in given.pieces.items() if name != self.name}
        ignore = tuple(dict.fromkeys((*given.ignore, self.pixel)))
        return _edits(loaded, self.source, pieces, ignore, _without(given.occludes, self.name))


@dataclass(frozen=True)
class StateOcclusion:
    """State that one object occludes another, or that it does not.

    Attributes:
        source: The frame of the capture.
        front: Name and pixel (column, row) of the object in front.
        behind: Name and pixel of the object behind it.
        holds: Whether it occludes it.
    """

    source: CaptureFrame
    front: tuple[str, Pixel]
    behind: tuple[str, Pixel]
    holds: bool = True

    @property
    def label(self) -> str:
        """Return a short description."""
        return f"{self.front[0]} {'occludes' if self.holds else 'does not occlude'} {self.behind[0]}"

    def edits(self, scene: StudioScene) -> ActEdits:
        """Return the new text of the capture document."""
        loaded, given = _decomposition(scene, self.source)
        pieces, (front, behind) = dict(given.pieces), (self.front[0], self.behind[0])
        hidden = [name for name in given.occludes.get(front, ()) if name != behind]
        if self.holds:
            pieces.setdefault(front, (self.front[1],))
            pieces.setdefault(behind, (self.behind[1],))
            hidden.append(behind)
        return _edits(loaded, self.source, pieces, given.ignore, {**given.occludes, front: tuple(hidden)})


def stated_decomposition(scene: StudioScene, source: CaptureFrame) -> Decomposition:
    """Return the constraints that a capture document states for a frame.

    Raises:
        ActError: If the document cannot be read.
    """
    return _decomposition(scene, source)[1]


def _without(occludes: Mapping[str, tuple[str, ...]], gone: str) -> Occlusions:
    return {name: tuple(n for n in hidden if n != gone) for name, hidden in occludes.items() if name != gone}


def _decomposition(scene: StudioScene, source: CaptureFrame) -> tuple[Loaded, Decomposition]:
    """Return the capture document with its present text, and the constraints of a frame."""
    path = resolved_path(source.document)

    def reader(file: Path) -> Document:
        text = scene.texts.get(resolved_path(file))
        return read(file) if text is None else parse(text, str(file))

    loaded = load(path, project_root(path), {}, reader=reader)
    if not isinstance(loaded.spec, CaptureSpec):
        reason = next((d.message for d in loaded.all_findings()), "it is not a capture")
        raise ActError(f"{path.name} cannot be edited: {reason}")
    if source.frame not in loaded.spec.frames:
        raise ActError(f"{path.name} has no frame `{source.frame}`")
    return loaded, loaded.spec.frames[source.frame].decomposition or Decomposition()


def _edits(
    loaded: Loaded, source: CaptureFrame, pieces: Pieces, ignore: tuple[Pixel, ...], occludes: Mapping[str, Any]
) -> ActEdits:
    data: dict[str, Any] = {
        "pieces": {name: tuple(pixels) for name, pixels in pieces.items()},
        "ignore": ignore,
        "occludes": {name: tuple(hidden) for name, hidden in occludes.items() if hidden},
    }
    data = {key: value for key, value in data.items() if value}
    try:
        Decomposition.model_validate(data)
    except ValidationError as error:
        raise ActError(f"the capture cannot state this: {error.errors()[0]['msg']}") from None
    path = ("frames", source.frame, "decomposition")
    text = edited_text(loaded, {path: data or ABSENT})
    return ActEdits(texts={resolved_path(loaded.path): text})
