"""The snippets of the extension for VS Code: each is valid as it is, and says what the schemas say."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from editors.vscode.snippets import MEMBERS, documents, members
from simfoundry.spec.editor.snippets import lookup
from simfoundry.spec.load import load
from simfoundry.spec.models.kinds import KINDS
from simfoundry.spec.yaml.text import parse
from tests.scenes import checker_png


def expanded(body: list[str] | str) -> str:
    """Return the text of a snippet whose holes keep their first value."""
    text = body if isinstance(body, str) else "\n".join(body) + "\n"
    values = dict(re.findall(r"\$\{(\d+):((?:[^}\\]|\\.)*)\}", text))
    text = re.sub(r"\$\{(\d+):(?:[^}\\]|\\.)*\}", lambda hole: values[hole[1]], text)
    return re.sub(r"\$(\d+)", lambda hole: values[hole[1]], text).replace("\\}", "}")


@pytest.mark.parametrize("title", documents())
def test_a_new_document_is_valid_as_it_is(title: str, tmp_path: Path) -> None:
    (tmp_path / "base.scene.yaml").write_text(expanded(documents()["New scene"]["body"]))
    for name in ("color.png", "depth.png"):
        (tmp_path / name).write_bytes(checker_png())
    snippet = documents()[title]
    word = str(snippet["prefix"])
    path = tmp_path / f"new.{'scene' if word == 'overlay' else word}.yaml"
    path.write_text(expanded(snippet["body"]))
    assert [finding.message for finding in load(path).all_findings()] == []


def test_every_kind_has_a_snippet_and_each_word_is_used_once() -> None:
    words = [snippet["prefix"] for snippet in (documents() | members()).values()]
    assert len(words) == len(set(map(str, words)))
    assert {kind.partition("/")[0] for kind in KINDS} <= set(map(str, words))


@pytest.mark.parametrize("model", [model for models in MEMBERS.values() for model in models])
def test_members_say_what_the_schemas_say(model: str) -> None:
    word = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", model.removesuffix("Spec")).lower()
    snippet = next(each for each in members().values() if each["prefix"] == word)
    body = lookup("members", model)
    text = expanded(snippet["body"])
    assert "$" not in text and str(snippet["description"]).endswith(".")
    if isinstance(body, str):
        assert text == f"name: {expanded(body)}\n"
    else:
        assert list(parse(text).data["name"]) == list(body)
