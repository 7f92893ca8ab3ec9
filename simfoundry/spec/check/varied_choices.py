"""Values that the axis `vary` chooses from: colors, files, texts and numbers."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass
from itertools import islice
from pathlib import PurePosixPath
from typing import Any

from simfoundry.spec.check.varied_fields import FieldFinder
from simfoundry.spec.check.varied_places import ValueKind, VariedField, VaryPathError
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.files import (
    ASSET_SUFFIX,
    MESH_SUFFIXES,
    PANORAMA_SUFFIXES,
    SPLAT_SUFFIXES,
    TEXTURE_SUFFIXES,
    FileError,
    Loaded,
    reachable,
)
from simfoundry.spec.models.base import HEX_COLOR
from simfoundry.spec.models.robot_file import robot_names
from simfoundry.spec.models.types import REFERENCES
from simfoundry.spec.models.vary import MAX_CHOICES, AnyDistribution, ChoiceDistribution

# Colors that recipes can choose by name: the named colors of CSS, and woods and stones as CSS colors that resemble them
# (oak: burlywood, walnut: saddlebrown, slate: slategray, sand: tan).
COLORS = {
    "white": "#ffffff", "black": "#000000", "gray": "#808080", "silver": "#c0c0c0", "red": "#ff0000",
    "green": "#008000", "blue": "#0000ff", "yellow": "#ffff00", "orange": "#ffa500", "purple": "#800080",
    "pink": "#ffc0cb", "brown": "#a52a2a", "beige": "#f5f5dc", "navy": "#000080", "teal": "#008080",
    "oak": "#deb887", "walnut": "#8b4513", "slate": "#708090", "sand": "#d2b48c",
}  # fmt: skip


@dataclass(frozen=True)
class VaryProblem:
    """A problem of an entry, at the keys ``at`` below `vary`."""

    code: str
    at: tuple[str | int, ...]
    message: str
    hint: str = ""


def choices_of(
    entry: str, distribution: AnyDistribution, field: VariedField, finder: FieldFinder, recipe: Loaded
) -> tuple[dict[str, Any], VaryProblem | None]:
    """Return the values to choose from by the text that stands for each, or the problem of the first invalid one."""
    found: dict[str, Any] = {}
    if not isinstance(distribution, ChoiceDistribution):
        return found, None
    for k, value in enumerate(distribution.choose):
        at = (entry, "choose", k)
        try:
            chosen = dict(_chosen(value, field, finder, recipe))
        except FileError as error:
            return found, VaryProblem(error.code, at, str(error), error.hint)
        except VaryPathError as error:
            return found, VaryProblem("SF106", at, error.message, error.hint)
        if repeated := [name for name in chosen if name in found]:
            return found, VaryProblem("SF107", at, f"`{repeated[0]}` occurs twice", "list each value once")
        found |= chosen
        if len(found) > MAX_CHOICES:
            return found, VaryProblem("SF105", at, f"there are more than {MAX_CHOICES} values to choose from")
    return found, None


def _chosen(value: Any, field: VariedField, finder: FieldFinder, recipe: Loaded) -> Iterator[tuple[str, Any]]:
    """Yield the values that an item of `choose` stands for, each with its text."""
    kind = field.kind
    if kind in (ValueKind.FILE, ValueKind.BACKGROUND):
        if not isinstance(value, str):
            raise VaryPathError(
                f"`{field.name}` is a file, not `{_text(value)}`", "write a path, relative to this document"
            )
        yield from ((reference, reference) for reference in _files(value, field, recipe))
    elif kind is ValueKind.COLOR:
        color = _color(value, finder)
        yield str(value) if isinstance(value, str) else _listed(value), color
    elif kind is ValueKind.WORD:
        if not isinstance(value, str):
            raise VaryPathError(f"`{field.name}` is a text, not `{_text(value)}`", "write a text")
        known = _known_names(field, finder)
        if known is not None and value not in known:
            raise VaryPathError(f"no such name is defined: `{value}`", nearest(value, known) or "none are defined")
        yield value, value
    elif kind is ValueKind.VECTOR:
        if not (isinstance(value, tuple) and len(value) == 3):
            raise VaryPathError(f"`{field.name}` is a vector, not `{_text(value)}`", "write three numbers")
        yield _listed(value), value
    else:
        if isinstance(value, str | tuple):
            raise VaryPathError(f"`{field.name}` is {kind}, not `{_text(value)}`", "write a number")
        yield f"{value:g}", value


def _known_names(field: VariedField, finder: FieldFinder) -> list[str] | None:
    """Return the names that a text may have if it refers to a member of the scene, or None for any other text."""
    place = field.places[0]
    if place.path[0] == "robots" and place.path[-1] == "model":
        return robot_names()
    sections = ("materials",) if place.path[-1] == "material" else REFERENCES.get(place.path[-1], ())
    if place.document != "scene" or not sections:
        return None
    return list(dict.fromkeys(name for section in sections for name in getattr(finder.spec, section, {})))


def _text(value: Any) -> str:
    """Return a value as it is written in a document."""
    return _listed(value) if isinstance(value, tuple) else value if isinstance(value, str) else f"{value:g}"


def _listed(value: tuple[float, ...]) -> str:
    return f"[{', '.join(f'{v:g}' for v in value)}]"


def _color(value: Any, finder: FieldFinder) -> tuple[float, ...]:
    if isinstance(value, tuple) and len(value) in (3, 4):
        return value
    if not isinstance(value, str):
        raise VaryPathError(f"`{value}` is not a color", 'write a name, three numbers, or a text such as `"#c8a070"`')
    material = finder.spec.materials.get(value)
    if material is not None and material.color is not None:
        return tuple(material.color)
    text = value if re.fullmatch(HEX_COLOR, value) else COLORS.get(value)
    if text is None:
        raise VaryPathError(f"`{value}` is not a color", nearest(value, [*finder.spec.materials, *COLORS]))
    return tuple(round(int(text[k : k + 2], 16) / 255, 6) for k in range(1, len(text), 2))


def _files(pattern: str, field: VariedField, recipe: Loaded) -> list[str]:
    """Return the files that a path with `*` stands for, as paths relative to the recipe, in alphabetical order."""
    suffixes = _suffixes(field)
    if "*" not in pattern:
        reachable(pattern, recipe.path, recipe.root, suffixes)
        return [pattern]
    parts = PurePosixPath(pattern).parts
    fixed = next(k for k, part in enumerate(parts) if "*" in part)
    if "**" in pattern or pattern.startswith("/") or "\\" in pattern:
        raise FileError(
            "SF204", f"`{pattern}` is not a portable pattern", "use `*` within the names of a relative path"
        )
    folder = PurePosixPath(*parts[:fixed])
    start = (recipe.path.parent / folder).resolve()
    if start.is_relative_to(recipe.root) and not start.is_dir():
        raise FileError("SF203", f"folder `{folder}` does not exist", "paths are relative to this document")
    reachable(folder.as_posix(), recipe.path, recipe.root, ())
    rest = str(PurePosixPath(*parts[fixed:]))
    # One more than the limit, so that too many files are reported rather than cut off.
    names = sorted(p.relative_to(start).as_posix() for p in islice(start.glob(rest), MAX_CHOICES + 1) if p.is_file())
    fitting = [name for name in names if name.lower().endswith(suffixes or "")]
    if not fitting:
        raise FileError("SF203", f"no file fits `{pattern}`", f"supported: {', '.join(suffixes)}" if suffixes else "")
    found = [(folder / name).as_posix() for name in fitting]
    for reference in found:
        reachable(reference, recipe.path, recipe.root, suffixes)
    return found


def _suffixes(field: VariedField) -> tuple[str, ...]:
    path = field.places[0].path
    if field.kind is ValueKind.BACKGROUND:
        return MESH_SUFFIXES
    by_key = {
        "texture": PANORAMA_SUFFIXES if path[0] == "lights" else TEXTURE_SUFFIXES,
        "mesh": MESH_SUFFIXES,
        "visual": MESH_SUFFIXES,
        "asset": (*MESH_SUFFIXES, ASSET_SUFFIX),
        "splat": SPLAT_SUFFIXES,
    }
    return by_key.get(path[-1], ())
