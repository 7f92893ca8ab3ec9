"""What the tests of all frontends share: a project folder, and an import that lowers."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from simfoundry.frontends.importer import Options, Report, import_file
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene

Importing = Callable[..., tuple[Report, Scene]]


@pytest.fixture
def importing(tmp_path: Path) -> Importing:
    """Writes a text to a file, imports it to a scene and lowers that."""

    def run(name: str, text: str, **options: object) -> tuple[Report, Scene]:
        source = tmp_path / "source" / name
        source.parent.mkdir(exist_ok=True)
        source.write_bytes(text.encode(errors="surrogateescape"))
        out = tmp_path / "out" / "thing.scene.yaml"
        report = import_file(source, out, Options(force=True, **options))  # type: ignore[arg-type]
        return report, lower_file(out)

    return run
