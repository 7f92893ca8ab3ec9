"""Makes ``docs/images/expert.png`` anew: nine pictures, evenly in time, of a rollout of the scripted expert.

    python specs/render_rollout.py [TASK [START]]

Needs the robots' models (docs/robots.md). TASK is a name of ``specs/tasks`` (``store_marker``), START the number of one
of its 25 starts (0).
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from PIL import Image
from render_pictures import png

from simfoundry.evaluate.expert.policy import ExpertPolicy
from simfoundry.evaluate.policies.base import ImageSize
from simfoundry.evaluate.resets.starts import starts
from simfoundry.evaluate.rollouts.rollout import Rollout, Video, rollout
from simfoundry.evaluate.task import load_task
from simfoundry.worlds import open_world

SPECS = Path(__file__).resolve().parent
PICTURE = SPECS.parent / "docs" / "images" / "expert.png"
SIZE = ImageSize(320, 180)
ROWS, COLUMNS, GAP = 3, 3, 4
MAX_BYTES = 200_000


def main() -> int:
    """Roll out, write the picture, say how large it is; 1 where the rollout was lost or the picture is too large."""
    name, index = (*sys.argv[1:], *("store_marker", "0")[len(sys.argv) - 1 :])
    camera, one = filmed(SPECS / "tasks" / f"{name}.task.yaml", int(index))
    if not one.success:
        print(f"the rollout was lost: {one.reason}", file=sys.stderr)
        return 1
    frames = one.frames[camera]
    shown = np.linspace(0, len(frames) - 1, ROWS * COLUMNS).round().astype(int)
    data = png(sheet([Image.fromarray(frames[k]) for k in shown]).quantize(128, dither=Image.Dither.NONE))
    PICTURE.write_bytes(data)
    print(f"{PICTURE.name}  {len(data) / 1000:.0f} kB  {one.steps} steps  {dict(one.subtasks)}")
    return int(len(data) > MAX_BYTES)


def filmed(file: Path, index: int) -> tuple[str, Rollout]:
    """A rollout of a task from one of its starts, and the camera that filmed it."""
    task = load_task(file)
    start = starts(task, 25)[index]
    camera = task.scene.cameras[0].name
    with open_world(task.scene, "mujoco") as world:
        return camera, rollout(task, start, ExpertPolicy(task), world, video=Video({camera: SIZE}, every=4))


def sheet(pictures: list[Image.Image]) -> Image.Image:
    """Pictures of one size side by side, row by row, with white between them."""
    width, height = pictures[0].size
    whole = Image.new("RGB", (COLUMNS * (width + GAP) - GAP, ROWS * (height + GAP) - GAP), "white")
    for k, picture in enumerate(pictures):
        whole.paste(picture, (k % COLUMNS * (width + GAP), k // COLUMNS * (height + GAP)))
    return whole


if __name__ == "__main__":
    sys.exit(main())
