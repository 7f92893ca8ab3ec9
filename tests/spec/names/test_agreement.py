"""A rename across files agrees with what diffs and merges do to one document when a member is renamed."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.change.diff.changes import Rename, renamed, same
from simfoundry.spec.names.project import ProjectNames
from simfoundry.spec.names.rename import rename_edits
from simfoundry.spec.names.symbols import Symbol
from simfoundry.spec.yaml.text import parse
from tests.spec.names.projects import FILES, names_in, write_project


@pytest.fixture(scope="module")
def names(tmp_path_factory: pytest.TempPathFactory) -> ProjectNames:
    return names_in(write_project(tmp_path_factory.mktemp("project")))


def _symbols(names: ProjectNames, file: str) -> dict[Symbol, None]:
    return {o.symbol: None for o in names.occurrences(file) if o.symbol is not None and o.is_definition}


@pytest.mark.parametrize("name", [name for name in FILES if name != "simfoundry.yaml"])
def test_both_renames_of_one_document_give_the_same_data(names: ProjectNames, name: str) -> None:
    (file,) = (file for file in names.documents if Path(file).name == name)
    for symbol in _symbols(names, file):
        (after,) = (edit.after for edit in rename_edits(names, symbol, "zz") if str(edit.file) == file)
        rename = Rename(tuple(map(str, symbol.section)), symbol.name, "zz")
        assert same(parse(after).data, renamed(names.documents[file].data, [rename])), symbol
