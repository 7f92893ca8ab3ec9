"""Lints SF301, SF409 and SF412: backgrounds and textures that cannot be used, and objects out of every view.

Occlusion is not taken into account.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator
from itertools import product

import numpy as np

from simfoundry.geometry.frames import Array
from simfoundry.lint.lints import Lint, Path_, Subject, warning, where
from simfoundry.scene.model import Camera
from simfoundry.spec.diagnostics import Diagnostic


def unseen(subject: Subject) -> Iterator[Diagnostic]:
    """Find free objects outside the view of every camera.

    Cameras that are mounted on a robot are skipped because they move.
    """
    free = [item.name for item in subject.scene.scene.objects if not item.fixed]
    yield from _unseen(subject, free, lambda name: where(subject.loaded, name))


def unseen_at_start(subject: Subject) -> Iterator[Diagnostic]:
    """Find objects that the initial state of a task places outside the view of every camera."""
    start = subject.task.start
    moved: dict[str, Path_] = {n: ("start", key, n) for key in ("place", "pose") for n in getattr(start, key)}
    yield from _unseen(subject, moved, moved.__getitem__)


def _unseen(subject: Subject, names: Iterable[str], path_of: Callable[[str], Path_]) -> Iterator[Diagnostic]:
    draft, cameras = subject.scene, subject.scene.cameras
    if not cameras:
        return
    for name in names:
        if name not in draft.bounds:
            continue
        low, high = draft.bounds[name]
        if any(sees(camera, low, high) for camera in cameras.values()):
            continue
        angle, nearest = min((off_axis(camera, (low + high) / 2), key) for key, camera in cameras.items())
        message = f"`{name}` is outside the view of " + (f"`{nearest}`" if len(cameras) == 1 else "every camera")
        seen = f"whose image extends {half_angle(cameras[nearest]):.0f} deg to the corners"
        hint = f"it is {angle:.0f} deg off the optical axis of `{nearest}`, {seen}; move the object or the camera"
        yield warning(subject.loaded, "SF409", path_of(name), message, hint)


def sees(camera: Camera, low: Array, high: Array) -> bool:
    """Return False if all corners of a box are behind the camera or beyond the same image edge, and True otherwise."""
    x, y, z = camera.X_WC.inverse().apply(np.array(list(product(*zip(low, high, strict=True))))).T
    x, y = camera.fx * x, camera.fy * y
    right, bottom = camera.width - 0.5 - camera.cx, camera.height - 0.5 - camera.cy
    inside = (z, x + (camera.cx + 0.5) * z, right * z - x, y + (camera.cy + 0.5) * z, bottom * z - y)
    return not any((side < 0).all() for side in inside)


def off_axis(camera: Camera, point: Array) -> float:
    """Return the angle [deg] between the optical axis and the direction to a point in the world frame."""
    x, y, z = camera.X_WC.inverse().apply(point)
    return math.degrees(math.atan2(math.hypot(x, y), z))


def half_angle(camera: Camera) -> float:
    """Return the angle [deg] between the optical axis and the farthest corner of the image."""
    across = max(camera.cx + 0.5, camera.width - 0.5 - camera.cx) / camera.fx
    down = max(camera.cy + 0.5, camera.height - 0.5 - camera.cy) / camera.fy
    return math.degrees(math.atan(math.hypot(across, down)))


OUT_OF_VIEW = Lint("SF409", ("scene/1",), unseen)
START_OUT_OF_VIEW = Lint("SF409", ("task/1",), unseen_at_start)


HINT = "add the file, or remove the reference to it from the mesh; the surface is rendered without a texture"


def lost_textures(subject: Subject) -> Iterator[Diagnostic]:
    """Find mesh textures that are missing or unreadable."""
    from simfoundry.assets.textures import document_faults

    for path, wrong in document_faults(subject.loaded, subject.loaded.spec):  # type: ignore[arg-type]
        yield warning(subject.loaded, "SF412", path, wrong, HINT)


LOST_TEXTURE = Lint("SF412", ("scene/1", "asset/1"), lost_textures)


def unusable_background(subject: Subject) -> Iterator[Diagnostic]:
    """Find a background whose file cannot be used."""
    from simfoundry.assets.cache import Cache
    from simfoundry.assets.errors import MeshError
    from simfoundry.assets.mesh_summary import mesh_facts
    from simfoundry.splats.files import check_splat

    written = subject.scene.spec.background
    if written is None:
        return
    key = "mesh" if written.mesh is not None else "splat"
    path = subject.loaded.file(written.mesh or written.splat or "")
    try:
        if key == "mesh":
            mesh_facts(path, Cache.default())
        else:
            check_splat(path, written.scale, Cache.default())
    except MeshError as error:
        yield subject.loaded.finding(error.code, ("background", key), str(error), error.hint)


BACKGROUND = Lint("SF301", ("scene/1",), unusable_background)
