"""One name, one meaning: a public class name stands for one class of the package and of the targets it ships."""

from __future__ import annotations

import ast
from collections import defaultdict

from tests.conftest import PACKAGE, REPOSITORY


def test_a_public_class_name_exists_once() -> None:
    places = defaultdict(list)
    shipped = REPOSITORY / "targets"  # in a wheel, they are part of the package
    files = {*PACKAGE.rglob("*.py"), *(() if (PACKAGE / "shipped").is_dir() else shipped.rglob("*.py"))}
    for file in sorted(files):
        for node in ast.parse(file.read_text(encoding="utf-8")).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places[node.name].append(str(file))
    repeated = {name: files for name, files in places.items() if len(files) > 1}
    assert repeated == {}
