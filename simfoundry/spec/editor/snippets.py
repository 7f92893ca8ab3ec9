"""Editor content that the models do not define: initial values of keys, and descriptions of choices."""

from __future__ import annotations

import re
from functools import cache
from importlib.resources import files
from typing import Any

from simfoundry.spec.models.predicate import PREDICATES, built_in_predicates
from simfoundry.spec.models.robot_file import find_robot, robot_names
from simfoundry.spec.yaml.text import parse
from simfoundry.spec.yaml.write import number

# A snippet with placeholders such as ``${1:0.5}``, either as inline text or as data for multiple lines.
Body = str | tuple[Any, ...] | dict[str, Any]


@cache
def _texts() -> dict[str, Any]:
    data: dict[str, Any] = parse((files(__package__) / "snippets.yaml").read_text(encoding="utf-8")).data
    return data


def lookup(section: str, *keys: str) -> Any:
    """Return the entry for the first of ``keys`` that a section of ``snippets.yaml`` contains, or None.

    The section ``first`` contains the initial values that an editor offers for keys, ``members`` contains those for
    members of named mappings, and ``descriptions`` describes keys whose model has no description.
    """
    found = _texts()[section]
    return next((found[key] for key in keys if key in found), None)


def initial_value(model: str, key: str, default: Any) -> Body | None:
    """Return the initial value of a key, or None if there is none.

    ``default`` is the default of the key if it is a number, a word, or a list of them, or else None.
    """
    body: Body | None = lookup("first", f"{model}.{key}", key) if default is None else _holes(default)
    return body


def _holes(value: Any) -> str:
    """Format a value as a snippet with a placeholder for each number and word."""
    if isinstance(value, list):
        return f"[{', '.join(f'${{{k}:{literal(item)}}}' for k, item in enumerate(value, 1))}]"
    return f"${{1:{literal(value)}}}"


def literal(value: Any) -> str:
    """Format a plain value as YAML on one line."""
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, list):
        return f"[{', '.join(map(literal, value))}]"
    return number(value) if isinstance(value, int | float) else str(value)


def one_line(body: Body) -> str:
    """Return a snippet on one line, with its mappings in braces and its lists in brackets."""
    match body:
        case dict():
            return "{" + ", ".join(f"{key}: {one_line(value)}" for key, value in body.items()) + "}"
        case tuple():
            return f"[{', '.join(map(one_line, body))}]"
    return body


def without_placeholders(snippet: str) -> str:
    """Return a snippet on one line with each placeholder replaced by its initial value."""
    return re.sub(r"\$\{\d+:([^{}]*)\}", r"\1", snippet)


def title(model: str) -> str:
    """Return the title of a model: ``camera`` for ``CameraSpec``, ``depth image`` for ``DepthImage``."""
    return " ".join(re.findall(r"[A-Z][a-z]+", model.removesuffix("Spec"))).lower()


def meanings(words: list[str]) -> list[str]:
    """Return the meaning of each option in a choice."""
    if set(words) <= set(PREDICATES.built_in):
        return [sentence(PREDICATES.load(name).meaning) for name in words]
    return next(list(choice.values()) for choice in _texts()["choices"] if list(choice) == words)


def sentence(words: str) -> str:
    """Format a text as a sentence, with a capital letter and a period."""
    return f"{words[0].upper()}{words[1:]}."


def predicates() -> list[dict[str, str]]:
    """Return a snippet for each predicate."""
    words = {"thing": "object", "body": "object", "joint": "object.joint", "robot": "robot"}
    out = []
    for name, predicate in built_in_predicates().items():
        kinds = predicate.parameters[: len(predicate.parameters) - predicate.optional]
        arguments = [words.get(kind, "xyz"[k - 1]) for k, kind in enumerate(kinds)]
        holes = ", ".join(f"${{{k}:{word}}}" for k, word in enumerate(arguments, 1))
        meaning = sentence(predicate.meaning)
        out.append({"label": f"{name}({', '.join(arguments)})", "description": meaning, "body": f"{name}({holes})"})
    return out


def robots() -> list[dict[str, str]]:
    """Return a snippet for each robot that can be referred to by name."""
    return [
        {
            "label": name,
            "description": f"Reaches {robot.reach:g} m from its base; its fingers open {robot.opening * 1000:g} mm.",
            "body": name,
        }
        for name in robot_names()
        if (robot := find_robot(name)) is not None
    ]
