"""Formatting has one result for each meaning, keeps every comment where it belongs, and changes nothing the second time."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, example, given, settings
from hypothesis import strategies as st

from simfoundry.spec.base import Model
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.format import format_file, format_text
from simfoundry.spec.kinds import KINDS
from simfoundry.spec.spelling import call, exact
from simfoundry.spec.text import YamlError, parse
from simfoundry.spec.write import to_yaml
from tests.conftest import REPOSITORY
from tests.spec.layouts import DOCUMENTS, untidy
from tests.spec.strategies import ASSETS, SCENES
from tests.spec.test_tree import comments

many = settings(max_examples=100, deadline=None, derandomize=True, suppress_health_check=list(HealthCheck))
SEEDS = st.integers(0, 2**32)
YAML_FILES = sorted(p for folder in ("specs", "tests") for p in (REPOSITORY / folder).rglob("*.yaml"))


def same(a: Any, b: Any) -> bool:
    """Equal in value, whatever the order of keys; predicates up to their spelling, and 1 and 1.0 alike."""
    if isinstance(a, dict):
        return isinstance(b, dict) and a.keys() == b.keys() and all(same(a[k], b[k]) for k in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    if isinstance(a, str):
        return isinstance(b, str) and call(a) == call(b)
    if isinstance(a, bool) or a is None:
        return a is b
    return not isinstance(b, bool | str | dict | tuple) and (a == b or (math.isnan(a) and math.isnan(b)))


def said(text: str) -> list[tuple[Any, str]]:
    """The comments of a text with their paths, without what formatting may change in them."""
    return sorted(((path, c.lstrip("# ")) for path, c in comments(text)), key=repr)


def check(text: str) -> str:
    """The canonical form, which must have the meaning and the comments of ``text``."""
    out = format_text(text)
    assert same(parse(text).data, parse(out).data), out
    assert said(text) == said(out), out
    assert format_text(out) == out
    assert all(line == line.rstrip() or "#" in line for line in out.split("\n"))
    assert out.endswith("\n") and not out.endswith("\n\n") and "\r" not in out
    return out


@many
@given(DOCUMENTS, SEEDS, st.sampled_from(KINDS))
def test_any_document_in_any_layout(data: dict[str, Any], seed: int, kind: str) -> None:
    check(untidy(data, seed, kind)[0])


@many
@given(SCENES | ASSETS)
def test_computed_documents_are_written_in_the_same_form(spec: Model) -> None:
    text = to_yaml(spec, comment="why\n\nhow")
    assert format_text(text) == text


@many
@given(SCENES | ASSETS, SEEDS)
def test_valid_documents_in_any_layout(spec: Model, seed: int) -> None:
    data = parse(to_yaml(spec)).data
    text, _, _ = untidy({k: v for k, v in data.items() if k != "simfoundry"}, seed, data["simfoundry"])
    plain = "\n".join(line for line in check(text).splitlines() if "c" not in line)
    assert plain == "" or "simfoundry" in check(text)


@pytest.mark.parametrize("path", YAML_FILES, ids=lambda p: p.name)
def test_every_document_of_the_repository(path: Path) -> None:
    try:
        text = path.read_text()
        known = parse(text)
    except YamlError:
        with pytest.raises(SpecError):
            format_file(path)
        return
    if known.duplicates or not isinstance(known.data, dict) or known.data.get("simfoundry") not in KINDS:
        with pytest.raises(SpecError):
            format_file(path)
        return
    check(text)


@pytest.mark.parametrize("path", sorted((REPOSITORY / "specs").rglob("*.yaml")), ids=lambda p: p.name)
def test_the_documents_of_the_repository_are_formatted(path: Path) -> None:
    assert not format_file(path).changed
