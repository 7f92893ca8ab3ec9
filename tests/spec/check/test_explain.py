"""Each code has a page, and the pages are true: what is wrong there gives that code, what is right gives none."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from simfoundry.assets import convex
from simfoundry.capture.frames.load import load_frame
from simfoundry.scene.lower import lower
from simfoundry.spec.check.pages import FOLDER, GROUPS, Page, code_of, findings_page, grouped, pages, titles
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.models.scene import SceneSpec
from tests.assets.coarse import COARSE
from tests.cli.command import run
from tests.conftest import PACKAGE, REPOSITORY

PAGES = {page.code: page for page in pages()}
NOT_SHOWN = {
    "SF001": "bytes that are not text cannot stand in a page",
    "SF503": "needs a whole picture without a table",
    "SF504": "needs a whole picture of an empty table",
    "SF505": "needs a whole picture of something that cannot be fitted",
    "SF601": "needs a whole picture of something that cannot be fitted",
    "SF602": "needs a whole picture",
    "SF603": "needs a whole picture of something that does not rest",
    "SF604": "needs two runs of a capture",
    **{f"SF{k}": "needs a whole picture" for k in range(620, 633)},
    "SF605": "needs several whole pictures",
    "SF640": "needs a model",
    "SF641": "needs a model",
    "SF642": "needs a whole picture",
    "SF421": "needs a stage that was compiled and edited",
}
"""Codes whose pages show no example, and why."""

SHOWN = sorted(set(PAGES) - set(NOT_SHOWN))
of_each_page = pytest.mark.parametrize("page", PAGES.values(), ids=PAGES)


def test_every_code_has_a_page() -> None:
    used = set[str]()
    for file in PACKAGE.rglob("*.py"):
        used |= {code.upper() for code in re.findall(r"[\"'](SF\d{3})[\"']", file.read_text(encoding="utf-8"), re.I)}
    assert used - set(PAGES) == set(), "codes without a page"
    assert set(PAGES) - used == set(), "pages without a code"
    assert {p.name for p in FOLDER.iterdir()} == {f"{code}.md" for code in PAGES}


@of_each_page
def test_a_page_is_whole(page: Page) -> None:
    assert page.title[0].islower() and not page.title.endswith(".")
    assert (FOLDER / f"{page.code}.md").read_text(encoding="utf-8") == page.markdown
    meaning = page.body.partition("\n\n")[0].replace("\n", " ")
    assert 1 <= len(re.findall(r"[.:](?= |$)", meaning)) <= 6 and len(meaning) > 100, meaning
    leads = re.findall(r"^\*\*([^*]+)\*\*", page.body, re.MULTILINE)
    examples = [] if page.code in NOT_SHOWN else ["Wrong.", "Right."]
    silence = ["How to silence it."] if page.code.startswith("SF4") and "cannot be silenced" not in page.body else []
    assert [lead for lead in leads if lead != "Supporting files."] == ["How to fix it.", *examples, *silence]
    assert max(map(len, page.markdown.splitlines())) <= 150


def test_codes_without_an_example_are_few_and_excused() -> None:
    for code in NOT_SHOWN:
        assert PAGES[code].snippets == []
    for code in SHOWN:
        assert len([s for s in PAGES[code].snippets if s.lead == "Wrong"]) == 1, code
        assert len([s for s in PAGES[code].snippets if s.lead == "Right"]) == 1, code


def written(page: Page, lead: str, folder: Path, more: str = "") -> Path:
    """The example below ``lead`` with what stands beside it, as files; the document that is meant."""
    (folder / "simfoundry.yaml").touch()
    for snippet in page.snippets:
        if snippet.lead in (lead, "Supporting files"):
            text = f"# {snippet.name}\n{snippet.text}{more if snippet.lead == lead else ''}"
            (folder / snippet.name).write_text(text, encoding="utf-8")
    return folder / next(s.name for s in page.snippets if s.lead == lead)


def findings_of(path: Path) -> set[tuple[str, int]]:
    """What `check` finds in a document, and then using it: lowering a scene, reading the pictures of a capture."""
    found = {(f["code"], f["line"]) for f in run("check", path, "--json").json["findings"]}
    loaded = load(path)
    try:
        if isinstance(loaded.spec, SceneSpec) and not loaded.errors:
            lower(loaded)
        elif isinstance(loaded.spec, CaptureSpec) and not loaded.errors:
            load_frame(loaded)
    except SpecError as error:
        return found | {(d.code, d.line) for d in error.diagnostics}
    return found


def pictures(folder: Path) -> None:
    """A color and a depth picture of 640 x 480 pixels; the depth, in millimeters, is about that of a desk."""
    from PIL import Image

    Image.fromarray(np.full((480, 640, 3), 120, np.uint8)).save(folder / "color.png")
    Image.fromarray(np.full((480, 640), 800, np.uint16)).save(folder / "depth.png")


@pytest.mark.parametrize("code", SHOWN)
def test_what_is_wrong_gives_the_code_and_no_other(code: str, tmp_path: Path) -> None:
    pictures(tmp_path)
    found = findings_of(written(PAGES[code], "Wrong", tmp_path))
    assert {code for code, _ in found} == {code}
    assert all(line > 1 for _, line in found), "the place is in the text, not the whole file"


@pytest.mark.parametrize("code", SHOWN)
def test_what_is_right_gives_nothing(code: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(convex, "FUNCTION", COARSE)
    pictures(tmp_path)
    assert findings_of(written(PAGES[code], "Right", tmp_path)) == set()


@pytest.mark.parametrize("code", [c for c in SHOWN if "**How to silence it.**" in PAGES[c].body])
def test_what_silences_a_warning_silences_it(code: str, tmp_path: Path) -> None:
    allow = re.search(rf"\*\*How to silence it\.\*\*[^`]*`(allow: {{{code}: .*?}})`", PAGES[code].body, re.DOTALL)
    assert allow is not None
    assert findings_of(written(PAGES[code], "Wrong", tmp_path, allow[1].replace("\n", " ") + "\n")) == set()


@pytest.mark.parametrize("text", ["SF201", "sf201", "Sf201", "201", " SF201 ", "error[SF201]", "[sf201]"])
def test_a_code_is_known_however_it_is_written(text: str) -> None:
    assert code_of(text) == "SF201"


def test_a_number_may_be_short_and_must_exist() -> None:
    assert code_of("1") == code_of("SF1") == "SF001"
    for text in ("", "SF", "SF999", "SF2011", "201a", "warning", "SF-201", "²01"):
        assert code_of(text) is None, text


def test_every_code_is_in_one_group() -> None:
    assert [c for codes in grouped().values() for c in codes] == sorted(titles())
    assert all(grouped().values()) and len(grouped()) == len(GROUPS)


def test_the_page_of_all_findings_leads_to_each() -> None:
    text = (REPOSITORY / "docs" / "findings.md").read_text(encoding="utf-8")
    assert text == findings_page()
    for code, title in titles().items():
        assert text.count(f'<a id="{code.lower()}"></a>') == 1
        assert text.count(f"## {code} {title}\n") == 1
        assert text.count(f"[{code} {title}](#{code.lower()}-") == 1
