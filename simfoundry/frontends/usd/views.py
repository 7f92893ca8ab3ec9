"""Cameras and lights of a USD stage."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from simfoundry.frontends.draft import BodyDraft, CameraDraft, Draft, LightDraft
from simfoundry.geometry.frames import Array, Pose

WIDTH = 640
"""Width [px] of the picture of a camera: USD gives its proportions only."""

FULL = {"DistantLight": math.pi, "SphereLight": 4 * math.pi, "DomeLight": 1.0}
"""Intensity of a light of UsdLux that lights a white surface fully; a point light does so at 1 m."""

Matrix = Callable[[Any], Array]
Mounts = dict[str, tuple[BodyDraft, str, Pose]]


def _pose(X_WP: Array) -> Pose:
    """The frame without its scale; a mirrored one is turned right."""
    u, _, v = np.linalg.svd(X_WP[:3, :3])
    out = np.eye(4)
    out[:3, :3], out[:3, 3] = u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v, X_WP[:3, 3]
    return Pose.from_matrix(out)


def add_cameras(draft: Draft, pxr: Any, prims: list[Any], matrix: Matrix, mounts: Mounts) -> None:
    """Perspective cameras; those below a rigid body ride on its link."""
    for prim in prims:
        if not prim.IsA(pxr.UsdGeom.Camera):
            continue
        camera = pxr.UsdGeom.Camera(prim)
        if camera.GetProjectionAttr().Get() != "perspective":
            draft.dropped(f"camera `{prim.GetPath()}`", "it is orthographic, and cameras are pinholes here")
            continue
        focal = float(camera.GetFocalLengthAttr().Get())
        across, up = (float(a.Get()) for a in (camera.GetHorizontalApertureAttr(), camera.GetVerticalApertureAttr()))
        if min(focal, across, up) <= 0:
            draft.dropped(f"camera `{prim.GetPath()}`", "its focal length or aperture is not positive")
            continue
        height = max(1, round(WIDTH * up / across))
        draft.assumed(f"picture size of camera `{prim.GetPath()}`", f"none is given; {WIDTH} px wide")
        X_WP = _pose(matrix(prim)) @ Pose.of(q=(0.0, 1.0, 0.0, 0.0))
        made = CameraDraft(prim.GetName(), (WIDTH, height), focal / across * WIDTH, focal / up * height, X_WP)
        aside = [
            float(a.Get()) for a in (camera.GetHorizontalApertureOffsetAttr(), camera.GetVerticalApertureOffsetAttr())
        ]
        if any(aside):
            made.cx = (WIDTH - 1) / 2 - aside[0] / across * WIDTH
            made.cy = (height - 1) / 2 + aside[1] / up * height
        carrier = prim.GetParent()
        while carrier and str(carrier.GetPath()) not in mounts:
            carrier = carrier.GetParent()
        if carrier:
            body, link, X_WL = mounts[str(carrier.GetPath())]
            made.mount, made.X_WC = (body.name, link), X_WL.inverse() @ X_WP
        draft.cameras.append(made)


def add_lights(draft: Draft, pxr: Any, prims: list[Any], matrix: Matrix) -> None:
    """Distant, sphere and dome lights; others are noted."""
    for prim in prims:
        if not (prim.IsA(pxr.UsdLux.BoundableLightBase) or prim.IsA(pxr.UsdLux.NonboundableLightBase)):
            continue
        kind = prim.GetTypeName()
        if kind not in FULL:
            draft.dropped(f"light `{prim.GetPath()}`", "lights here are distant, points or domes", kind)
            continue
        light = pxr.UsdLux.LightAPI(prim)
        strength = float(light.GetIntensityAttr().Get()) * 2 ** float(light.GetExposureAttr().Get()) / FULL[kind]
        r, g, b = (min(max(float(v), 0.0), 1.0) for v in light.GetColorAttr().Get())
        X_WP = _pose(matrix(prim))
        x, y, z = (float(v) for v in X_WP.p)
        dx, dy, dz = (float(v) for v in np.round(X_WP.rotation @ (0, 0, -1), 9) + 0.0)
        if kind == "DomeLight" and pxr.UsdLux.DomeLight(prim).GetTextureFileAttr().Get():
            draft.dropped(f"texture of light `{prim.GetPath()}`", "a dome has one colour here")
        if strength > 20:
            draft.changed(
                f"intensity of light `{prim.GetPath()}`",
                "it is for a camera with an exposure; here 1 is full light",
                f"{strength:.4g}",
            )
            strength = 1.0
        word = {"DistantLight": "distant", "SphereLight": "point", "DomeLight": "dome"}[kind]
        draft.lights.append(LightDraft(prim.GetName(), word, strength, (r, g, b), (dx, dy, dz), (x, y, z)))
