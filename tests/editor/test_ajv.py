"""The schemas of the standard in ajv, the validator of the JavaScript world, as strict as it is by default."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from simfoundry.spec.editor.schema import schemas
from simfoundry.spec.yaml.text import read
from tests.conftest import REPOSITORY
from tests.editor.conftest import MODULES

SCRIPT = """
const Ajv = require("ajv/dist/2020"), fs = require("fs");
const [documents, ...schemas] = process.argv.slice(2).map((f) => JSON.parse(fs.readFileSync(f)));
const judge = (schema) => documents.map(new Ajv({allowUnionTypes: true}).compile(schema));
console.log(JSON.stringify(schemas.map(judge)));
"""
SCENE = REPOSITORY / "specs" / "scenes" / "cup_in_bowl.scene.yaml"


@pytest.mark.usefixtures("command")
def test_ajv_takes_the_schemas_and_judges_by_them(tmp_path: Path) -> None:
    texts = schemas(standard=True)
    for name, text in texts.items():
        (tmp_path / name).write_text(text)
    scene = read(SCENE).data
    (tmp_path / "documents.json").write_text(json.dumps([scene, {**scene, "gravitation": [0, 0, 1]}]))
    done = subprocess.run(
        ["node", "-e", SCRIPT, "-", *(str(tmp_path / name) for name in ("documents.json", *texts))],
        cwd=MODULES.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    judged = dict(zip(texts, json.loads(done.stdout), strict=True))
    assert judged == {name: [name == "scene.schema.json", False] for name in texts}
