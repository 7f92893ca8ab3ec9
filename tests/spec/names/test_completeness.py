"""Every key of the language that can name something is one that a rename knows."""

from __future__ import annotations

import functools
import types
import typing
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, StringConstraints

from simfoundry.backends.mjcf import native
from simfoundry.spec.models import vary
from simfoundry.spec.models.base import JOINT_NAME, NAME, PART_NAME
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.native import mjcf_names
from simfoundry.spec.models.predicate import Condition
from simfoundry.spec.models.types import field_type, models_at
from tests.spec.names.projects import FILES, names_in, write_project

# A field of a model: the class that declares it, and its name. `{}` after the name stands for the keys of a mapping.
Slot = tuple[str, str]

# Distributions, each of which declares its `together`.
DISTRIBUTIONS = [model.__name__ for model in vary.Distribution.__subclasses__()]

# Fields whose names have no meaning for other keys of the project, with the reason.
OTHERS: dict[Slot, str] = {
    ("DocumentSpec", "name"): "the name of a document, which others refer to by its file",
    ("CousinOf", "recipe"): "the name of a recipe, as a record of the past",
    ("AssetSpec", "category"): "a category",
    ("ObjectFields", "category"): "a category",
    ("ObjectFields", "labels"): "labels for vision systems",
    ("VariantSpec", "category"): "a category",
    ("VariantSpec", "labels"): "labels for vision systems",
    ("ObjectVariants", "components"): "functional components, such as `handle`",
    ("DistractorAxis", "categories"): "categories",
    ("DistractorAxis", "exclude_categories"): "categories",
    ("RobotSpec", "model"): "a robot that SimFoundry knows",
    ("RobotSpec", "joints{}"): "joints of the robot's own model",
    ("PolicySpec", "protocol"): "a protocol",
    ("CousinsSpec", "splits{}"): "defined here, and used by the command line only",
    ("DatasetSpec", "sources{}"): "defined here",
    ("DatasetSpec", "splits{}"): "defined here",
    ("DatasetSource", "split"): "a split of the dataset",
    ("DemonstrationFilter", "split"): "a split of the recipe of recorded demonstrations, as a record of the past",
    ("DemonstrationFilter", "subtasks"): "sub-tasks of recorded demonstrations, as a record of the past",
    ("PictureVariation", "split"): "a split of a recipe, which the command line uses too",
    **{(model, "together"): "a group of entries of one recipe" for model in DISTRIBUTIONS},
    ("CaptureSpec", "frames{}"): "defined here, and used by the command line only",
    ("Decomposition", "pieces{}"): "pieces of one image, known to this document only",
    ("Decomposition", "occludes"): "pieces of one image, known to this document only",
    ("Decomposition", "occludes{}"): "pieces of one image, known to this document only",
}


CAPTURE = """\
simfoundry: capture/1
name: shot
truth: desk.scene.yaml
frames:
  one: {color: a.png, masks: {image: m.png, names: {mug: 1}}}
"""


def slots() -> dict[Slot, None]:
    """The fields of all models that contain names, and those that contain predicates."""
    found: dict[Slot, None] = {}
    seen: set[type] = set()
    todo: list[type[BaseModel]] = [model_of(kind) for kind in KINDS]
    while todo:
        model = todo.pop()
        if model in seen:
            continue
        seen.add(model)
        for name in model.model_fields:
            kind = field_type(model, name)
            todo += [each for each in _inner(kind) if isinstance(each, type) and issubclass(each, BaseModel)]
            found |= {(_declaring(model, name), name + how): None for how in _named(kind)}
            if name == "relations" or kind is Condition or Condition in _inner(kind):
                found[_declaring(model, name), name] = None
    return found


def _inner(kind: Any) -> Iterator[Any]:
    yield kind
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        yield from _inner(typing.get_args(kind)[0])
    elif origin in (typing.Union, types.UnionType, dict, tuple):
        for each in typing.get_args(kind):
            yield from _inner(each)


def _named(kind: Any, how: str = "") -> Iterator[str]:
    """Yield where a type contains names: `{}` for the keys of a mapping, an empty string for values."""
    origin = typing.get_origin(kind)
    if origin is typing.Annotated:
        inner, *metadata = typing.get_args(kind)
        patterns = {m.pattern for m in metadata if isinstance(m, StringConstraints)}
        if inner is str and patterns & {NAME, PART_NAME, JOINT_NAME}:
            yield how
        yield from _named(inner, how)
    elif origin is dict:
        key, value = typing.get_args(kind)
        yield from _named(key, how + "{}")
        yield from _named(value, how + "{}" if typing.get_origin(value) is dict else how)
    elif origin in (typing.Union, types.UnionType, tuple):
        for each in typing.get_args(kind):
            yield from _named(each, how)


def _declaring(model: type, name: str) -> str:
    return next(
        c.__name__ for c in reversed(model.__mro__) if name in getattr(c, "model_fields", {}) and c is not BaseModel
    )


@pytest.fixture(scope="module")
def covered(tmp_path_factory: pytest.TempPathFactory) -> frozenset[Slot]:
    """The fields in which the project of the tests has a name that a rename would change."""
    found: set[Slot] = set()
    names = names_in(write_project(tmp_path_factory.mktemp("project"), FILES | {"capture.yaml": CAPTURE}))
    for file, document in names.documents.items():
        model = model_of(f"{document.kind}/1")
        for o in names.occurrences(file):
            if o.symbol is None:
                continue
            steps, how = list(o.path), ""
            while steps and isinstance(steps[-1], int):
                steps.pop()
            while steps:
                field = str(steps.pop())
                owners = [m for m in models_at(model, tuple(steps)) if field in m.model_fields]
                if owners:
                    found.add((_declaring(owners[0], field), field + how))
                    break
                how += "{}"
    return frozenset(found)


@functools.cache
def _slots() -> tuple[Slot, ...]:
    return tuple(sorted(slots()))


def test_the_fields_are_found() -> None:
    assert {("Place", "on"), ("SceneSpec", "relations"), ("Start", "joints{}{}"), ("Subtask", "goal")} <= {*_slots()}


def test_no_field_is_listed_for_nothing() -> None:
    assert OTHERS.keys() <= {*_slots()}


@pytest.mark.parametrize("slot", [s for s in _slots() if s not in OTHERS], ids=".".join)
def test_a_rename_changes_every_field_that_contains_names(covered: frozenset[Slot], slot: Slot) -> None:
    hint = "list the key in simfoundry/spec/models/keys.yaml and use it in tests/spec/names/projects.py"
    assert slot in covered, hint


def test_the_native_attributes_that_refer_to_elements_are_the_same_everywhere() -> None:
    written = {key: tag for tag, keys in mjcf_names()["references"].items() for key in keys}
    assert written == native._REFERENCES


def test_keys_outside_of_models_are_covered(tmp_path: Path) -> None:
    names = names_in(write_project(tmp_path))
    found = {str(o.path[0]) for file in names.documents for o in names.occurrences(file) if o.symbol is not None}
    assert {"allow", "native"} <= found
