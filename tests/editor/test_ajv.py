"""The schemas in ajv, the validator of the JavaScript world, in its strict mode and without other options."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from simfoundry.spec.models.kinds import KINDS, is_document
from simfoundry.spec.yaml.text import read
from tests.conftest import REPOSITORY
from tests.editor.conftest import MODULES

SCRIPT = """
const Ajv = require("ajv/dist/2020"), fs = require("fs");
const [documents, ...schemas] = process.argv.slice(2).map((f) => JSON.parse(fs.readFileSync(f)));
const judge = (schema) => documents.map(new Ajv({strict: true}).compile(schema));
console.log(JSON.stringify(schemas.map(judge)));
"""
NAMES = [kind.partition("/")[0] for kind in KINDS]


@pytest.mark.usefixtures("command")
def test_ajv_takes_the_schemas_and_judges_by_them(tmp_path: Path) -> None:
    """Each document of ``specs/`` is valid by the schema of its kind and by no other, and none with a slip is."""
    specs = [read(path).data for path in sorted((REPOSITORY / "specs").rglob("*.yaml")) if is_document(path)]
    slips = [{**document, "gravitation": [0, 0, 1]} for document in specs]
    (tmp_path / "documents.json").write_text(json.dumps([*specs, *slips]))
    files = [tmp_path / "documents.json", *(REPOSITORY / "schemas" / f"{name}.schema.json" for name in NAMES)]
    done = subprocess.run(
        ["node", "-e", SCRIPT, "-", *map(str, files)], cwd=MODULES.parent, capture_output=True, text=True, check=False
    )
    assert (done.returncode, done.stderr) == (0, "")
    judged = dict(zip(KINDS, json.loads(done.stdout), strict=True))
    kinds = [document["simfoundry"] for document in specs]
    assert len(set(kinds)) > 3
    assert judged == {kind: [own == kind for own in kinds] + [False] * len(slips) for kind in KINDS}
