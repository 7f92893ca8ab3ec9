"""What the tests of all frontends share: a project folder, and an import that lowers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.importer import ImportReport, import_file
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene

Importing = Callable[..., tuple[ImportReport, Scene]]


@pytest.fixture
def importing(tmp_path: Path) -> Importing:
    """Writes a text to a file, imports it to a scene and lowers that."""

    def run(name: str, text: str, **options: object) -> tuple[ImportReport, Scene]:
        source = tmp_path / "source" / name
        source.parent.mkdir(exist_ok=True)
        source.write_bytes(text.encode(errors="surrogateescape"))
        out = tmp_path / "out" / "thing.scene.yaml"
        report = import_file(source, out, ImportOptions(force=True, **options))  # type: ignore[arg-type]
        return report, lower_file(out)

    return run
