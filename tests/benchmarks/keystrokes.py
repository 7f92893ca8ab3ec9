"""How long a document takes to check again after an edit of one character: prints medians of one warm process.

    python -m tests.benchmarks.keystrokes [--runs 9] [--like boxes]

Times are those of the processor, for machines that others keep busy. Each run changes one digit of the text, loads it
with :class:`simfoundry.spec.open_documents.OpenDocuments` as an editor does, and runs the lints. Documents are those of
``specs/`` and the large ones of :func:`write_project`.
"""

from __future__ import annotations

import argparse
import gc
import math
import re
import statistics
import tempfile
import time
from pathlib import Path

from simfoundry.language_server.server import GC_THRESHOLD
from simfoundry.lint.lints import lint_subject, subject_of
from simfoundry.spec.open_documents import OpenDocuments
from tests.conftest import REPOSITORY

# Number of objects in each large document.
COUNT = 1000

# Number of asset documents and meshes of the scene whose objects use them.
ASSETS = 20

HEADER = """\
simfoundry: scene/1
name: {name}
materials:
  card: {{density: 200, friction: 0.5}}
objects:
  ground: {{fixed: true, shape: {{box: [30, 40, 0.2]}}, material: card, pose: {{xyz: [11, 8, -0.1]}}}}
"""


def boxes(count: int = COUNT) -> str:
    """A scene of boxes placed on a ground, and relations of each tenth."""
    lines = [HEADER.format(name="boxes").rstrip()]
    for name, x, y in _grid(count, "box"):
        lines += [f"  {name}:", "    shape: {box: [0.3, 0.2, 0.15]}", "    material: card"]
        lines += [f"    place: {{on: ground, xy: [{x}, {y}]}}"]
    return "\n".join([*lines, "relations:", *(f"  - OnTop(box_{k}, ground)" for k in range(0, count, 10)), ""])


def instances(count: int = COUNT) -> str:
    """A scene of objects that use the assets and meshes of :func:`write_project`, half of them each."""
    lines = [HEADER.format(name="instances").rstrip()]
    for k, (name, x, y) in enumerate(_grid(count, "item")):
        number = k // 2 % ASSETS
        used = f"asset: item_{number}.asset.yaml" if k % 2 else f"asset: mesh_{number}.obj\n    material: card"
        lines += [f"  {name}:", f"    {used}", f"    place: {{on: ground, xy: [{x}, {y}]}}"]
    return "\n".join([*lines, "relations:", *(f"  - OnTop(item_{k}, ground)" for k in range(0, count, 10)), ""])


def repeated(count: int = COUNT) -> str:
    """A scene that repeats one object."""
    lines = [HEADER.format(name="repeated").rstrip()]
    lines += ["  parcel:", "    shape: {box: [0.3, 0.2, 0.15]}", "    material: card", "    place: {on: ground}"]
    lines += [f"    repeat: {{count: [{max(1, count // 40)}, 40], step: [0.6, 0.4]}}"]
    return "\n".join([*lines, ""])


TASK = """\
simfoundry: task/1
name: move_box
scene: boxes.scene.yaml
instruction: Put a box on another.
goal: OnTop(box_3, box_5)
horizon: 450
"""

OVERLAY = """\
simfoundry: scene/1
extends: boxes.scene.yaml
name: overlay
objects:
  box_7: {mass: 2.5}
"""

ASSET = """\
simfoundry: asset/1
name: item
materials: {{card: {{density: 200}}}}
links:
  body:
    parts:
      a: {{shape: {{box: [0.3, {width}, 0.1]}}, material: card}}
      b: {{shape: {{sphere: 0.05}}, pose: {{xyz: [0, 0, 0.1]}}, material: card}}
"""

SCENES = ("boxes", "instances", "repeated", "overlay")


def write_project(folder: Path, count: int = COUNT) -> list[Path]:
    """Write a project of large documents, and return their paths: a scene of boxes, one of instances, and so on."""
    (folder / "simfoundry.yaml").write_text("")
    for k in range(ASSETS):
        width = round(0.2 + 0.004 * k, 3)
        (folder / f"item_{k}.asset.yaml").write_text(ASSET.format(width=width))
        (folder / f"mesh_{k}.obj").write_text(_box_mesh(0.3, width, 0.1))
    texts = dict(zip(SCENES, (boxes(count), instances(count), repeated(count), OVERLAY), strict=True))
    files = [(folder / f"{name}.scene.yaml", text) for name, text in texts.items()]
    files.append((folder / "move_box.task.yaml", TASK))
    for file, text in files:
        file.write_text(text)
    return [file for file, _ in files]


def _grid(count: int, name: str) -> list[tuple[str, float, float]]:
    side = math.ceil(math.sqrt(count))
    return [(f"{name}_{k}", round(k % side * 0.6, 3), round(k // side * 0.4, 3)) for k in range(count)]


def _box_mesh(*size: float) -> str:
    corners = [(x, y, z) for x in (0, size[0]) for y in (0, size[1]) for z in (0, size[2])]
    faces = ((1, 2, 4, 3), (5, 7, 8, 6), (1, 5, 6, 2), (3, 4, 8, 7), (1, 3, 7, 5), (2, 6, 8, 4))
    lines = [f"v {x} {y} {z}" for x, y, z in corners]
    lines += [f"f {' '.join(map(str, corner))}" for a, b, c, d in faces for corner in ((a, b, c), (a, c, d))]
    return "\n".join([*lines, ""])


def edited(text: str, turn: int) -> str:
    """The text with one more digit in the middle, which moves or resizes something a little."""
    ends = [number.end() for number in re.finditer(r"\d\.\d+", text)] or [len(text) - 1]
    at = ends[len(ends) // 2]
    return f"{text[:at]}{turn % 9 + 1}{text[at:]}"


def measured(path: Path, runs: int) -> tuple[float, float]:
    """Median milliseconds of processor time for loading and of linting after an edit."""
    gc.set_threshold(GC_THRESHOLD)  # as in the server
    documents, text = OpenDocuments(), path.read_text(encoding="utf-8")
    times, draft = list[tuple[float, float]](), None
    for turn in range(runs + 1):
        documents.edit(path, edited(text, turn))
        start = time.process_time()
        loaded = documents.load(path)
        middle = time.process_time()
        subject, errors = subject_of(loaded, earlier=draft)
        lint_subject(loaded, subject, errors)
        draft = subject.draft if subject is not None else None
        times.append((1e3 * (middle - start), 1e3 * (time.process_time() - middle)))
    load, lints = zip(*times[1:], strict=True)
    return statistics.median(load), statistics.median(lints)


def main() -> None:
    """Print a line for each document."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=9)
    parser.add_argument("--like", default="", help="only documents with this in their name")
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        paths = [*write_project(Path(folder)), *sorted((REPOSITORY / "specs").glob("[st][ca]*s/*.yaml"))]
        for path in paths:
            if arguments.like in path.name:
                load, lints = measured(path, arguments.runs)
                row = f"load {load:6.1f} ms  lint {lints:6.1f} ms  both {load + lints:6.1f} ms"
                print(f"{path.name:40} {row}", flush=True)


if __name__ == "__main__":
    main()
