"""`simfoundry diff --format markdown`: what GitHub shows of it, as a parser of CommonMark with tables reads it."""

from __future__ import annotations

import io
import re
from pathlib import Path
from urllib.parse import unquote

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st
from markdown_it import MarkdownIt
from markdown_it.token import Token
from PIL import Image

from simfoundry.reports.comparison import COLORS
from simfoundry.reports.markdown import MARKER, code, inline
from simfoundry.spec.diagnostics import printable
from tests.cli.command import run
from tests.cli.repository import BASE, EDITED, Repository

PARSER = MarkdownIt("commonmark").enable("table")
VIEW = "cameras: {v: {size: [64, 48], fx: 60, fy: 60, pose: {xyz: [-4, 0, 3], look_at: [0, 0, 0]}}}\nviewpoint: v\n"
COMMENT = 65_536
"""What GitHub takes at most as a comment, in characters."""


class Report:
    """A report as its reader sees it."""

    def __init__(self, text: str) -> None:
        assert len(text) <= COMMENT and text.startswith(f"{MARKER}\n")
        self.text = text
        self.blocks = PARSER.parse(text)
        self.inline = [child for block in self.blocks for child in block.children or ()]
        self.html = [token.content for token in (*self.blocks, *self.inline) if token.type.startswith("html")]

    def of(self, kind: str) -> list[str]:
        """The texts of all blocks of a kind, such as `heading`."""
        starts = [k for k, token in enumerate(self.blocks) if token.type == f"{kind}_open"]
        if kind == "list_item":
            return [_shown(self.blocks[k + 2]) for k in starts]
        return [_shown(self.blocks[k + 1]) for k in starts]

    @property
    def images(self) -> list[str]:
        return [str(token.attrs["src"]) for token in self.inline if token.type == "image"]


def _shown(block: Token) -> str:
    return "".join(child.content for child in block.children or () if child.type in ("text", "code_inline"))


def report(*arguments: str) -> Report:
    done = run("diff", "--format", "markdown", *arguments)
    assert done.code in (0, 2) and done.err == "", done.err
    return Report(done.out)


def _pixels(path: Path) -> np.ndarray[tuple[int, ...], np.dtype[np.uint8]]:
    return np.asarray(Image.open(io.BytesIO(path.read_bytes())).convert("RGB"))


@pytest.fixture
def changed(repository: Repository) -> Repository:
    """A commit with a changed, a new, a renamed, a removed and a broken document."""
    egg = "  egg: {shape: {sphere: 0.03}, mass: 0.06, pose: {xyz: [0.2, 0, 0.03]}}\ncameras:"
    repository.write("gone.scene.yaml", BASE.replace("name: table", "name: gone").replace("bowl", "pot"))
    repository.commit("more")
    repository.git("mv", "moved.scene.yaml", "turned.scene.yaml")
    repository.git("rm", "--quiet", "gone.scene.yaml")
    repository.write("table.scene.yaml", EDITED.replace("cameras:", egg))
    repository.write(
        "sub/new.scene.yaml", "simfoundry: scene/1\nname: new\nobjects: {a: {shape: {sphere: 1}, mass: 1}}\n"
    )
    repository.write("sub/bad.scene.yaml", "objects: [\n")
    repository.commit("change")
    return repository


@pytest.mark.usefixtures("changed")
def test_a_report_of_several_documents() -> None:
    found = report("HEAD~1..HEAD")
    assert found.of("heading") == [
        "gone.scene.yaml removed",
        "sub/bad.scene.yaml added",
        "sub/new.scene.yaml added",
        "table.scene.yaml",
        "turned.scene.yaml renamed from moved.scene.yaml",
    ]
    assert found.of("paragraph")[0] == "5 documents differ"
    assert "1 moved, 1 added, 1 renamed" in found.of("paragraph")
    items = found.of("list_item")
    for line in run("diff", "HEAD~1..HEAD", "table.scene.yaml").out.splitlines()[:-1]:
        assert line in items, "the words are those of the text"
    assert "cannot be compared: no part of HEAD:sub/bad.scene.yaml is valid" in items
    assert "HEAD:sub/bad.scene.yaml:2:1 SF002 expected a value" in items
    assert not found.images
    assert run("diff", "HEAD~1..HEAD", "--format", "json").json["documents"][4]["was"] == "moved.scene.yaml"
    assert "turned.scene.yaml (renamed from moved.scene.yaml)" in run("diff", "HEAD~1..HEAD").out


