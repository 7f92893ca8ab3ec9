"""Ray-cast images of a scene (color, exact depth, object labels and normals) without a display, GL driver or GPU.

These images are used for synthetic captures, for documentation, and on machines where no simulator can render. Colors
are shaded in linear light (Lambertian, faint highlights, hemispherical ambient light, shadows) and returned as sRGB.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import cache, partial

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array
from simfoundry.geometry.ray_casts import Hits, Rays, area_normals, blend, dot, first_hits, pixel_rays, turned, unit
from simfoundry.geometry.shapes import Mesh
from simfoundry.render.backdrop import rounded, splat_backdrop
from simfoundry.render.shading import (
    TEXTURES_KEPT,
    Lamp,
    Points,
    background,
    decode_srgb,
    encode_srgb,
    in_shadow,
    shade,
    studio,
    texture_levels,
)
from simfoundry.render.surface import FEW_SEGMENTS, SceneSurface, scene_surface
from simfoundry.runtime.parallel import usable_cores
from simfoundry.scene.model import Camera, Scene
from simfoundry.scene.state import SceneState

BAND = 1_300_000  # Maximum number of rays shaded at once, in all threads together; this requires about 1 GB of memory

# Number of pixels that a thread shades at once, so that they fit into the cache of its core, and least number of pixels
# for each triangle, because all are projected each time. Of 15 to 240 rows of 640 pixels, 60 take the least time.
CACHED_BAND, PIXELS_PER_TRIANGLE = 40_000, 4

# Maximum number of threads: each one needs all triangles, and more than four are hardly faster.
MAX_THREADS = 4

# Maximum number of triangles of a background mesh: all that a mesh file may have.
MAX_BACKGROUND = 2_000_000

# Maximum number of triangles of a background mesh in a quick image, for which an editor waits; the ray caster needs
# about a second for a million triangles.
QUICK_BACKGROUND = 50_000


@dataclass(frozen=True, eq=False)
class Raycast:
    """An image with per-pixel geometry.

    Attributes:
        color: The sRGB color, as a uint8 array of shape (h, w, 3).
        depth: The depth [m] along the optical axis at the pixel center, or NaN if no surface is hit, as an array of
            shape (h, w).
        objects: The index in ``scene.objects`` plus 1, or 0 if no object is hit, as an int32 array of shape (h, w).
        normals: The unit normal in the world, pointing toward the camera, or NaN if no surface is hit, as an array of
            shape (h, w, 3).
        camera: The camera from which the image was rendered.
    """

    color: NDArray[np.uint8]
    depth: Array
    objects: NDArray[np.int32]
    normals: Array
    camera: Camera


def raycast(scene: Scene, camera: Camera, state: SceneState | None = None, samples: int = 1) -> Raycast:
    """Render ``scene`` as seen by ``camera``.

    Pixel (u, v) looks along ``((u - cx) / fx, (v - cy) / fy, 1)`` in the camera frame, so the center of the first pixel
    is (0, 0), as in :attr:`simfoundry.capture.frame.Frame.points`. Depth, objects and normals are evaluated at the
    pixel center. A visual with alpha 0 is not rendered. A visual with alpha below 1 appears in all four arrays, but it
    transmits the color behind it and casts no shadow.

    The background is included: a mesh like the objects, and a splat by compositing. Where a splat blocks half of the
    light, the depth is its own, and there is no object and no normal.

    Args:
        scene: The scene to render.
        camera: The camera.
        state: The state of the scene; defaults to the state described by the scene.
        samples: The number of rays along each side of a pixel, whose color is the mean over all rays. With a value of
            1, shadows are hard and there is no ambient occlusion. Larger values darken corners and soften shadows.
    """
    if samples < 1:
        raise ValueError(f"samples must be at least 1, not {samples}")
    surface = scene_surface(scene, state, most_background=MAX_BACKGROUND)
    h, w, threads = camera.height, camera.width, min(usable_cores(), MAX_THREADS)
    sky = _splat_sky(scene, camera, _pixels(camera, 1))
    band = min(BAND // (threads * samples**2), max(CACHED_BAND, PIXELS_PER_TRIANGLE * len(surface.corners)))
    rows = max(1, min(-(-h // threads), band // w))
    bands = [range(top, min(top + rows, h)) for top in range(0, h, rows)]
    meshes = [visual.geometry for visual in surface.visuals if isinstance(visual.geometry, Mesh)]
    textures = list(dict.fromkeys(mesh.texture for mesh in meshes if mesh.texture is not None))
    with ThreadPoolExecutor(threads) as pool:  # NumPy releases the lock of the interpreter for long arrays
        list(pool.map(texture_levels, textures[:TEXTURES_KEPT]))  # else, each band would prepare them
        parts = list(pool.map(partial(_band, scene, surface, camera, sky, samples), bands))
    color, depth, objects, normals = (np.concatenate(each) for each in zip(*parts, strict=True))
    seen = Raycast(color, depth.reshape(h, w), objects.reshape(h, w), normals.reshape(h, w, 3), camera)
    return seen if sky is None else _behind_splat(scene, seen)


def _splat_sky(scene: Scene, camera: Camera, rays: Rays) -> Array | None:
    """Return the linear color that each pixel has without objects if there is a splat, shape (h, w, 3)."""
    backdrop = splat_backdrop(scene, camera)
    if backdrop is None:
        return None
    clear = encode_srgb(background(_directions(rays, camera))).reshape(camera.height, camera.width, 3) / 255.0
    whole = backdrop.image
    return decode_srgb(np.clip(whole.color + (1.0 - whole.alpha[..., None]) * clear, 0.0, 1.0))


def _behind_splat(scene: Scene, seen: Raycast) -> Raycast:
    """Composite the part of the splat that is in front of surfaces."""
    color, nearer = _cut_splat(scene, seen.camera, seen.color, np.where(np.isnan(seen.depth), np.inf, seen.depth))
    hidden = nearer > 0
    return Raycast(
        color=color,
        depth=np.where(hidden, nearer, seen.depth),
        objects=np.where(hidden, 0, seen.objects).astype(np.int32),
        normals=np.where(hidden[..., None], np.nan, seen.normals),
        camera=seen.camera,
    )


def _cut_splat(scene: Scene, camera: Camera, color: NDArray[np.uint8], depth: Array) -> tuple[NDArray[np.uint8], Array]:
    """Composite the part of a splat that is in front of surfaces, whose image already has the splat behind them.

    Returns:
        The image, and the depth [m] at which the splat blocks half of the light before a surface, or 0.
    """
    backdrop = splat_backdrop(scene, camera)
    assert backdrop is not None
    front = backdrop.in_front(depth)
    mixed = rounded(front.color + (1.0 - front.alpha[..., None]) * (color / 255.0))
    return np.where(np.isfinite(depth)[..., None], mixed, color), front.depth


def _band(
    scene: Scene, surface: SceneSurface, camera: Camera, sky: Array | None, samples: int, rows: range
) -> tuple[NDArray[np.uint8], Array, NDArray[np.int32], Array]:
    """Return the colors of some rows of the image, shape (rows, w, 3), and what is at the n centers of their pixels.

    Returns:
        The colors, the depth [m], shape (n,), the numbers of the objects, shape (n,), and the normals, shape (n, 3).
    """
    rays = _pixels(camera, 1, rows)
    hits = _seen(surface, camera, rays)
    depth, objects = np.full(len(rays.x), np.nan), np.zeros(len(rays.x), dtype=np.int32)
    normals = np.full((len(rays.x), 3), np.nan)
    met = np.flatnonzero(hits.triangle >= 0)
    depth[met] = 1.0 / hits.inverse_depth[met]
    objects[met] = surface.object[hits.triangle[met]] + 1
    normals[met] = _normals(surface, hits.at(met), _directions(rays, camera)[met])
    if samples > 1:
        rays = _pixels(camera, samples, rows)
        hits = _seen(surface, camera, rays)
    if sky is not None:
        sky = sky[rows.start : rows.stop].repeat(samples, axis=0).repeat(samples, axis=1).reshape(-1, 3)
    linear = _colors(scene, surface, camera, rays, hits, sky, samples)
    whole = linear.reshape(len(rows), samples, camera.width, samples, 3).mean(axis=(1, 3))
    return encode_srgb(whole), depth, objects, normals


def _pixels(camera: Camera, samples: int, rows: range | None = None) -> Rays:
    """Return the rays of some rows of an image, or of all."""
    rows = range(camera.height) if rows is None else rows
    return pixel_rays(camera.width, rows, camera.fx, camera.fy, camera.cx, camera.cy, samples)


def _seen(surface: SceneSurface, camera: Camera, rays: Rays, opaque_only: bool = False) -> Hits:
    """Return the first hit of each ray.

    Back faces of closed surfaces are skipped because their insides are never visible.
    """
    alpha = np.array([v.rgba[3] for v in surface.visuals], dtype=np.float64)
    faces_camera = dot(camera.X_WC.p - surface.corners[:, 0], area_normals(surface.corners)) > 0
    kept = faces_camera | ~surface.closed
    if opaque_only:
        kept &= alpha[surface.visual] >= 1
    index = np.flatnonzero(kept)
    hits = first_hits(turned(camera.X_WC.rotation.T, surface.corners[index] - camera.X_WC.p), rays)
    triangle = np.where(hits.triangle >= 0, index[hits.triangle] if len(index) else -1, -1)
    return Hits(triangle, hits.inverse_depth, hits.weights)


def _directions(rays: Rays, camera: Camera) -> Array:
    """Return ray directions in the world, as an array of shape (n, 3).

    Each direction has unit length along the optical axis.
    """
    return turned(camera.X_WC.rotation, np.stack([rays.x, rays.y, np.ones_like(rays.x)], axis=1))


def _normals(surface: SceneSurface, hits: Hits, directions: Array) -> Array:
    """Return unit shading normals toward the camera, as an array of shape (n, 3).

    Each of the rays along ``directions``, which has shape (n, 3), must hit a surface.
    """
    normals = unit(blend(surface.normals[hits.triangle], hits.weights))
    away = dot(area_normals(surface.corners)[hits.triangle], directions) > 0  # the back of an open surface
    return np.asarray(np.where(away[:, None], -normals, normals))


def _colors(
    scene: Scene, surface: SceneSurface, camera: Camera, rays: Rays, hits: Hits, sky: Array | None, samples: int
) -> Array:
    """Return the linear color of each ray, as an array of shape (n, 3).

    The color of a translucent surface is blended with the color of the opaque surface behind it. ``sky`` is the color
    of rays that hit nothing, which is a gradient by default.
    """
    directions = _directions(rays, camera)
    met, missed = np.flatnonzero(hits.triangle >= 0), np.flatnonzero(hits.triangle < 0)
    if sky is None:
        color = np.zeros_like(directions)
        color[missed] = background(directions[missed])
    else:
        color = sky.copy()
    if not len(met):
        return color
    some, along = hits.at(met), directions[met]
    row, column = np.divmod(met, camera.width * samples)
    at = Points(
        p=camera.X_WC.p + along / some.inverse_depth[:, None],
        normals=_normals(surface, some, along),
        to_eye=-unit(along),
        group=row % samples * samples + column % samples,
        groups=samples * samples,
    )
    front = shade(surface, studio(scene), some, at, camera.fx * camera.fy)
    alpha = np.array([min(1.0, v.rgba[3]) for v in surface.visuals])[surface.visual[some.triangle]]
    if (alpha < 1).any():
        opaque = _seen(surface, camera, rays, opaque_only=True)
        behind = _colors(scene, surface, camera, rays, opaque, sky, samples)
        front = front * alpha[:, None] + behind[met] * (1 - alpha[:, None])
    color[met] = front
    return color


def quick_image(
    scene: Scene, camera: Camera, state: SceneState | None = None, checkpoint: Callable[[], None] = lambda: None
) -> NDArray[np.uint8]:
    """Render an image for an editor in about a quarter of the time that :func:`raycast` takes.

    Round shapes have fewer segments, shadows are computed for one pixel of four, and translucent surfaces are opaque.
    ``checkpoint`` is called before each step. It can raise an exception to stop.

    Returns:
        The sRGB color, as a uint8 array of shape (h, w, 3).
    """
    checkpoint()
    surface = scene_surface(scene, state, FEW_SEGMENTS, QUICK_BACKGROUND)
    checkpoint()
    rays = _pixels(camera, 1)
    hits = _seen(surface, camera, rays)
    checkpoint()
    directions = _directions(rays, camera)
    met = np.flatnonzero(hits.triangle >= 0)
    missed = np.flatnonzero(hits.triangle < 0)
    linear = np.zeros((camera.height * camera.width, 3))
    sky = _splat_sky(scene, camera, rays)
    checkpoint()
    linear[missed] = background(directions[missed]) if sky is None else sky.reshape(-1, 3)[missed]
    if len(met):
        some, along = hits.at(met), directions[met]
        at = Points(
            p=camera.X_WC.p + along / some.inverse_depth[:, None],
            normals=_normals(surface, some, along),
            to_eye=-unit(along),
            group=np.zeros(len(met), dtype=np.int64),
            groups=1,
        )
        row, column = np.divmod(met, camera.width)
        block = row // 2 * camera.width + column // 2

        def shadow(lamp: Lamp, points: NDArray[np.int64]) -> NDArray[np.bool_]:
            """Return the shadow at the first of the points in each block of four pixels."""
            checkpoint()
            first = np.full(len(linear), -1, dtype=np.int64)
            first[block[points[::-1]]] = points[::-1]
            tested = first[first >= 0]
            dark = np.zeros(len(linear), dtype=np.bool_)
            dark[block[tested]] = in_shadow(surface, lamp, at.p[tested])
            return np.asarray(dark[block[points]])

        checkpoint()
        linear[met] = shade(surface, studio(scene), some, at, camera.fx * camera.fy, shadow)
    checkpoint()
    linear *= _STEPS
    image = _srgb_table()[np.minimum(linear, _STEPS, out=linear).astype(np.int32)]
    image = image.reshape(camera.height, camera.width, 3)
    labels = np.where(hits.triangle >= 0, surface.visual[hits.triangle] + 1 if len(surface.visual) else 0, 0)
    smooth = _smoothed(image, labels.reshape(camera.height, camera.width))
    if sky is None:
        return smooth
    depth = np.full(len(linear), np.inf)
    depth[met] = 1.0 / hits.inverse_depth[met]
    return _cut_splat(scene, camera, smooth, depth.reshape(camera.height, camera.width))[0]


# Number of steps of linear light in a table of sRGB bytes; in the dark, where bytes differ by 3e-4, several steps share
# a byte.
_STEPS = 2**14 - 1


@cache
def _srgb_table() -> NDArray[np.uint8]:
    return encode_srgb(np.arange(_STEPS + 1) / _STEPS)


def _smoothed(image: NDArray[np.uint8], labels: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Blend the pixels at the borders between visuals with their neighbors, so that outlines are not jagged."""
    if min(labels.shape) < 3:
        return image
    edge = np.zeros((labels.shape[0] - 2, labels.shape[1] - 2), dtype=np.bool_)
    around = ((0, 1), (2, 1), (1, 0), (1, 2))  # the first row and column of the neighbors of all inner pixels
    for top, left in around:
        neighbors = labels[top : top + edge.shape[0], left : left + edge.shape[1]]
        edge |= neighbors != labels[1:-1, 1:-1]
    row, column = np.nonzero(edge)
    blend = 4 * image[row + 1, column + 1].astype(np.uint16)
    for top, left in around:
        blend += image[row + top, column + left]
    smooth = image.copy()
    smooth[row + 1, column + 1] = blend >> 3
    return smooth
