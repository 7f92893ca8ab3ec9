"""One capture through the whole flow, twice, and everything that is promised about it."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from typing import Any

import yaml

from simfoundry.assets.cache import Cache
from simfoundry.capture.findings import LEFT_OUT
from simfoundry.cli.output import DONE, FINDINGS
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from tests.corpora.realtables import consumers, truth, worlds
from tests.corpora.realtables.commands import CLI, Ran, different_files, environment, run
from tests.corpora.realtables.documents import RealCapture, write_document
from tests.corpora.realtables.table import Cell, Measures, Row

COLUMNS = (
    "exit", "seconds", "cpu", "MB", "objects", "IoU", "size", "settled", "check", "lines", "compile", "USD valid",
    "opens", "read-back", "MuJoCo 2 s", "PyBullet 2 s", "twice",
)  # fmt: skip

MAX_SECONDS, MAX_MEGABYTES, MAX_LINES = 90.0, 2000.0, 15
MAX_SIZE_ERROR, MAX_CENTER_ERROR = 0.01, 0.02
MAX_MOVED, MAX_TURNED_DEG = 0.01, 5.0
MAX_RELATIVE_ERROR = 1e-6


@dataclass
class Proof:
    """The folders of one capture, and what is known about it so far."""

    capture: RealCapture
    work: Path
    cells: dict[str, Cell] = field(default_factory=dict)
    measures: Measures = field(default_factory=Measures)

    @property
    def document(self) -> Path:
        """The folder of the capture document."""
        return self.work / "capture"

    @property
    def scene_file(self) -> Path:
        """The scene that the first run makes."""
        return self.out(1) / f"{self.capture.name}.scene.yaml"

    def out(self, turn: int) -> Path:
        """Where the first or second run of the capture goes."""
        return self.work / f"run{turn}" / "scene"

    def build(self, turn: int) -> Path:
        """Where the first or second compile goes."""
        return self.work / f"run{turn}" / "build"

    def env(self, turn: int) -> dict[str, str]:
        """Each turn has an empty cache of its own, and another order of hashes."""
        return environment(self.work / f"run{turn}" / "cache", 40 + turn)

    def cli(self, turn: int, *arguments: str | Path) -> Ran:
        """Run ``simfoundry`` in the work folder."""
        return run((*CLI, *map(str, arguments)), self.work, self.env(turn))


def prove(capture: RealCapture, work: Path) -> Row:
    """Everything about one capture; ``work`` is a folder for its files. A step that raises is a failing cell."""
    load = os.getloadavg()[0]
    proof = Proof(capture, work)
    write_document(capture, proof.document)
    if _captured(proof):
        _step(proof, "objects", _objects)
        _step(proof, "check", _checked)
        _step(proof, "lines", _lines)
        _step(proof, "settled", _settled)
        if _step(proof, "compile", _compiled):
            scene = lower_file(proof.scene_file, Cache(work / "run1" / "cache"))
            _step(proof, "size", partial(_sizes, scene))
            _step(proof, "USD valid", _validated)
            _step(proof, "opens", _opens)
            _step(proof, "read-back", partial(_read_back, scene))
            for engine in worlds.ENGINES:
                _step(proof, f"{engine} 2 s", partial(_rests, scene, engine))
            _step(proof, "twice", _twice)
    return Row(capture.name, proof.cells, proof.measures, load)


def _step(proof: Proof, column: str, step: Callable[[Proof], Cell]) -> bool:
    try:
        cell = step(proof)
    except Exception as error:  # a long run over many captures goes on, and shows where it could not
        cell = Cell("raised", False, f"{type(error).__name__}: {error}")
    proof.cells[column] = cell
    return cell.passed is not False


def _captured(proof: Proof) -> bool:
    ran = proof.cli(1, "capture", proof.document, "-o", proof.out(1))
    proof.measures = replace(proof.measures, seconds=ran.seconds, megabytes=ran.megabytes)
    proof.cells["exit"] = Cell(str(ran.code), ran.code == 0, ran.last_words())
    proof.cells["seconds"] = Cell(f"{ran.seconds:.1f}", ran.seconds <= MAX_SECONDS)
    proof.cells["cpu"] = Cell(f"{ran.cpu_seconds:.1f}")
    proof.cells["MB"] = Cell(f"{ran.megabytes:.0f}", ran.megabytes <= MAX_MEGABYTES)
    return ran.code in (DONE, FINDINGS)  # with findings, there is a scene all the same


def _objects(proof: Proof) -> Cell:
    """How many became objects, and how well the segments cover what people marked; the bars are in the totals."""
    report = _report(proof)
    missing = [finding["message"] for finding in report["findings"] if finding["code"] == LEFT_OUT]
    found, left_out = len(report["objects"]), len(missing)
    figure, why = f"{found} + {left_out} left out" if left_out else str(found), "; ".join(missing)
    labels_true = truth.true_labels(proof.capture)
    if labels_true is None:
        proof.measures = replace(proof.measures, objects_found=found)
        return Cell(figure, None, why)
    labels = truth.found_labels(proof.document)
    if truth.count(labels) != found + left_out:
        return Cell(figure, False, f"{truth.count(labels)} segments in this process, {figure} in the run")
    overlaps = tuple(truth.overlaps(labels_true, labels))
    count = truth.count(labels_true)
    proof.measures = replace(proof.measures, objects_true=count, objects_found=found, overlaps=overlaps)
    proof.cells["IoU"] = Cell(f"{sum(overlaps) / len(overlaps):.3f}" if overlaps else "none")
    return Cell(f"{figure} of {count}", None, why)


def _sizes(scene: Scene, proof: Proof) -> Cell:
    """Where a true size or place is known, how far off it is."""
    if (height_true := truth.CRACKER_BOX_HEIGHT.get(proof.capture.name)) is not None:
        found = truth.cracker_box(scene, truth.photograph(proof.capture))
        if found is None:
            return Cell("no box", False, "no red object where the photograph shows one")
        name, height = found
        error = height - height_true
        why = f"{name} is {height:.3f} m high, the cracker box {height_true} m"
        verdict = abs(error) <= MAX_SIZE_ERROR if proof.capture.name in truth.STANDING else None
        return Cell(f"{error * 100:+.1f} cm", verdict, why)
    if "objects" in proof.capture.entry:
        name, distance = truth.bottle(proof.capture, scene)
        why = f"{name} is the nearest to the bottle: center off by {distance * 100:.1f} cm"
        return Cell(f"{distance * 100:.1f} cm", distance <= MAX_CENTER_ERROR, why)
    return Cell("-")


def _settled(proof: Proof) -> Cell:
    """What the run itself reports of settling; a report and no bar, since what counts is that objects rest."""
    objects = _report(proof)["objects"]
    problems = {name: o["settle"]["problems"] for name, o in objects.items() if not o["settle"]["passed"]}
    why = "; ".join(f"{name} {', '.join(said)}" for name, said in problems.items())
    return Cell(f"{len(objects) - len(problems)} of {len(objects)}", None, why)


def _checked(proof: Proof) -> Cell:
    ran = proof.cli(1, "check", proof.scene_file)
    return Cell("", ran.code == 0, ran.last_words())


def _lines(proof: Proof) -> Cell:
    """Lines that the longest object takes in the document."""
    lines = lines_of_objects(proof.scene_file.read_text(encoding="utf-8"))
    name = max(lines, key=lambda n: lines[n])
    return Cell(str(lines[name]), lines[name] <= MAX_LINES, f"{name} takes {lines[name]} lines")


def lines_of_objects(text: str) -> dict[str, int]:
    """How many lines each object of a scene document takes, its key included."""
    document = yaml.compose(text, Loader=yaml.SafeLoader)
    assert document is not None
    objects = next(value for key, value in document.value if key.value == "objects")
    starts = [(key.value, key.start_mark.line) for key, _ in objects.value]
    ends = [line for _, line in starts[1:]] + [objects.end_mark.line]
    return {name: end - start for (name, start), end in zip(starts, ends, strict=True)}


def _compiled(proof: Proof) -> Cell:
    ran = proof.cli(1, "compile", proof.scene_file, "-o", proof.build(1))
    return Cell(f"{ran.seconds:.1f} s", ran.code == 0, ran.last_words())


def _validated(proof: Proof) -> Cell:
    errors = consumers.validation_errors(proof.build(1) / "usd" / "scene.usda")
    return Cell("" if not errors else str(len(errors)), not errors, "; ".join(errors[:3]))


def _opens(proof: Proof) -> Cell:
    empty = proof.work / "elsewhere"
    empty.mkdir()
    found = consumers.complaints(proof.build(1), proof.env(1), empty)
    return Cell("" if not found else str(len(found)), not found, "; ".join(found[:3]))


def _read_back(scene: Scene, proof: Proof) -> Cell:
    stale = worlds.stale_files(scene, proof.build(1))
    if stale:
        return Cell("stale", False, f"files differ from what the scene compiles to: {', '.join(stale[:3])}")
    errors = worlds.read_back_errors(scene, proof.build(1))
    engine = max(errors, key=lambda e: errors[e][0])
    error, where = errors[engine]
    return Cell(f"{error:.0e}", error <= MAX_RELATIVE_ERROR, f"{where} in {engine} is off by {error:.1e}")


def _rests(scene: Scene, engine: str, _: Proof) -> Cell:
    rest = worlds.rest(scene, engine, MAX_MOVED, MAX_TURNED_DEG)
    figure = f"{rest.moved * 1000:.1f} mm {rest.turned_deg:.1f}°"
    return Cell(figure, not rest.restless, "; ".join(rest.restless))


def _twice(proof: Proof) -> Cell:
    """A second capture and compile without anything of the first one."""
    again = proof.cli(2, "capture", proof.document, "-o", proof.out(2))
    if str(again.code) != proof.cells["exit"].figure:
        return Cell("", False, again.last_words())
    compiled = proof.cli(2, "compile", proof.out(2) / proof.scene_file.name, "-o", proof.build(2))
    if compiled.code != 0:
        return Cell("", False, compiled.last_words())
    different = different_files(proof.out(1), proof.out(2)) + different_files(proof.build(1), proof.build(2))
    return Cell("" if not different else str(len(different)), not different, ", ".join(different[:6]))


def _report(proof: Proof) -> dict[str, Any]:
    report: dict[str, Any] = json.loads((proof.out(1) / "report.json").read_text(encoding="utf-8"))
    return report
