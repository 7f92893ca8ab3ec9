"""The page docs/reuse.md: its scenes and its output."""

from __future__ import annotations

import re
from pathlib import Path

from click.testing import CliRunner

from simfoundry.cli.main import app
from simfoundry.scene.lower import lower
from simfoundry.spec.load import load
from tests.conftest import REPOSITORY
from tests.spec.compose.documents import written

PAGE = (REPOSITORY / "docs" / "reuse.md").read_text()


def test_the_scenes_of_the_page_are_what_the_page_says(tmp_path: Path) -> None:
    for text in re.findall(r"^```yaml\n(.*?)^```$", PAGE, re.M | re.S):
        (name,) = re.findall(r"^name: (\w+)", text, re.M)
        written(tmp_path, text, f"{name}.scene.yaml")
    six = lower(load(tmp_path / "table_for_six.scene.yaml"))
    assert len(six.objects) == 1 + 6 + 5 + 2 and six.by_name["plate_2_2"].links[0].mass == 0.5
    assert len(six.relations) == 5 + 6
    cell = lower(load(tmp_path / "cell.scene.yaml"))
    assert len(cell.objects) == 2 * len(six.objects) - 1 and "right_spare_2" not in cell.by_name
    assert len(lower(load(tmp_path / "corner.scene.yaml")).objects) == 3
    eight = (tmp_path / "table_for_six.scene.yaml").read_text().replace("count: [3, 2]", "count: [4, 2]")
    written(tmp_path, eight, "table_for_eight.scene.yaml")
    (shown,) = re.findall(r"^```console\n\$ simfoundry (.*?)\n(.*?)^```$", PAGE, re.M | re.S)
    found = CliRunner().invoke(app, [str(tmp_path / w) if w.endswith(".yaml") else w for w in shown[0].split()])
    assert found.output == shown[1]
