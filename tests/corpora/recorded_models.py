"""A real picture through all stages that ask models, with stand-ins whose answers are recorded and replayed.

``python -m tests.corpora.recorded_models [PICTURE]`` reconstructs a picture of mosd_dev. Its models are the stand-ins
of :mod:`tests.models.stand_ins`: people's masks of the picture, and simple methods; no foundation model is run. The
table states for each stage what answered and what became of it. The second run has only the recorded answers.
"""

from __future__ import annotations

import argparse
import tempfile
import time
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.capture.run import CaptureOptions, CaptureRun, run_capture
from simfoundry.capture.synthesize import write_capture
from simfoundry.models.setup import ModelSetup
from simfoundry.runtime.files import file_digests
from simfoundry.spec.models.capture import CaptureSpec
from simfoundry.spec.models.model_sources import ModelSource
from simfoundry.spec.yaml.write import to_yaml
from simfoundry.splats.files import read_splat
from tests.corpora.segmentation import mosd_pictures
from tests.models.stand_ins import SOLVED, StandIns, configured

# What a person reads in the picture, by the number of the mask, from the top; the first one is said to have a lid.
PICTURE = "test16"


def write_picture(folder: Path, picture: str) -> StandIns:
    """Write a picture as a capture, and return stand-ins that know people's masks of it."""
    ((_, frame),) = mosd_pictures([picture])
    assert frame.instances is not None
    shot = write_capture(folder, replace(frame, instances=None))
    spec = CaptureSpec(simfoundry="capture/1", name=picture, frames={"view": shot})
    (folder / "capture.yaml").write_text(to_yaml(spec))
    numbers = [int(k) for k in np.unique(frame.instances) if k > 0]
    largest = max(numbers, key=lambda k: int((frame.instances == k).sum()) if frame.instances is not None else 0)
    return StandIns(frame.instances, {k: f"thing {k}" for k in numbers}, (largest,))


def replayed(folder: Path) -> ModelSetup:
    """A setup in which all answers are recorded ones."""
    return ModelSetup(folder, {task: (ModelSource(recorded="answers"), "recorded") for task in SOLVED})


def rows(run: CaptureRun, folder: Path) -> Mapping[str, str]:
    """What became of the answers, by stage."""
    report, spec = run.report, run.reconstruction.spec
    uses = {use.task: f"{use.name} {use.version}" for o in spec.objects.values() if o.origin for use in o.origin.models}
    splat = folder / "background.ply"
    shapes = {name: o["candidates"] for name, o in report["objects"].items() if "candidates" in o}
    return {
        "removal order": " | ".join(" ".join(layer) for layer in report["removal"]),
        "in-painted images": str(len(list((folder / "stages").glob("*_inpaint/*color.png")))),
        "meshes": ", ".join(f"{n}: {c['used']} {c['cost']}" for n, c in shapes.items()) or "none",
        "joints": ", ".join(n for n, o in spec.objects.items() if o.asset and o.asset.endswith("asset.yaml")) or "none",
        "background": f"{len(read_splat(splat))} Gaussians" if splat.is_file() else "none",
        "models of objects": ", ".join(f"{task}: {name}" for task, name in sorted(uses.items())),
        "models of the scene": ", ".join(sorted({use.task for use in spec.origin.models})) if spec.origin else "",
        "findings": "; ".join(f"{f.code} {f.message}" for f in run.findings) or "none",
    }


def prove(picture: str, folder: Path) -> bool:
    """Record the answers for a picture, replay them, and print what became of each; return whether both are equal."""
    stand_ins = write_picture(folder / "capture", picture)
    start = time.process_time()
    with configured(stand_ins, folder, record="answers") as setup:
        first = run_capture(
            folder / "capture", folder / "out", cache=Cache(folder / "cache"), options=CaptureOptions(setup=setup)
        )
    print(f"{picture}: {time.process_time() - start:.0f} s of CPU with the stand-ins")
    for stage, text in rows(first, folder / "out").items():
        print(f"  {stage:20} {text}")
    bundles = list((folder / "answers").glob("*.zip"))
    options = CaptureOptions(setup=replayed(folder))
    second = run_capture(folder / "capture", folder / "again", cache=Cache(folder / "cache"), options=options)
    asked = {task: stand_ins.asked.count(task) for task in dict.fromkeys(stand_ins.asked)}
    print(f"  {len(bundles)} recorded answers of {len(stand_ins.asked)} questions: {asked}")
    one, other = (
        {path: digest for path, digest in file_digests(folder / name).items() if not path.startswith("stages/")}
        for name in ("out", "again")
    )
    different = sorted(path for path in {*one, *other} if one.get(path) != other.get(path))
    print(f"  replayed: {'the same bytes' if not different else f'other bytes in {different}'}")
    return not different and first.report["findings"] == second.report["findings"]


def main() -> int:
    """Run the proof."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("picture", nargs="?", default=PICTURE)
    parser.add_argument("--keep", type=Path, help="Folder in which the capture, the answers and the scenes stay.")
    given = parser.parse_args()
    if given.keep is not None:
        return 0 if prove(given.picture, given.keep) else 1
    with tempfile.TemporaryDirectory(prefix="simfoundry-recorded-") as folder:
        return 0 if prove(given.picture, Path(folder)) else 1


if __name__ == "__main__":
    raise SystemExit(main())
