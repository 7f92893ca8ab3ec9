"""The HTML page of `simfoundry diff`: pictures, marks, labels and safe texts."""

from __future__ import annotations

import base64
import colorsys
import io
import itertools
import json
import math
import random
import re
from html.parser import HTMLParser

import numpy as np
import pytest
from PIL import Image

from simfoundry.reports.comparison import COLORS
from simfoundry.reports.pictures import Tag, place_labels, tints_of
from tests.cli.command import run
from tests.cli.repository import BASE, CABINET, EDITED, Repository


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
    assert "pot moved 5.0 cm (+x 4.0, +z 3.0), along with the object that its place refers to" in page.text
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


@pytest.mark.slow  # 4 s: it renders
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
    assert "The scene cannot be shown: file `parts/cupboard.asset.yaml` does not exist." in page.text
    assert "SF203" in page.text
    repository.write("table.scene.yaml", "objects: [")
    page = _page(repository)
    assert len(page.pictures()) == 1 and "cannot be compared: no part of table.scene.yaml is valid" in page.text


def test_documents_of_other_kinds_have_no_pictures(repository: Repository) -> None:
    repository.write("parts/cabinet.asset.yaml", CABINET.replace("mass: 3", "mass: 4"))
    page = _page(repository)
    assert not page.pictures() and "mass 3 → 4 kg" in page.text


def test_a_page_of_nothing(repository: Repository) -> None:
    assert "There are no differences." in _page(repository).text
    assert json.loads(run("diff", "--format", "json").out) == {"documents": []}
