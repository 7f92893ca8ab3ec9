"""The capture from which a scene was reconstructed: it is found by its name, and shown in the world of the scene."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

from simfoundry.capture.frame import CaptureError
from simfoundry.capture.frames.load import matrix
from simfoundry.capture.outputs.overlay import SEGMENTS, CaptureOverlay, load_overlay
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_capture
from simfoundry.spec.models.capture import CaptureSpec, Shot
from simfoundry.spec.project import document_files
from simfoundry.studio.acts.decomposition import CaptureFrame
from simfoundry.studio.reading import StudioScene

# Largest difference [px] between the focal lengths of a camera in the scene and of the capture, which is rounding.
FOCAL_PX = 0.01


class NoCaptureError(SimfoundryError):
    """Raised if a scene has no capture, or if it cannot be shown."""


def capture_names(scene: StudioScene) -> tuple[str, ...]:
    """Return the names of the captures that the scene or its objects state as their origin."""
    origins = [scene.spec.origin, *(item.origin for item in scene.spec.objects.values())]
    return tuple(dict.fromkeys(origin.capture for origin in origins if origin is not None and origin.capture))


def find_capture(scene: StudioScene, root: Path, given: Path | None = None) -> CaptureFrame:
    """Return the frame of the capture from which a scene was reconstructed.

    Args:
        scene: The scene.
        root: The folder of the project, whose captures are searched. Those in folders nearer to the scene come first.
        given: The capture document, if it is known.

    Raises:
        NoCaptureError: The scene does not name a capture, or there is no such capture.
    """
    names = capture_names(scene)
    if not names:
        raise NoCaptureError("the scene does not name a capture as its `origin`")
    for path in [given] if given is not None else sorted(_captures(root), key=lambda p: _distance(p, scene)):
        try:
            spec = load_capture(path).spec
        except SpecError as error:
            if given is not None:
                raise NoCaptureError(f"{path} cannot be used: {error.diagnostics[0].message}") from None
            continue
        assert isinstance(spec, CaptureSpec)
        for frame in spec.frames:
            if (spec.name if len(spec.frames) == 1 else f"{spec.name}_{frame}") in names:
                return CaptureFrame(path, frame)
    where = f"{given} is not" if given is not None else f"no capture below {root} is called"
    raise NoCaptureError(f"{where} `{names[0]}`, which the scene names as its `origin`; name it with --capture")


def _captures(root: Path) -> Iterator[Path]:
    """Yield the capture documents of a project."""
    found = document_files(root)
    yield from (p for p in (*found.included, *found.excluded) if p.name.endswith("capture.yaml") and p.is_file())


def _distance(path: Path, scene: StudioScene) -> tuple[int, str]:
    """Return the number of folders between a document and the scene, and its path, to which ties are resolved."""
    relative = os.path.relpath(path, scene.loaded.path.parent)
    return relative.count(os.sep), relative


def scene_overlay(scene: StudioScene, source: CaptureFrame) -> CaptureOverlay:
    """Return the frame of a capture in the world of the scene, by the pose of the camera that took it.

    Raises:
        NoCaptureError: The scene has no such camera, or a file cannot be used.
    """
    try:
        loaded = load_capture(source.document)
        assert isinstance(loaded.spec, CaptureSpec)
        X_WC = _camera_pose(scene, loaded.spec.frames[source.frame])
        return load_overlay(loaded, source.frame, X_WC, scene.loaded.path.parent / SEGMENTS)
    except SpecError as error:
        raise NoCaptureError(f"{source.document} cannot be used: {error.diagnostics[0].message}") from None
    except CaptureError as error:
        raise NoCaptureError(f"{source.document} cannot be used: {error.message}") from None


def _camera_pose(scene: StudioScene, shot: Shot) -> Pose:
    """Return the pose of the camera of the scene that took an image: that of the viewpoint if several are alike."""
    K = matrix(shot.camera)
    alike = [c for c in scene.scene.cameras if abs(c.fx - K[0, 0]) < FOCAL_PX and abs(c.fy - K[1, 1]) < FOCAL_PX]
    chosen = sorted(alike, key=lambda c: c.name != scene.spec.viewpoint)
    if not chosen:
        message = f"the scene has no camera with fx = {K[0, 0]:g} and fy = {K[1, 1]:g} as in the capture"
        raise NoCaptureError(f"{message}, so it is unknown from where the picture was taken")
    return chosen[0].X_WC
