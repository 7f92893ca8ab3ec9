"""``simfoundry diff``: files and revisions in a real repository, git's driver, the page."""

from __future__ import annotations

import base64
import colorsys
import io
import itertools
import json
import math
import os
import random
import re
import shlex
import subprocess
import sys
from html.parser import HTMLParser
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from simfoundry.reports.comparison import COLORS
from simfoundry.reports.labels import place_labels
from simfoundry.reports.pictures import Tag, tints_of
from simfoundry.spec.change.git.revisions import GitError, export, files_of
from tests.cli.command import Done, run
from tests.conftest import REPOSITORY

CABINET = """\
simfoundry: asset/1
name: cabinet
links:
  body: {mass: 3, parts: {wall: {shape: {box: [0.1, 0.1, 0.1]}}}}
  drawer: {mass: 1, parts: {tray: {shape: {box: [0.08, 0.08, 0.05]}}}}
joints:
  slide: {type: prismatic, parent: body, child: drawer, limits: [0, 0.2], axis: [1, 0, 0]}
"""
BASE = """\
simfoundry: scene/1
name: table
viewpoint: front
materials: {ceramic: {density: 2400, friction: 0.35}}
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, material: ceramic, pose: {xyz: [0.3, 0.1, 0.05]}}
  bowl: {shape: {sphere: 0.05}, material: ceramic, color: [0.2, 0.4, 0.8], pose: {xyz: [0.4, -0.1, 0.05]}}
  cabinet: {asset: parts/cabinet.asset.yaml, pose: {xyz: [0.6, 0.1, 0.05]}}
cameras:
  front: {size: [160, 120], fx: 150, fy: 150, pose: {xyz: [-0.4, 0, 0.6], look_at: [0.4, 0, 0]}}
relations: [OnTop(cup, desk)]
"""
OVERLAY = "simfoundry: scene/1\nextends: table.scene.yaml\nname: moved\nobjects: {cup: {friction: 0.7}}\n"
EDITED = BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]").replace("  bowl:", "  dish:")


