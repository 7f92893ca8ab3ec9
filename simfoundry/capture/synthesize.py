"""A scene to a capture folder: what a real sensor would have recorded of it."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from simfoundry.capture.sensor import simulate_frame, write_capture
from simfoundry.render.raycast import raycast
from simfoundry.runtime.files import write_atomically
from simfoundry.runtime.outputs import MARK
from simfoundry.scene.model import Camera, Scene
from simfoundry.spec.models.capture import CaptureSpec, DepthImage, Intrinsics, Masks, Shot
from simfoundry.spec.yaml.write import to_yaml

CAPTURE_FILES = ("capture.yaml", "color.png", "depth.png", "instances.png")
"""What a synthesized capture consists of."""


def synthesize(
    scene: Scene, camera: Camera, folder: Path, seed: int, masks: bool = False, truth: Path | None = None
) -> Path:
    """Write color, depth and ``capture.yaml`` of ``scene`` seen by ``camera`` into ``folder``; returns the document.

    The same scene and seed give the same bytes. ``truth`` names the scene document in the capture where it lies in
    the same folder.
    """
    from dataclasses import replace

    frame = simulate_frame(raycast(scene, camera), np.random.default_rng(seed))
    written = write_capture(folder, frame if masks else replace(frame, instances=None))
    shot = Shot(
        color=written.color,
        depth=DepthImage(image=written.depth, scale=written.depth_scale),
        camera=Intrinsics(fx=camera.fx, fy=camera.fy, cx=camera.cx, cy=camera.cy),
        masks=None if written.instances is None else Masks(image=written.instances),
    )
    beside = truth is not None and truth.resolve().parent == folder.resolve()
    spec = CaptureSpec(
        simfoundry="capture/1",
        name=folder.resolve().name,
        description=f"The scene {scene.name} as a simulated sensor sees it from {camera.name}, seed {seed}.",
        frames={camera.name: shot},
        truth=truth.name if beside and truth is not None else None,
    )
    path = folder / CAPTURE_FILES[0]
    write_atomically(path, to_yaml(spec, comment=f"{MARK}; delete this line to keep your edits.").encode())
    return path