@pytest.mark.slow  # 4 s: it renders
def test_images_are_files_beside_the_report(changed: Repository) -> None:
    options = ["HEAD~1..HEAD", "-o", "out/report.md", "--pictures", "my pictures"]
    assert run("diff", "--format", "markdown", *options).code == 2
    found = Report((changed.folder / "out" / "report.md").read_text())
    files = [changed.folder / "out" / unquote(image) for image in found.images]
    assert [file.name for file in files] == [
        "01-gone-scene-before.png",
        "03-new-scene-after.png",
        "04-table-scene-before.png",
        "04-table-scene-after.png",
        "05-turned-scene-before.png",
        "05-turned-scene-after.png",
    ]
    assert all(file.stat().st_size < 40_000 for file in files)
    assert {path.name for path in (changed.folder / "my pictures").iterdir()} == {file.name for file in files}
    before, after = (_pixels(file) for file in files[2:4])
    assert before.shape == after.shape == (120, 160, 3)
    marks = [{m for m in COLORS if (p == np.array(COLORS[m])).all(axis=-1).sum() > 20} for p in (before, after)]
    assert marks == [{"moved", "changed"}, {"moved", "added", "changed"}]
    legend = "orange: moved or turned; blue: changed or renamed; green: added"
    assert legend in found.of("paragraph")
    url = "https://example.org/pr 7/"
    again = report("HEAD~1..HEAD", "table.scene.yaml", "--pictures", "other", "--pictures-url", url)
    assert again.images[0] == "https://example.org/pr%207/01-table-scene-before.png"
    written = [(changed.folder / "other" / Path(image).name).read_bytes() for image in again.images]
    assert written == [file.read_bytes() for file in files[2:4]], "the same bytes each time"
    (changed.folder / "other" / "01-table-scene-before.png").write_text("mine")
    done = run("diff", "--format", "markdown", "--pictures", "other", "HEAD~1..HEAD", "table.scene.yaml")
    assert done.code == 2 and "exists and was not generated by SimFoundry" in done.err


def test_a_side_without_an_image_says_why(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED.replace("parts/cabinet.asset.yaml", "parts/a|b.asset.yaml"))
    found = report("--pictures", "pictures", "table.scene.yaml")
    assert len(found.images) == 1
    cells = found.of("td")
    assert cells[1].startswith("The scene cannot be shown: file `parts/a|b.asset.yaml` does not exist")
    assert len(cells) == 2, "a bar does not make another cell"


def test_nothing_differs(repository: Repository) -> None:
    assert report().of("paragraph") == ["No document differs."]
    assert report("HEAD", "table.scene.yaml").of("paragraph") == ["No document differs."]
    repository.write("table.scene.yaml", f"{BASE}# a comment\n")
    assert report().of("list_item") == ["equivalent, written differently"]


# -- texts of others ------------------------------------------------------------------------------------------------

HOSTILE = [
    "@octocat and #12 and GH-12 and o/r#3 :tada: $x$",
    "</code><script>alert(1)</script>",
    "`code` ``more`` ```",
    "[a](http://x.org) ![a](http://x.org/a.png) www.evil.org https://evil.org a@b.org",
    "<!-- <details> -->",
    "</details> | cell | <img src=x onerror=alert(1)>",
    "&lt;b&gt; **bold** _it_ ~~gone~~ \\",
    "\u202ereversed\u2028next\x1b[31m",
]


def test_hostile_texts_are_only_shown(repository: Repository) -> None:
    """In the description, in a goal and in the name of a file."""
    for text in HOSTILE:
        quoted = text.replace("\\", "").replace('"', "").encode("unicode_escape").decode()
        repository.write("table.scene.yaml", f'{BASE}description: "{quoted}"\n')
        found = report("table.scene.yaml")
        assert set(found.html) <= {f"{MARKER}\n"}
        assert {token.type for token in found.inline} <= {"text", "code_inline", "strong_open", "strong_close"}
        plain = " ".join(token.content for token in found.inline if token.type == "text")
        assert not re.search(r"[@#$<&]|www|http|:\w", plain)
    names = sorted(["<b>@x.scene.yaml", "a`b](http:.scene.yaml", "#1 | -- .scene.yaml"])
    for name in names:
        repository.write(name, BASE)
    repository.git("add", "--all")
    found = report("--pictures", "p")
    assert set(found.html) <= {f"{MARKER}\n"}
    assert found.of("heading")[:3] == [f"{name} added" for name in names]
    assert len(found.images) == 5
    assert all(re.fullmatch(r"p/\d\d-[a-z0-9-]+-(before|after)\.png", image) for image in found.images)


@pytest.mark.parametrize(
    ("text", "plain"),
    [
        ("moved 3.0 cm (-x 3.0); mass 0.20 → 0.31 kg", True),
        ("added: sphere of radius 0.03 m, at (0.2, 0, 0.03) m", True),
        ("red_cup_1 renamed to blue_cup", True),
        ("goal OnTop(cup, desk) → Inside(cup, bowl)", True),
        ("2 moved, 1 removed", True),
        ("1. moved", False),
        ("see GH-12", False),
        ("www.example.org", False),
        ("_cup_", False),
        ("cup__1", False),
        ("@cup", False),
        ("a -- b", False),
    ],
)
def test_words_of_ours_are_plain_and_what_may_be_markup_is_code(text: str, plain: bool) -> None:
    assert inline(text) == (text if plain else f"`{text}`")