class Repository:
    """A repository with one commit: a scene, a scene that extends it, and the asset that both use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.git("init", "--quiet", "--initial-branch=main")
        self.write("table.scene.yaml", BASE)
        self.write("moved.scene.yaml", OVERLAY)
        self.write("parts/cabinet.asset.yaml", CABINET)
        self.commit("one")

    def git(self, *args: str, driver: bool = False) -> str:
        command = f"{shlex.quote(sys.executable)} -m simfoundry.cli.main diff --git"
        options = ["-c", f"diff.simfoundry.command={command}"] if driver else []
        person = {f"GIT_{who}_{what}": "t@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        done = subprocess.run(
            ["git", *options, *args],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, **person, "GIT_CONFIG_GLOBAL": os.devnull, "PYTHONPATH": str(REPOSITORY)},
        )
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    def write(self, name: str, text: str) -> None:
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(text)

    def commit(self, message: str) -> None:
        self.git("add", "--all")
        self.git("commit", "--quiet", "-m", message)


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Repository:
    monkeypatch.chdir(tmp_path)
    return Repository(tmp_path)


def _lines(done: Done, code: int = 0) -> list[str]:
    assert (done.code, done.err) == (code, "")
    return done.out.splitlines()


WORDS = ["cup moved 3.0 cm (+x 3.0)", "bowl renamed to dish", "1 moved, 1 renamed"]


def test_two_files(repository: Repository) -> None:
    repository.write("b.scene.yaml", EDITED)
    assert _lines(run("diff", "table.scene.yaml", "b.scene.yaml")) == WORDS
    assert _lines(run("diff", "b.scene.yaml", "b.scene.yaml")) == ["no difference"]


def test_what_is_placed_by_what_moved_moves_along(repository: Repository) -> None:
    placed = BASE.replace(
        "cameras:",
        "  can: {shape: {sphere: 0.03}, mass: 0.1, place: {on: desk, left_of: cup}}\n"
        "  box: {shape: {sphere: 0.03}, mass: 0.1, place: {on: desk, behind: can}}\n"
        "  tin: {shape: {sphere: 0.03}, mass: 0.1, place: {on: desk, xy: [0.2, -0.2]}}\ncameras:",
    )
    repository.write("a.scene.yaml", placed)
    repository.write("b.scene.yaml", placed.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    assert _lines(run("diff", "a.scene.yaml", "b.scene.yaml")) == [
        "cup moved 3.0 cm (+x 3.0)",
        "can, box moved with what their places name",
        "1 moved",
    ]
    repository.write("b.scene.yaml", placed.replace("behind: can}", "behind: can, gap: 0.2}"))
    assert not any("moved with" in line for line in _lines(run("diff", "a.scene.yaml", "b.scene.yaml")))


def test_a_file_against_a_revision(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED)
    assert _lines(run("diff", "table.scene.yaml")) == WORDS
    assert _lines(run("diff", "HEAD", "table.scene.yaml")) == WORDS
    assert _lines(run("diff", "HEAD:table.scene.yaml", "table.scene.yaml")) == WORDS
    repository.commit("two")
    assert _lines(run("diff", "table.scene.yaml")) == ["no difference"]
    for revisions in (["HEAD~1"], ["HEAD~1..HEAD"], ["HEAD~1..."], ["HEAD~1", "main"], ["HEAD~1.."]):
        assert _lines(run("diff", *revisions, "table.scene.yaml")) == WORDS
    assert _lines(run("diff", "HEAD..HEAD~1", "table.scene.yaml"))[0] == "cup moved 3.0 cm (-x 3.0)"


def test_three_dots_start_where_two_branches_parted(repository: Repository) -> None:
    repository.git("checkout", "--quiet", "-b", "feature")
    repository.write("table.scene.yaml", EDITED)
    repository.commit("feature")
    repository.git("checkout", "--quiet", "main")
    repository.write("table.scene.yaml", BASE.replace("density: 2400", "density: 2500"))
    repository.commit("main")
    assert _lines(run("diff", "main...feature", "table.scene.yaml")) == WORDS
    assert "material ceramic: density 2500 → 2400 kg/m^3 (of cup, dish)" in _lines(
        run("diff", "main..feature", "table.scene.yaml")
    )


def test_every_document_that_differs(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED)
    repository.write("notes.yaml", "a: 1\n")
    repository.write("new.scene.yaml", "simfoundry: scene/1\nname: new\nobjects: {a: {shape: {sphere: 1}, mass: 1}}\n")
    (repository.folder / "moved.scene.yaml").unlink()
    repository.git("add", "--all")
    expected = [
        "moved.scene.yaml",
        "  removed: 1 material (ceramic), 4 objects (desk, cup, bowl, cabinet), 1 camera (front)",
        "new.scene.yaml",
        "  added: 1 object (a)",
        "table.scene.yaml",
        *(f"  {line}" for line in WORDS),
    ]
    assert _lines(run("diff")) == _lines(run("diff", "HEAD")) == expected
    assert _lines(run("diff", "HEAD", "table.scene.yaml", "new.scene.yaml"))[0] == "table.scene.yaml"
    assert _lines(run("diff", "HEAD", "moved.scene.yaml"))[0].startswith("removed: 1 material")
    assert _lines(run("diff", "parts")) == ["no document differs"]


def test_a_renamed_document_is_compared_with_itself(repository: Repository) -> None:
    repository.git("mv", "table.scene.yaml", "desk.scene.yaml")
    repository.write("desk.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.git("add", "--all")
    # `moved.scene.yaml` has lost its base, but did not change itself
    assert _lines(run("diff")) == ["cup moved 3.0 cm (+x 3.0)", "1 moved"]


def test_what_a_revision_refers_to_comes_from_that_revision(repository: Repository) -> None:
    """The base of an overlay and the asset of an object differ too, and are taken as they were."""
    repository.write("table.scene.yaml", EDITED)
    repository.write("parts/cabinet.asset.yaml", CABINET.replace("mass: 3", "mass: 4"))
    assert _lines(run("diff", "moved.scene.yaml")) == [
        "cup moved 3.0 cm (+x 3.0)",
        "bowl renamed to dish",
        "cabinet: parts/cabinet.asset.yaml changed (1 changed)",
        "1 moved, 1 renamed, 1 changed",
    ]
    (repository.folder / "parts/cabinet.asset.yaml").unlink()
    assert "cup moved 3.0 cm (+x 3.0)" in run("diff", "moved.scene.yaml").out


def test_numbers_of_a_mesh_are_no_files(repository: Repository) -> None:
    """A mesh has more numbers than a document may refer to files; what comes behind them is found all the same."""
    corners = [f"v {k / 1e6:.6f} {k % 7 / 7:.6f} {k % 11 / 11:.6f}" for k in range(4500)]
    repository.write("meshes/a b.obj", "\n".join(["mtllib  skin of b.mtl", *corners, "f 1 3 2", ""]))
    repository.write("meshes/skin of b.mtl", "newmtl skin\nKd 0.123456 0.2 0.3\nmap_Kd -s 1 1 1 ../skins/b.png\n")
    repository.write("skins/b.png", "no picture")
    repository.write("z.asset.yaml", CABINET.replace("shape: {box: [0.08, 0.08, 0.05]}", 'mesh: "meshes/a b.obj"'))
    objects = '  cup_a: {asset: "meshes/a b.obj", mass: 0.1}\n  last: {asset: z.asset.yaml}\ncameras:'
    repository.write("table.scene.yaml", BASE.replace("cameras:", objects))
    repository.commit("meshes")
    with files_of(repository.folder, "HEAD") as read:
        export(read, "table.scene.yaml", repository.folder / "out")
    found = {p.relative_to(repository.folder / "out").as_posix() for p in (repository.folder / "out").rglob("*.*")}
    meshes = {"meshes/a b.obj", "meshes/skin of b.mtl", "skins/b.png"}
    assert found == {"table.scene.yaml", "z.asset.yaml", "parts/cabinet.asset.yaml", *meshes}
    assert _lines(run("diff", "HEAD", "table.scene.yaml")) == ["no difference"]


def test_more_files_than_anybody_has_are_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("simfoundry.spec.change.git.revisions.MAX_FILES", 3)
    files = {"a.scene.yaml": b"[a.obj, b.obj, a.obj]", "b.scene.yaml": b"[a.obj, b.obj, c.obj]"}
    assert export(lambda name: files.get(name, b""), "a.scene.yaml", tmp_path) is not None
    with pytest.raises(GitError, match=r"b\.scene\.yaml refers to more than 3 files"):
        export(lambda name: files.get(name, b""), "b.scene.yaml", tmp_path)


def test_the_unit_of_a_joint_comes_from_its_asset(repository: Repository) -> None:
    asset = "parts/cabinet.asset.yaml"
    repository.write("table.scene.yaml", BASE.replace(f"asset: {asset}", f"asset: {asset}, joints: {{slide: 0.12}}"))
    assert _lines(run("diff", "table.scene.yaml"))[0] == "cabinet: joint slide 0.00 → 0.12 m"


def test_what_is_only_written_otherwise(repository: Repository) -> None:
    repository.write("table.scene.yaml", "# The table.\n" + BASE.replace("[0.3, 0.1, 0.05]", "[0.30, 0.1, 5e-2]"))
    assert _lines(run("diff", "table.scene.yaml", "--exit-code")) == ["the same, written otherwise"]


def test_exit_codes(repository: Repository) -> None:
    assert run("diff", "--exit-code").code == 0
    repository.write("table.scene.yaml", EDITED)
    assert run("diff").code == 0
    assert run("diff", "--exit-code").code == 1
    assert run("diff", "--exit-code", "table.scene.yaml").code == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nothing"], "`nothing` is neither a file nor a revision of this repository"),
        (["--", "-p"], "`-p` is neither a file nor a revision of this repository"),
        (["HEAD", "no.scene.yaml"], "there is no document no.scene.yaml"),
        (["HEAD:no.scene.yaml", "HEAD:none.scene.yaml"], "there is no document HEAD:none.scene.yaml"),
        (["HEAD", "HEAD", "HEAD"], "give two files; or a revision, or two, and then files"),
        (["table.scene.yaml", "HEAD"], "give two files; or a revision, or two, and then files"),
        (["--format", "html"], "an HTML page needs an output file; give `--format html` and `-o PAGE.html` together"),
    ],
)
@pytest.mark.usefixtures("repository")
def test_what_cannot_be_compared(arguments: list[str], message: str) -> None:
    done = run("diff", *arguments)
    assert (done.code, done.out) == (2, "")
    assert done.err.strip() == f"Error: {message}"


def test_outside_of_a_repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("GIT_CEILING_DIRECTORIES", str(tmp_path.parent))
    (tmp_path / "a.scene.yaml").write_text(BASE)
    done = run("diff", "a.scene.yaml")
    assert done.code == 2 and "is in no git repository; give two files" in done.err


def test_documents_with_errors_are_compared_as_far_as_they_are_sound(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED.replace("fx: 150", "fx: wide"))
    done = run("diff", "table.scene.yaml")
    assert done.code == 0
    assert done.out.splitlines()[:3] == [*WORDS[:2], "camera front removed"]
    assert "table.scene.yaml:11:" in done.err and "error[SF103]" in done.err and "^" in done.err
    repository.commit("broken")
    done = run("diff", "HEAD", "HEAD~1", "table.scene.yaml")
    assert "HEAD:table.scene.yaml:11:" in done.err and "fx: wide" in done.err


def test_nothing_sound_cannot_be_compared(repository: Repository) -> None:
    repository.write("table.scene.yaml", "objects: [")
    done = run("diff", "table.scene.yaml")
    assert done.code == 2
    assert done.out == "cannot be compared: nothing is sound in table.scene.yaml\n"
    assert "table.scene.yaml:2:1: error[SF002]" in done.err


def test_an_overlay_without_its_base_is_not_taken_for_the_whole(repository: Repository) -> None:
    (repository.folder / "table.scene.yaml").unlink()
    done = run("diff", "moved.scene.yaml")
    assert (done.code, done.out) == (2, "cannot be compared: nothing is sound in moved.scene.yaml\n")


def test_another_kind_of_document_cannot_be_compared(repository: Repository) -> None:
    repository.write("other.scene.yaml", CABINET)
    done = run("diff", "table.scene.yaml", "other.scene.yaml")
    assert (done.code, done.out) == (2, "cannot be compared: it was `scene/1` and is `asset/1`\n")


def test_json_can_be_applied(repository: Repository) -> None:
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.yaml.write import to_data
    from tests.spec.changing import apply, from_json

    repository.write("b.scene.yaml", EDITED)
    done = run("diff", "table.scene.yaml", "b.scene.yaml", "--format", "json")
    (document,) = done.json["documents"]
    a, b = (load_scene(repository.folder / name).spec for name in ("table.scene.yaml", "b.scene.yaml"))
    assert a is not None and b is not None
    assert apply([from_json(c) for c in document["changes"]], to_data(a)) == to_data(b)
    assert document["summary"] == "1 moved, 1 renamed"
    assert [(e["name"], e["was"], e["marks"]) for e in document["entries"]] == [
        ("cup", "", ["moved"]),
        ("dish", "bowl", ["renamed"]),
    ]


def test_texts_from_documents_do_not_steer_the_terminal(repository: Repository) -> None:
    repository.write("table.scene.yaml", f'{BASE}description: "\\e[2J\\a wiped"\n')
    out = run("diff", "table.scene.yaml").out
    assert "\\x1b[2J\\x07 wiped" in out and "\x1b" not in out


# -- git's driver ---------------------------------------------------------------------------------------------------


def _attributes(repository: Repository) -> None:
    repository.write(".gitattributes", "*.yaml diff=simfoundry\n")
    repository.commit("attributes")


def test_git_diff_speaks_in_the_words_of_the_scene(repository: Repository) -> None:
    _attributes(repository)
    repository.write("table.scene.yaml", EDITED)
    assert repository.git("diff", driver=True).splitlines() == ["table.scene.yaml", *(f"  {w}" for w in WORDS)]
    repository.commit("two")
    assert repository.git("show", "--ext-diff", "--format=", driver=True).splitlines()[1:] == [f"  {w}" for w in WORDS]


def test_git_diff_shows_documents_that_come_and_go(repository: Repository) -> None:
    _attributes(repository)
    repository.git("rm", "--quiet", "table.scene.yaml")
    repository.write("bowl.asset.yaml", CABINET)
    repository.git("add", "--all")
    assert repository.git("diff", "HEAD", "--no-renames", driver=True).splitlines() == [
        "bowl.asset.yaml",
        "  added: 2 links (body, drawer), 1 joint (slide)",
        "table.scene.yaml",
        "  removed: 1 material (ceramic), 4 objects (desk, cup, bowl, cabinet), 1 camera (front)",
    ]


def test_git_diff_follows_a_renamed_document(repository: Repository) -> None:
    _attributes(repository)
    repository.git("mv", "table.scene.yaml", "desk.scene.yaml")
    repository.write("desk.scene.yaml", BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    repository.git("add", "--all")
    assert repository.git("diff", "HEAD", "-M", driver=True).splitlines() == [
        "table.scene.yaml renamed to desk.scene.yaml",
        "  cup moved 3.0 cm (+x 3.0)",
        "  1 moved",
    ]


@pytest.mark.parametrize("broken", ["objects: [", "\t", "simfoundry: scene/9\n", "a: &x [*x]\n"])
def test_git_diff_falls_back_to_plain_text(repository: Repository, broken: str) -> None:
    _attributes(repository)
    repository.write("table.scene.yaml", broken)
    out = repository.git("diff", driver=True)
    assert out.startswith("diff --git a/table.scene.yaml b/table.scene.yaml\n--- a/table.scene.yaml\n")
    assert "-name: table\n" in out and f"+{broken.splitlines()[0]}\n".expandtabs(1) in out.replace("\\t", " ")
    assert repository.git("diff", driver=True) == out


def test_git_diff_of_a_link(repository: Repository) -> None:
    """A document that became a link, to nowhere at that: git shows one removed and one added."""
    _attributes(repository)
    (repository.folder / "table.scene.yaml").unlink()
    (repository.folder / "table.scene.yaml").symlink_to("nowhere.scene.yaml")
    out = repository.git("diff", driver=True)
    assert "  removed: 1 material (ceramic)" in out and "\n+nowhere.scene.yaml\n" in out


def test_git_diff_of_a_merge_conflict(repository: Repository) -> None:
    _attributes(repository)
    assert run("diff", "--git", "table.scene.yaml").out == "* unmerged: table.scene.yaml\n"


# -- the page -------------------------------------------------------------------------------------------------------


class _Page(HTMLParser):
    """Elements and texts of a page, and what may run or be loaded."""

    VOID = ("meta", "img")

    def __init__(self, html: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(html)
        assert not self.open, "elements that are not closed"

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open:
            self.text += data

    def pictures(self) -> list[np.ndarray[tuple[int, ...], np.dtype[np.uint8]]]:
        sources = [attrs["src"] or "" for tag, attrs in self.elements if tag == "img"]
        data = [base64.b64decode(s.removeprefix("data:image/png;base64,")) for s in sources]
        return [np.asarray(Image.open(io.BytesIO(d)).convert("RGB")) for d in data]


def _page(repository: Repository, *arguments: str) -> _Page:
    done = run("diff", *arguments, "--format", "html", "-o", "page.html")
    assert done.code in (0, 2), done.err
    return _Page((repository.folder / "page.html").read_text())


def _has(picture: np.ndarray[tuple[int, ...], np.dtype[np.uint8]], mark: str) -> bool:
    return bool((picture == np.array(COLORS[mark])).all(axis=-1).sum() > 20)


def test_the_page_shows_both_scenes_and_what_changed(repository: Repository) -> None:
    edited = EDITED.replace("  cabinet: {asset: parts/cabinet.asset.yaml, pose: {xyz: [0.6, 0.1, 0.05]}}\n", "")
    egg = "  egg: {shape: {sphere: 0.03}, mass: 0.06, pose: {xyz: [0.2, 0, 0.03]}}\ncameras:"
    repository.write("table.scene.yaml", edited.replace("cameras:", egg))
    page = _page(repository)
    before, after = page.pictures()
    assert before.shape == after.shape == (120, 160, 3)  # from the viewpoint
    marks = [{m for m in COLORS if _has(picture, m)} for picture in (before, after)]
    assert marks == [{"moved", "removed", "changed"}, {"moved", "added", "changed"}]
    for line in ("cup moved 3.0 cm (+x 3.0)", "cabinet removed", "egg added", "bowl renamed to dish"):
        assert line in page.text
    tags = [a["class"] for t, a in page.elements if t == "span" and "tag" in (a.get("class") or "")]
    assert len(tags) == 6


STACK = """\
simfoundry: scene/1
name: stack
viewpoint: front
cameras:
  front: {size: [160, 120], fx: 200, fy: 200, pose: {xyz: [-0.6, 0.1, 0.5], look_at: [0.4, 0, 0]}}
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  stool: {shape: {box: [0.2, 0.2, 0.1]}, mass: 2, place: {on: desk, xy: [0.3, 0]}}
  pot: {shape: {sphere: 0.04}, mass: 0.3, place: {on: stool, local_xy: [0.02, 0]}}
  can: {shape: {sphere: 0.04}, mass: 0.3, pose: {xyz: [0.6, 0.1, 0.04]}}
