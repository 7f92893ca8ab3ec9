"""One name, one meaning: a public class name stands for one class of the package."""

from __future__ import annotations

import ast
from collections import defaultdict

from tests.conftest import PACKAGE


def test_a_public_class_name_exists_once() -> None:
    places = defaultdict(list)
    for file in sorted(PACKAGE.rglob("*.py")):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(file.relative_to(PACKAGE).as_posix())
    repeated = {name: files for name, files in places.items() if len(files) > 1}
    assert repeated == {}
