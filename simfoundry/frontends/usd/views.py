"""Read the cameras and lights in a USD stage."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.assets.errors import MeshError
from simfoundry.assets.panorama import read_panorama
from simfoundry.backends.usd.surroundings import FULL, X_CU, X_DOME
from simfoundry.frontends.draft import BodyDraft, CameraDraft, LightDraft, ModelDraft
from simfoundry.frontends.names import plain_name
from simfoundry.geometry.frames import Array, Pose, quat_from_matrix
from simfoundry.scene.model import LightType

# Largest rotation [rad] of a dome light that is not reported.
UPRIGHT_RAD = 1e-3

# Image width of cameras [px], as in MuJoCo by default; USD specifies only the aspect ratio.
WIDTH = 640

# Attributes of a camera: the focal length, the width and height of the aperture, and its offsets along these.
LENS = ("focalLength", "horizontalAperture", "verticalAperture")
OFFSETS = ("horizontalApertureOffset", "verticalApertureOffset")

# Light types by UsdLux prim type; :data:`FULL` contains the intensity at which each fully lights a white surface.
LIGHTS = {"DistantLight": LightType.DISTANT, "SphereLight": LightType.POINT, "DomeLight": LightType.DOME}

# Intensity above which a light is assumed to be meant for a camera with exposure; Omniverse uses thousands.
BRIGHTEST = 20.0

Matrix = Callable[[Any], Array]
# The body draft, the link, and the pose of the link frame in the world, by the path of the rigid body.
Mounts = dict[str, tuple[BodyDraft, str, Pose]]


def _pose(X_WP: Array) -> Pose:
    """Return the pose of a transform, ignoring scale and mirroring."""
    u, _, v = np.linalg.svd(X_WP[:3, :3])
    return Pose.of(X_WP[:3, 3], quat_from_matrix(u @ np.diag([1, 1, np.linalg.det(u @ v)]) @ v))


def add_cameras(draft: ModelDraft, pxr: Any, prims: list[Any], matrix: Matrix, mounts: Mounts) -> None:
    """Add all perspective cameras. Cameras below a rigid body are attached to its link."""
    for prim in (prim for prim in prims if prim.IsA(pxr.UsdGeom.Camera)):
        camera, what = pxr.UsdGeom.Camera(prim), f"camera `{prim.GetPath()}`"
        focal, across, up, right, above = (float(prim.GetAttribute(name).Get()) for name in (*LENS, *OFFSETS))
        if camera.GetProjectionAttr().Get() != "perspective":
            draft.dropped(what, "the camera is orthographic, but only pinhole cameras are supported")
            continue
        if min(focal, across, up) <= 0:
            draft.dropped(what, "the focal length or aperture is not positive")
            continue
        height = max(1, round(WIDTH * up / across))
        draft.assumed(f"image size of {what}", f"the stage specifies no size; a width of {WIDTH} px is assumed")
        X_WC = _pose(matrix(prim)) @ X_CU
        drafted = CameraDraft(prim.GetName(), (WIDTH, height), focal / across * WIDTH, focal / up * height, X_WC)
        if right or above:
            drafted.cx = (WIDTH - 1) / 2 - right / across * WIDTH
            drafted.cy = (height - 1) / 2 + above / up * height
        carrier = prim.GetParent()
        while carrier and str(carrier.GetPath()) not in mounts:
            carrier = carrier.GetParent()
        if carrier:
            body, link, X_WL = mounts[str(carrier.GetPath())]
            drafted.mount, drafted.X_WC = (body.name, link), X_WL.inverse() @ X_WC
        draft.cameras.append(drafted)


def add_lights(draft: ModelDraft, pxr: Any, prims: list[Any], matrix: Matrix) -> None:
    """Add distant, sphere and dome lights, and record all other lights as dropped."""
    kinds = (pxr.UsdLux.BoundableLightBase, pxr.UsdLux.NonboundableLightBase)
    for prim in (prim for prim in prims if any(prim.IsA(kind) for kind in kinds)):
        type_name, path = prim.GetTypeName(), prim.GetPath()
        if type_name not in LIGHTS:
            draft.dropped(f"light `{path}`", "only distant, sphere and dome lights are supported", type_name)
            continue
        kind, light = LIGHTS[type_name], pxr.UsdLux.LightAPI(prim)
        strength = float(light.GetIntensityAttr().Get()) * 2 ** float(light.GetExposureAttr().Get()) / FULL[kind]
        r, g, b = (min(max(float(v), 0.0), 1.0) for v in light.GetColorAttr().Get())
        X_WP = _pose(matrix(prim))
        x, y, z = X_WP.p.tolist()
        dx, dy, dz = (np.round(X_WP.rotation @ (0, 0, -1), 9) + 0.0).tolist()
        if strength > BRIGHTEST:
            why = (
                "the intensity assumes a camera with exposure and was reduced to 1, which fully lights a white surface"
            )
            draft.changed(f"intensity of light `{path}`", why, f"{strength:.4g}")
            strength = 1.0
        found = LightDraft(prim.GetName(), kind.value, strength, (r, g, b), (dx, dy, dz), (x, y, z))
        if kind is LightType.DOME:
            found.panorama = _panorama(draft, pxr.UsdLux.DomeLight(prim), X_WP)
        draft.lights.append(found)


def _panorama(draft: ModelDraft, dome: Any, X_WP: Pose) -> tuple[str, bytes] | None:
    """Return the name and the content of the image of a dome light, or None if it has none that is supported."""
    asset, what = dome.GetTextureFileAttr().Get(), f"texture of light `{dome.GetPath()}`"
    if not asset or not asset.path:
        return None
    file = Path(asset.resolvedPath)
    if not asset.resolvedPath or not file.is_file():
        draft.dropped(what, "the image could not be found")
        return None
    if dome.GetTextureFormatAttr().Get() not in ("automatic", "latlong"):
        draft.dropped(what, "only equirectangular images are supported")
        return None
    try:
        panorama = read_panorama(file)
    except MeshError as error:
        draft.dropped(what, str(error))
        return None
    if X_WP.angle_to(X_DOME) > UPRIGHT_RAD:
        draft.changed(what, "the center of the image is in the direction of x and its top in that of z")
    return f"{plain_name(file.stem, 'sky')}{panorama.suffix}", panorama.content
