"""The meaning of keys, as editors show it."""

from __future__ import annotations

import json
from typing import Any, get_args, get_origin

import pytest
from pydantic import BaseModel

from simfoundry.spec.editor.keys import key_meaning
from simfoundry.spec.editor.reference import reference
from simfoundry.spec.editor.schema import schema
from simfoundry.spec.models.kinds import KINDS, model_of
from simfoundry.spec.models.types import field_type, flat


def every_key(kind: Any, path: tuple[str | int, ...] = (), above: tuple[Any, ...] = ()) -> list[tuple[str | int, ...]]:
    """Every path of keys below a type, without repetition of models that contain themselves."""
    found: list[tuple[str | int, ...]] = []
    for _, one in flat(kind):
        if isinstance(one, type) and issubclass(one, BaseModel) and one not in above:
            for name in one.model_fields:
                found.append((*path, name))
                found += every_key(field_type(one, name), (*path, name), (*above, one))
        elif get_origin(one) is dict:
            found += every_key(get_args(one)[1], (*path, "a_name"), above)
        elif get_origin(one) is tuple:
            found += every_key(get_args(one)[0], (*path, 0), above)
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_has_the_words_of_the_reference(kind: str) -> None:
    words = reference().replace("\\|", "|") + json.dumps(schema(kind), ensure_ascii=False).replace('\\"', '"')
    for path in every_key(model_of(kind)):
        meaning = key_meaning(kind, path)
        assert meaning is not None and meaning.text and meaning.type, path
        assert meaning.text in words, path


def test_names_have_no_meaning_and_former_keys_have_that_of_the_present_one() -> None:
    assert key_meaning("scene/1", ("objects", "cup")) is None
    assert key_meaning("scene/1", ("objects", "cup", "nonsense")) is None
    former = key_meaning("scene/1", ("objects", "cup", "place", "at"))
    assert former is not None and former.key == "local_xy"
