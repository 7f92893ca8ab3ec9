"""`simfoundry diff` of files and of revisions in a real repository."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.spec.change.git.revisions import GitError, export, files_of
from tests.cli.command import Done, run
from tests.cli.repository import BASE, CABINET, EDITED, WORDS, Repository


def _lines(done: Done, code: int = 0) -> list[str]:
    assert (done.code, done.err) == (code, "")
    return done.out.splitlines()


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
        "can, box moved along with the objects that their places refer to",
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
    assert _lines(run("diff", "table.scene.yaml", "--exit-code")) == ["equivalent, written differently"]


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
        (["HEAD", "HEAD", "HEAD"], "give two files, or one or two revisions followed by files"),
        (["table.scene.yaml", "HEAD"], "give two files, or one or two revisions followed by files"),
        (["--format", "html"], "an HTML page requires an output file; use `--format html` and `-o PAGE.html` together"),
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
    assert done.code == 2 and "is not in a git repository; pass two files to compare" in done.err


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
    assert done.out == "cannot be compared: no part of table.scene.yaml is valid\n"
    assert "table.scene.yaml:2:1: error[SF002]" in done.err


def test_an_overlay_without_its_base_is_not_taken_for_the_whole(repository: Repository) -> None:
    (repository.folder / "table.scene.yaml").unlink()
    done = run("diff", "moved.scene.yaml")
    assert (done.code, done.out) == (2, "cannot be compared: no part of moved.scene.yaml is valid\n")


def test_another_kind_of_document_cannot_be_compared(repository: Repository) -> None:
    repository.write("other.scene.yaml", CABINET)
    done = run("diff", "table.scene.yaml", "other.scene.yaml")
    assert (done.code, done.out) == (2, "cannot be compared: the kind changed from `scene/1` to `asset/1`\n")


def test_json_can_be_applied(repository: Repository) -> None:
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.yaml.write import to_data
    from tests.spec.change.changing import apply, from_json

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
