"""Documents that are loaded again and again while their files are edited."""

from __future__ import annotations

import os
from pathlib import Path

from simfoundry.spec.load import load
from simfoundry.spec.open_documents import OpenDocuments

SCENE = "simfoundry: scene/1\nname: desk\nobjects:\n  cup: {shape: {sphere: 0.04}, mass: 0.2}\n"
TASK = "simfoundry: task/1\nname: put\nscene: desk.scene.yaml\ninstruction: Put it down.\ngoal: Upright(cup)\n"
OVERLAY = "simfoundry: scene/1\nextends: desk.scene.yaml\nname: overlay\nobjects:\n  cup: {mass: 0.3}\n"


def _project(folder: Path) -> tuple[Path, Path, Path]:
    (folder / "simfoundry.yaml").write_text("")
    files = folder / "desk.scene.yaml", folder / "put.task.yaml", folder / "overlay.scene.yaml"
    for file, text in zip(files, (SCENE, TASK, OVERLAY), strict=True):
        file.write_text(text)
    return files


def test_open_texts_replace_bases_and_used_documents(tmp_path: Path) -> None:
    desk, put, overlay = _project(tmp_path)
    documents = OpenDocuments()
    assert not documents.load(put).errors
    documents.edit(desk, SCENE.replace("cup", "mug"))
    assert {d.code for d in documents.load(put).errors} == {"SF201"}
    assert documents.load(overlay).findings != load(overlay).findings
    documents.edit(desk, None)
    for file in (put, overlay):
        assert documents.load(file).all_findings() == load(file).all_findings()


def test_open_texts_replace_included_scenes(tmp_path: Path) -> None:
    desk, _, _ = _project(tmp_path)
    house = tmp_path / "house.scene.yaml"
    house.write_text("simfoundry: scene/1\nname: house\ninclude:\n  a: {scene: desk.scene.yaml}\n")
    documents = OpenDocuments()
    assert list(getattr(documents.load(house).spec, "objects", ())) == ["a_cup"]
    documents.edit(desk, SCENE.replace("cup", "mug"))
    assert list(getattr(documents.load(house).spec, "objects", ())) == ["a_mug"]


def test_documents_are_kept_until_their_files_change(tmp_path: Path) -> None:
    desk, put, overlay = _project(tmp_path)
    documents = OpenDocuments()
    first, scene = documents.load(put), documents.load(desk)
    assert first.uses[str(desk)] is scene
    documents.edit(put, TASK.replace("down", "up"))
    assert documents.load(put).uses[str(desk)] is scene
    desk.write_text(SCENE.replace("0.04", "0.05"))
    assert documents.load(put).uses[str(desk)] is documents.load(desk) is not scene
    above = documents.load(overlay)
    os.utime(desk, ns=(1, 1))
    assert documents.load(overlay) is not above


def test_a_link_to_another_file_is_a_change(tmp_path: Path) -> None:
    desk, put, _ = _project(tmp_path)
    other = tmp_path / "other.scene.yaml"
    other.write_text(SCENE.replace("cup", "mug"))
    documents = OpenDocuments()
    desk.rename(tmp_path / "first.scene.yaml")
    desk.symlink_to("first.scene.yaml")
    assert not documents.load(put).errors
    desk.unlink()
    desk.symlink_to("other.scene.yaml")
    assert {d.code for d in documents.load(put).errors} == {"SF201"}


def test_documents_with_errors_are_read_again(tmp_path: Path) -> None:
    desk, put, _ = _project(tmp_path)
    documents = OpenDocuments()
    desk.unlink()
    assert {d.code for d in documents.load(put).errors} == {"SF203"}
    desk.write_text(SCENE)
    assert not documents.load(put).errors
