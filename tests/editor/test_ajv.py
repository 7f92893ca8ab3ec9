"""The schemas of the standard in ajv, the validator of the JavaScript world, as strict as it is by default."""

from __future__ import annotations

import json
import subprocess
from pathlib import Path

import pytest

from simfoundry.spec.schema import schemas
from simfoundry.spec.text import read
from tests.conftest import REPOSITORY
from tests.editor.conftest import MODULES

SCRIPT = """
const Ajv = require("ajv/dist/2020"), fs = require("fs");
const [file, ...documents] = process.argv.slice(2);
const validate = new Ajv({allowUnionTypes: true}).compile(JSON.parse(fs.readFileSync(file)));
console.log(JSON.stringify(documents.map((d) => validate(JSON.parse(fs.readFileSync(d))))));
"""
SCENE = REPOSITORY / "specs" / "scenes" / "cup_in_bowl.scene.yaml"


@pytest.mark.usefixtures("command")
@pytest.mark.parametrize("name", schemas())
def test_ajv_takes_the_schemas_and_judges_by_them(name: str, tmp_path: Path) -> None:
    (tmp_path / "schema.json").write_text(schemas(standard=True)[name])
    scene = read(SCENE).data
    (tmp_path / "right.json").write_text(json.dumps(scene))
    (tmp_path / "wrong.json").write_text(json.dumps({**scene, "gravitation": [0, 0, 1]}))
    done = subprocess.run(
        ["node", "-e", SCRIPT, "-", *(str(tmp_path / f"{n}.json") for n in ("schema", "right", "wrong"))],
        cwd=MODULES.parent,
        capture_output=True,
        text=True,
        check=False,
    )
    assert (done.returncode, done.stderr) == (0, "")
    assert json.loads(done.stdout) == ([True, False] if name == "scene.schema.json" else [False, False])
