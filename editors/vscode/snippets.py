"""Snippets for VS Code, generated from the texts from which `simfoundry new` and the schemas are generated.

Predicates have none, because the language server completes them with the names of the scene.
"""

from __future__ import annotations

import re
from importlib.resources import files
from typing import Any

from simfoundry.spec.editor.snippets import Body, lookup
from simfoundry.spec.models.kinds import KINDS, model_of

# What a person replaces in the starter file of each kind, which `simfoundry new` fills in from a scene. The names are
# those of the starter scene.
VALUES = {
    "name": "name",
    "kind": "scene",
    "source": "base.scene.yaml",
    "instruction": "Put the mug on the plate.",
    "goal": "OnTop(mug, plate)",
    "thing": "mug",
    "step": "place_mug",
    "anchor": "table",
    "objects": "objects: {}",
    "reset": "  objects:\n    mug: {x: [0.35, 0.55], y: [-0.2, 0.2]}",
}

# Members of named mappings that a snippet is worth: those in which several keys belong together. The word that is typed
# is the name of the model in lower case, without `Spec`.
MEMBERS = {
    "scene": ("ObjectSpec", "RobotSpec", "CameraSpec", "LightSpec", "Material"),
    "asset": ("LinkSpec", "PartSpec", "JointSpec", "AxisSpec"),
    "task": ("Subtask", "ResetRegion"),
    "capture": ("Shot",),
    "cousins": ("ObjectVariants",),
    "policy": ("CameraView",),
    "dataset": ("DatasetSource",),
}

Snippet = dict[str, str | list[str]]


def snippets() -> dict[str, Snippet]:
    """Return every snippet by its title, in the format of VS Code."""
    return documents() | members()


def documents() -> dict[str, Snippet]:
    """Return a snippet for a whole document of each kind, and for one that extends another one."""
    words = [*(kind.partition("/")[0] for kind in KINDS), "overlay"]
    return {f"New {word}": _document(word) for word in words}


def _document(word: str) -> Snippet:
    text = (files("simfoundry.spec.editor") / "templates" / f"{word}.txt").read_text(encoding="utf-8")
    numbers = dict[str, int]()

    def hole(found: re.Match[str]) -> str:
        name = found[1].replace("quoted", "source")  # the same file, in quotes if it needs them
        if name in numbers:
            return f"${numbers[name]}"
        numbers[name] = len(numbers) + 1
        return f"${{{numbers[name]}:{VALUES[name]}}}".replace("{}}", "{\\}}")

    body = re.sub(r"\$([a-z]+)", hole, text)
    return {
        "prefix": word,
        "description": f"A starter file, as `simfoundry new` writes it: {word}.",
        "body": body.rstrip("\n").split("\n"),
    }


def members() -> dict[str, Snippet]:
    """Return a snippet for each kind of member that has several keys, such as a camera."""
    out = {}
    for kind, models in MEMBERS.items():
        parts = model_of(next(each for each in KINDS if each.startswith(kind))).model_json_schema()["$defs"]
        for model in models:
            word = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", model.removesuffix("Spec")).lower()
            description = parts[model]["description"].partition("\n")[0]
            body = _member(lookup("members", model))
            out[word.replace("_", " ").capitalize()] = Snippet(prefix=word, description=description, body=body)
    return out


def _member(body: Body) -> list[str]:
    """Return the lines of a member with a name. The holes of its body are numbered from 2."""
    if isinstance(body, str):
        return [f"${{1:name}}: {_renumbered(body)}"]
    assert isinstance(body, dict)
    return ["${1:name}:", *_renumbered("\n".join(_lines(body, "  "))).split("\n")]


def _lines(body: dict[str, Any], indent: str) -> list[str]:
    out = []
    for key, value in body.items():
        if isinstance(value, dict):
            out += [f"{indent}{key}:", *_lines(value, f"{indent}  ")]
        else:
            out.append(f"{indent}{key}: {value}")
    return out


def _renumbered(text: str) -> str:
    """Number the holes from 2; holes that share a number still do."""
    numbers = dict[str, int]()
    return re.sub(r"\$\{(\d+):", lambda hole: f"${{{numbers.setdefault(hole[1], len(numbers) + 2)}:", text)
