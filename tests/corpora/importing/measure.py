"""One file imported, compiled back and compared; or one corrupted file imported. Runs in a worker's process."""

from __future__ import annotations

import tempfile
import time
import traceback
from collections.abc import Callable
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.frontends.draft import ImportOptions
from simfoundry.frontends.files import read_xml
from simfoundry.frontends.importer import ImportReport, import_file
from simfoundry.scene.lower import lower_file
from simfoundry.scene.model import Scene
from simfoundry.spec.diagnostics import SpecError
from simfoundry.targets.build import build
from tests.corpora.importing.mjcf import compare_mjcf, load_mjcf
from tests.corpora.importing.outcome import Outcome
from tests.corpora.importing.urdf import compare_urdf, read_side
from tests.corpora.importing.usd import compare_usd, load_usd

Comparing = Callable[[Outcome, ImportReport, Scene, Path], None]


def measure(corpus: str, file: str) -> Outcome:
    """Import, compile and compare one file."""
    outcome, path = Outcome(corpus, file, format_of(Path(file))), Path(file)
    started = time.perf_counter()
    compare = _comparison(outcome, path)
    outcome.loads = compare is not None
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "thing.scene.yaml"
        try:
            report = import_file(path, out, ImportOptions())
            scene = lower_file(out)
            if compare is not None:
                compare(outcome, report, scene, Path(folder))
        except (SimfoundryError, SpecError) as error:
            outcome.refused = str(error).removeprefix(str(path)).lstrip(":0123456789 ")
        except Exception:
            outcome.broke = traceback.format_exc(limit=-2)
    outcome.seconds = time.perf_counter() - started
    return outcome


def format_of(path: Path) -> str:
    """URDF, MJCF or USD."""
    if path.suffix == ".xml":
        try:
            return "URDF" if read_xml(path).tag == "robot" else "MJCF"
        except SimfoundryError:
            return "MJCF"
    return "URDF" if path.suffix == ".urdf" else "USD"


def _comparison(outcome: Outcome, path: Path) -> Comparing | None:
    """How to compare with what the engine of this format says; None where that refuses the file, or finds it empty."""
    if outcome.format == "URDF":
        side = read_side(path)

        def urdf(outcome: Outcome, report: ImportReport, scene: Scene, folder: Path) -> None:
            assert side is not None
            build(scene, ["pybullet"], folder)
            compare_urdf(outcome, report, side, path, next((folder / "pybullet").glob("*.urdf")))

        return None if side is None else urdf
    if outcome.format == "MJCF":
        model = load_mjcf(path)

        def mjcf(outcome: Outcome, report: ImportReport, scene: Scene, folder: Path) -> None:
            build(scene, ["mjcf"], folder)
            compare_mjcf(outcome, report, model, folder / "mjcf/scene.xml")

        return None if model is None or (model.nbody == 1 and model.ngeom == 0) else mjcf
    stage = load_usd(path)

    def usd(outcome: Outcome, report: ImportReport, scene: Scene, folder: Path) -> None:
        build(scene, ["usd"], folder)
        compare_usd(outcome, report, stage, scene, folder / "usd/scene.usda")

    return None if stage is None else usd


def corrupt(corpus: str, file: str) -> Outcome:
    """Import one corrupted file, or refuse it."""
    outcome, path = Outcome(corpus, file), Path(file)
    started = time.perf_counter()
    with tempfile.TemporaryDirectory() as folder:
        try:
            import_file(path, Path(folder) / "thing.scene.yaml", ImportOptions())
        except (SimfoundryError, SpecError) as error:
            outcome.refused = str(error).removeprefix(str(path)).lstrip(":0123456789 ")
        except Exception:
            outcome.broke = traceback.format_exc(limit=-2)
    outcome.seconds = time.perf_counter() - started
    return outcome
