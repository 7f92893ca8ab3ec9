"""NameTable that importers give."""

from __future__ import annotations

from simfoundry.frontends.names import NameTable


def test_nothing_is_called_as_formats_call_what_does_not_move() -> None:
    names = NameTable("link")
    assert [names.name(text) for text in ("World", "world", "base", "base")] == ["world_2", "world_3", "base", "base_2"]
    assert names.renamed == {"World": "world_2", "world": "world_3", "base": "base_2"}