"""


def test_the_page_shows_what_moves_along(repository: Repository) -> None:
    """Of what its place brings along, no text says where to; things without a color are not one gray."""
    repository.write("a.scene.yaml", STACK)
    repository.write(
        "b.scene.yaml", STACK.replace("0.2, 0.2, 0.1]", "0.2, 0.2, 0.13]").replace("[0.3, 0]", "[0.34, 0]")
    )
    page = _page(repository, "a.scene.yaml", "b.scene.yaml")
    assert "pot moved 5.0 cm (+x 4.0, +z 3.0), with what its place names" in page.text
    assert "2 moved, 1 changed" in page.text
    tags = [
        attrs["class"] or "" for tag, attrs in page.elements if tag == "span" and "tag" in (attrs.get("class") or "")
    ]
    assert sorted(tag.split()[:2] for tag in tags) == [["tag", "moved"]] * 4
    lit = np.array([colorsys.rgb_to_hsv(*pixel) for pixel in page.pictures()[1].reshape(-1, 3)[::7] / 255])
    hues = {round(h * 12) % 12 for h, s, _ in lit if s > 0.2}
    assert len(hues) >= 4, "three tints, and the color of the outline"


def test_a_gray_thing_keeps_its_tint_under_another_name() -> None:
    tints = tints_of(["desk", "cup", "mug"])
    assert tints == {**tints_of(["desk", "cup"]), "mug": tints["mug"]}
    assert min(math.dist(a, b) for a, b in itertools.combinations(tints_of("abcdefghij").values(), 2)) > 0.08


@pytest.mark.parametrize("aspect", [4 / 3, 2.5, 0.5])
def test_labels_do_not_cover_one_another(aspect: float) -> None:
    rng = random.Random(5)
    for count in (1, 2, 12, 60):
        tags = [Tag("t" * rng.randint(1, 40), 0.5 + rng.gauss(0, 0.1), 0.6 + rng.gauss(0, 0.1)) for _ in range(count)]
        labels = place_labels(tags, aspect)
        assert not any(a.meets(b) for a, b in itertools.combinations(labels, 2))
        assert all(b.width / 2 <= b.x <= 1 - b.width / 2 + 1e-9 and b.height <= b.y <= 1 for b in labels)
        assert all(abs(b.x - b.thing_x) <= b.width / 2 + 1e-9 for b in labels if 0 <= b.thing_x <= 1)
        assert len(labels) == count or count > 2, "where there is no room, some are left out"


def test_the_page_is_the_same_each_time_and_stands_alone(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED)
    page = _page(repository)
    first = (repository.folder / "page.html").read_bytes()
    _page(repository)
    assert (repository.folder / "page.html").read_bytes() == first
    assert not {tag for tag, _ in page.elements} & {"script", "link", "iframe", "object", "a"}
    assert not re.search(rb"https?:|url\(|@import", first)


def test_a_scene_without_a_viewpoint_is_seen_from_the_side(repository: Repository) -> None:
    plain = re.sub(r"cameras:\n.*\n", "", BASE.replace("viewpoint: front\n", ""))
    repository.write("a.scene.yaml", plain)
    repository.write("b.scene.yaml", plain.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]"))
    before, after = _page(repository, "a.scene.yaml", "b.scene.yaml").pictures()
    assert before.shape == after.shape == (480, 640, 3)
    assert _has(before, "moved") and _has(after, "moved")


def test_hostile_texts_are_only_shown(repository: Repository) -> None:
    hostile = '"</style><script>alert(1)</script><img src=x onerror=alert(2)>"'
    repository.write("table.scene.yaml", f"{BASE}description: {hostile}\n")
    repository.write("<b>&.scene.yaml", BASE)
    page = _page(repository, "<b>&.scene.yaml", "table.scene.yaml")
    assert "</style><script>alert(1)</script>" in page.text and "<b>&.scene.yaml" in page.text
    assert not [tag for tag, attrs in page.elements if tag == "script" or "onerror" in attrs]
    assert len([tag for tag, _ in page.elements if tag == "img"]) == 2


def test_a_side_that_cannot_be_shown_says_why(repository: Repository) -> None:
    repository.write("table.scene.yaml", EDITED.replace("parts/cabinet.asset.yaml", "parts/cupboard.asset.yaml"))
    page = _page(repository)
    assert len(page.pictures()) == 1
    assert "The scene cannot be shown: there is no file `parts/cupboard.asset.yaml`." in page.text
    assert "SF203" in page.text
    repository.write("table.scene.yaml", "objects: [")
    page = _page(repository)
    assert len(page.pictures()) == 1 and "cannot be compared: nothing is sound in table.scene.yaml" in page.text


def test_documents_of_other_kinds_have_no_pictures(repository: Repository) -> None:
    repository.write("parts/cabinet.asset.yaml", CABINET.replace("mass: 3", "mass: 4"))
    page = _page(repository)
    assert not page.pictures() and "mass 3 → 4 kg" in page.text


def test_a_page_of_nothing(repository: Repository) -> None:
    assert "No document differs." in _page(repository).text
    assert json.loads(run("diff", "--format", "json").out) == {"documents": []}
