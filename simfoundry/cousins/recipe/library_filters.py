"""Filters on the objects in a distractor library, and the messages about the objects that they remove."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial

from simfoundry.cousins.objects.appearance import category_prior, same_kind
from simfoundry.cousins.objects.retrieval import likeness
from simfoundry.cousins.recipe.candidate import ImpossibleError, Reason
from simfoundry.cousins.recipe.library import Library, LibraryItem, lowered
from simfoundry.scene.model import SceneObject
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.cousins import DistractorAxis, ValueRange

# Phrases that describe two of the filters in messages.
KIND_OF_TWIN = "a category that the twin does not have"
SHAPE_OF_TWIN = "a category, or a shape that the twin does not have"

# Similarity thresholds for objects that are identified by neither a category nor their name: the maximum ratio of side
# lengths and the maximum shape distance (see :class:`LikenessDistance`). Among the shipped objects, the shape distance
# is 0.05 between a cup and a mug, and 0.08 between a pot and a bowl.
LIKE_SIZE, LIKE_SHAPE = 1.3, 0.1


@dataclass(frozen=True)
class FilterStep:
    """The condition of a filter and the objects that it removed, all of which had passed the previous filters."""

    condition: str
    removed: tuple[LibraryItem, ...]


def filtered(
    library: Library, axis: DistractorAxis, own: Iterable[str] = (), twin: Callable[[], Sequence[SceneObject]] = tuple
) -> tuple[tuple[LibraryItem, ...], list[FilterStep]]:
    """Return the library objects that pass all filters of an axis, and the objects removed by each filter.

    If the axis does not list categories, objects that could be confused with an object in the twin are also removed.
    With a second bowl in the scene, for example, "the bowl" in an instruction would be ambiguous. A library object
    without a category is compared by its name or, if the name is not a known word, by its size and shape.

    Args:
        library: The library.
        axis: The axis that specifies the filters.
        own: Categories, names and labels of the objects in the twin.
        twin: Function that returns the objects in the twin. It is called only if shapes must be compared.

    Raises:
        ImpossibleError: If distractors are requested, but no object passes the filters.
    """
    left, steps = library.items, list[FilterStep]()
    for condition, passes in _filters(axis, tuple(own), twin):
        steps.append(FilterStep(condition, tuple(item for item in left if not passes(item))))
        left = tuple(item for item in left if passes(item))
    if not left and axis.count[1] > 0:
        raise ImpossibleError((_nothing_left(library, axis, steps),))
    return left, steps


def _filters(
    axis: DistractorAxis, own: tuple[str, ...], twin: Callable[[], Sequence[SceneObject]]
) -> Iterator[tuple[str, Callable[[LibraryItem], bool]]]:
    if axis.categories:
        yield f"category {_listed(axis.categories)}", lambda item: item.category in axis.categories
    elif own:
        yield KIND_OF_TWIN, lambda item: not _is_called(item, own)
        yield SHAPE_OF_TWIN, lambda item: not _is_nameless(item) or not _resembles(item, twin())
    if axis.exclude_categories:
        excluded = axis.exclude_categories
        yield f"not category {_listed(excluded)}", lambda item: not _is_called(item, excluded)
    for what, unit in (("mass", "kg"), ("volume", "m^3"), ("density", "kg/m^3")):
        bounds: ValueRange = getattr(axis, what)
        if bounds.min is not None or bounds.max is not None:
            yield f"{what} {_range(bounds)} {unit}", partial(_is_within, what, bounds)


def _is_within(what: str, bounds: ValueRange, item: LibraryItem) -> bool:
    return bool((bounds.min or 0.0) <= getattr(item, what) <= (math.inf if bounds.max is None else bounds.max))


def _is_called(item: LibraryItem, words: Iterable[str]) -> bool:
    """Return True if a word denotes an object.

    The word is compared with the object's specified category. If there is none, it is compared with the derived
    category and the name.
    """
    names = (item.category,) if item.stated else (item.category, item.name)
    return any(same_kind(word, name) for word in words for name in names)


def _is_nameless(item: LibraryItem) -> bool:
    """Return True if an object has no specified category and its name contains no known category word."""
    return not item.stated and category_prior(item.name) is None


def _resembles(item: LibraryItem, others: Sequence[SceneObject]) -> bool:
    """Return True if the size and shape of an object are similar to those of another object that is not fixed."""
    own = likeness(lowered(item.file))
    distances = (own.apart(likeness(other)) for other in others if not other.fixed)
    return any(d.size < math.log(LIKE_SIZE) and d.shape < LIKE_SHAPE for d in distances)


def remarks(library: Library, chosen: Sequence[LibraryItem], steps: Sequence[FilterStep]) -> tuple[str, ...]:
    """Return notes for the user about missing categories and about excluded objects that resemble the twin's."""
    found = [
        f"excluded {_few(step.removed)} from {library.title}: distractors need {step.condition}"
        for step in steps
        if step.removed and step.condition in (KIND_OF_TWIN, SHAPE_OF_TWIN)
    ]
    nameless = [item for item in chosen if not item.stated]
    if nameless:
        reason = f"no `category` is set for {_few(nameless)} in {library.title}, so only names and shapes were compared"
        found.append(f"{reason}; set it in these assets so that instructions cannot refer to them by accident")
    return tuple(found)


def _few(items: Sequence[LibraryItem], most: int = 5) -> str:
    names = ", ".join(f"`{item.name}`" for item in items[:most])
    return names if len(items) <= most else f"{names} and {len(items) - most} more"


def _nothing_left(library: Library, axis: DistractorAxis, steps: list[FilterStep]) -> Reason:
    """Return a reason that states how many library objects there are and how many of them each filter removed."""
    total = len(library.items)
    text = f"none of the {total} objects in {library.title} can be used as a distractor"
    numbers = {"library": float(total)}
    for step in (step for step in steps if step.removed):
        numbers[f"taken by {step.condition}"] = float(len(step.removed))
        text += f"; {step.condition}: {len(step.removed)} removed{_spread(step)}"
    known = sorted({item.category for item in library.items})
    unknown = [name for name in axis.categories if name not in known]
    if unknown and known:
        text += f"; category `{unknown[0]}` does not exist in it, {nearest(unknown[0], known)}"
    if library.faults:
        numbers["unusable"] = float(len(library.faults))
        file, why = library.faults[0]
        text += f"; unusable files: {len(library.faults)}, the first is {file}: {why}"
    return Reason("no_distractor", text, numbers)


def _spread(step: FilterStep) -> str:
    """Return a phrase with the range of the actual values for a filter by a quantity, or an empty string.

    An example is `` (actual values 0.012 to 4.1)``.
    """
    what = step.condition.split()[0]
    if what not in ("mass", "volume", "density"):
        return ""
    values = [getattr(item, what) for item in step.removed]
    return f" (actual values {min(values):.3g} to {max(values):.3g})"


def _range(bounds: ValueRange) -> str:
    if bounds.min is None:
        return f"at most {bounds.max:g}"
    return f"at least {bounds.min:g}" if bounds.max is None else f"{bounds.min:g} to {bounds.max:g}"


def _listed(names: Iterable[str]) -> str:
    return " or ".join(f"`{name}`" for name in names)
