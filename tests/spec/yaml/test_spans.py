"""Where values are in a text."""

from __future__ import annotations

from simfoundry.spec.yaml.spans import TextSpan, locate_values

TEXT = """\
\ufeffgoal: {all: OnTop(cup, desk), n: 1}  # why
rel: [OnTop(a, b), "Q(a, b)", At(a, 1, 2), c]
list:
  - x: |
      block
    y: *z
  - "é"
"""


def covered(path: tuple[str | int, ...], text: str = TEXT) -> str:
    span = locate_values(text).at(path)
    assert span is not None
    return text[span.start : span.end]


def test_each_value_is_where_it_was_written() -> None:
    text = TEXT.replace("x: |", "z: &z 1\n    x: |")
    assert covered(("goal", "all"), text) == "OnTop(cup, desk)"
    assert covered(("goal", "n"), text) == "1"
    assert [covered(("rel", k), text) for k in range(4)] == ["OnTop(a, b)", '"Q(a, b)"', "At(a, 1, 2)", "c"]
    assert covered(("list", 0, "x"), text) == "|\n      block"
    assert covered(("list", 0, "y"), text) == "*z"
    assert covered(("list", 1), text) == '"é"'
    assert locate_values(text).at(("rel", 4)) is None and locate_values(text).at(("no",)) is None


def test_the_way_to_a_place_leads_through_keys() -> None:
    text = "objects:\n  cup: {place: {on: desk}}\n"
    root = locate_values(text)
    assert [key for key, _ in root.path_to(text.index("esk"))] == ["objects", "cup", "place", "on"]
    assert [key for key, _ in root.path_to(text.index("up"))] == ["objects", "cup"]
    assert locate_values("") == TextSpan(0, 0)