@given(st.text() | st.text(alphabet="ab1 `*_[]()<>!|\\~:.#@/-+=&\n\t\"'$"))
@example("1. one")
@example("- one")
@example("+ one")
@example("a\n===")
@example("`")
@example("` `` ```")
@example("a: b :c: www.x.org")
def test_any_text_is_one_text_or_one_code(text: str) -> None:
    line = printable(" ".join(text.split()))
    for made, expected in ((inline(text), line or " "), (code(text), line or " ")):
        for before in ("", "- ", "### ", "**so:** "):
            blocks = PARSER.parse(before + made)
            children = [child for block in blocks for child in block.children or ()]
            assert {child.type for child in children} <= {"text", "code_inline", "strong_open", "strong_close"}
            assert [child.content for child in children if child.type == "code_inline"] in ([], [expected])
            assert "".join(child.content for child in children).removeprefix("so: ").strip() == expected.strip()
            assert not [block for block in blocks if block.type.startswith(("html", "hr", "code", "fence", "table"))]


# -- length ---------------------------------------------------------------------------------------------------------


def test_a_long_list_is_folded_and_bounded(repository: Repository) -> None:
    names = [f"can_{k}" for k in range(400)]
    cans = "\n".join(f"  {name}: {{shape: {{sphere: 0.01}}, mass: 0.1}}" for name in names)
    repository.write("table.scene.yaml", BASE.replace("cameras:", f"{cans}\ncameras:"))
    found = report("table.scene.yaml")
    items = found.of("list_item")
    assert len(items) == 200 and items[0].startswith("can_0 added")
    assert "<details>\n<summary>388 more</summary>\n" in found.html
    assert found.html.count("</details>\n") == 1
    assert "The first 200 changes are listed; simfoundry diff shows all." in found.of("paragraph")


def test_more_than_a_comment_can_hold(repository: Repository) -> None:
    words = " ".join(f"word{k}" for k in range(400))
    for k in range(60):
        cans = "\n".join(f"  can_{j}: {{shape: {{sphere: 0.01}}, mass: 0.1}}" for j in range(30))
        text = BASE.replace("cameras:", f"{cans}\ncameras:")
        repository.write(f"scenes/s{k:03}.scene.yaml", BASE.replace("parts/", "../parts/"))
        repository.write(f"late/s{k:03}.scene.yaml", f"{text}description: {words}\n".replace("parts/", "../parts/"))
    repository.git("add", "scenes")
    repository.git("commit", "--quiet", "-m", "scenes")
    for path in (repository.folder / "late").iterdir():
        path.rename(repository.folder / "scenes" / path.name)
    found = report()
    assert COMMENT * 0.8 < len(found.text) <= 60_200
    shown = len(found.of("heading"))
    assert 0 < shown < 60
    assert f"limited to what a comment can contain: {60 - shown} more documents differ" in found.of("paragraph")[-1]
    assert sum(part.count("<details>") for part in found.html) == sum(part.count("</details>") for part in found.html)


# -- the command ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--format", "html"], "an HTML page requires an output file"),
        (["-o", "x.md"], "`-o x.md` is for pages and reports"),
        (["--pictures", "p"], "`--pictures` is for `--format markdown`"),
        (["--format", "html", "-o", "a.html", "--pictures", "p"], "an HTML page contains its images"),
        (["--format", "markdown", "--pictures-url", "x"], "`--pictures-url` requires `--pictures FOLDER`"),
        (["--format", "markdown", "-o", "table.scene.yaml"], "table.scene.yaml"),
    ],
)
def test_options_that_do_not_fit(repository: Repository, arguments: list[str], message: str) -> None:
    done = run("diff", *arguments)
    assert done.code == 2 and message in done.err and "Traceback" not in done.err
    assert (repository.folder / "table.scene.yaml").read_text() == BASE


def test_what_moves_along_is_listed(repository: Repository) -> None:
    placed = BASE.replace("pose: {xyz: [0.4, -0.1, 0.05]}", "place: {on: desk, left_of: cup}")
    repository.write("table.scene.yaml", placed)
    repository.commit("place")
    repository.write("table.scene.yaml", placed.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    along = "bowl moved along with the object that its place refers to"
    assert along in report().of("list_item")
    images = report("--pictures", "p")
    assert any(item.startswith("bowl moved 3.0 cm (+x 3.0), along with") for item in images.of("list_item"))
