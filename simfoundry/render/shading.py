"""Shading: lights, shadows, textures and color spaces. All arithmetic is in linear light."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from simfoundry.geometry.frames import Array, frozen_array, look_at
from simfoundry.geometry.ray_casts import (
    NEAREST,
    Hits,
    area_normals,
    blend,
    dot,
    first_hits,
    scattered_rays,
    turned,
    unit,
)
from simfoundry.geometry.shapes import Mesh
from simfoundry.render.surface import SceneSurface
from simfoundry.scene.model import LightType, Scene

SHADOW_BIAS = 2e-4  # Minimum distance of an occluder along the light direction [m]; closer hits are the surface itself

DISTANT = 1e4  # Distance of a distant light, in scene radii

FILL = 0.22  # Ambient light in a scene with lights but without a dome; shadows in a real room are never black

LAMP_RADIUS = 0.03  # Half the angular diameter of a distant lamp [rad], for soft shadows

TEXTURES_KEPT = 32  # Number of textures that are kept as pyramids, which take 8 MB each

SKY_SPOTS = 4  # Number of sky samples per subpixel

# Light direction in a scene without lights (unit vector, world).
KEY_DIRECTION = frozen_array(unit(np.array([-0.16, 0.66, 0.82])))

SKY = frozen_array([0.86, 0.93, 1.0])
GROUND = frozen_array([0.42, 0.39, 0.36])
HORIZON = frozen_array([0.80, 0.84, 0.88])
ZENITH = frozen_array([0.38, 0.50, 0.66])
NADIR = frozen_array([0.50, 0.52, 0.55])


@dataclass(frozen=True, eq=False)
class Lamp:
    """A light that casts shadows.

    Attributes:
        p: The position in the world [m], or a unit vector toward the light if it is distant.
        distant: True if the light is infinitely far away.
        rgb: The linear color.
    """

    p: Array
    distant: bool
    rgb: Array


@dataclass(frozen=True, eq=False)
class Studio:
    """The lighting of a scene, which consists of lamps and ambient light.

    The ambient light has one linear color for surfaces that face up and another for surfaces that face down.
    """

    lamps: tuple[Lamp, ...]
    up: Array
    down: Array


def studio(scene: Scene) -> Studio:
    """Return the lights in the scene.

    A scene without lights gets daylight from the upper left, as seen by a robot that looks along x.
    """
    if not scene.lights:
        lamp = Lamp(KEY_DIRECTION, True, np.array([0.86, 0.83, 0.78]))
        return Studio((lamp,), 0.36 * SKY, 0.30 * GROUND)
    lamps, dome = [], np.zeros(3)
    for light in scene.lights:
        rgb = light.intensity * np.asarray(light.rgb)
        match light.type:
            case LightType.DISTANT:
                lamps.append(Lamp(light.X_WL.rotation[:, 2], True, rgb))
            case LightType.POINT:
                lamps.append(Lamp(light.X_WL.p, False, rgb))
            case LightType.DOME:
                dome = dome + rgb
    if not dome.any():
        return Studio(tuple(lamps), FILL * SKY, FILL * GROUND)
    return Studio(tuple(lamps), dome, dome)


@dataclass(frozen=True, eq=False)
class Points:
    """The n visible points to shade.

    Each subpixel uses different samples of the lamps and the sky, so that the mean over subpixels has soft shadows.

    Attributes:
        p: The positions in the world [m], as an array of shape (n, 3).
        normals: The unit normals, as an array of shape (n, 3).
        to_eye: The unit vectors toward the camera, as an array of shape (n, 3).
        group: The index of the subpixel of each point, as an array of shape (n,).
        groups: The number of subpixels in a pixel.
    """

    p: Array
    normals: Array
    to_eye: Array
    group: NDArray[np.int64]
    groups: int


# A function that returns a mask of the points, given by their indices, at which a lamp is blocked.
Shadow = Callable[[Lamp, NDArray[np.int64]], NDArray[np.bool_]]


def shade(
    surface: SceneSurface, lights: Studio, hits: Hits, at: Points, focal_squared: float, shadow: Shadow | None = None
) -> Array:
    """Return the linear color of each of the n hits, as an array of shape (n, 3).

    ``focal_squared`` [px^2] determines the size of a pixel on the surface. By default, the shadow at each point is
    computed exactly.
    """
    albedo = _albedo(surface, hits, np.abs(dot(at.normals, at.to_eye)), focal_squared)
    sky = (0.5 + 0.5 * at.normals[:, 2])[:, None]
    light = lights.down * (1 - sky) + lights.up * sky * _openness(surface, at)[:, None]
    shine = np.zeros_like(light)
    for lamp in lights.lamps:
        to_lamp = lamp.p if lamp.distant else lamp.p - at.p
        direction = np.broadcast_to(unit(to_lamp), at.p.shape)
        cosine = np.maximum(dot(at.normals, direction), 0.0)
        for k in range(at.groups):
            facing = np.flatnonzero((at.group == k) & (cosine > 0))
            spot = _spot(lamp, k, at.groups)
            dark = shadow(spot, facing) if shadow is not None else in_shadow(surface, spot, at.p[facing])
            cosine[facing[dark]] = 0.0
        gloss = 0.10 * np.maximum(dot(at.normals, unit(direction + at.to_eye)), 0.0) ** 48
        light = light + cosine[:, None] * lamp.rgb
        shine = shine + np.where(cosine > 0, gloss, 0.0)[:, None] * lamp.rgb
    return albedo * light + shine


def _spot(lamp: Lamp, k: int, count: int) -> Lamp:
    """Return sample ``k`` of ``count`` on a distant lamp.

    For a point lamp, or if ``count`` is 1, the sample is at the center.
    """
    if count == 1 or not lamp.distant:
        return lamp
    radius, turn = LAMP_RADIUS * np.sqrt((k + 0.5) / count), 2.399963 * k
    side = look_at(np.zeros(3), lamp.p).rotation
    p = lamp.p + radius * (np.cos(turn) * side[:, 0] + np.sin(turn) * side[:, 1])
    return Lamp(unit(p), True, lamp.rgb)


def _openness(surface: SceneSurface, at: Points) -> Array:
    """Return the visible fraction of the sky at each point, in [0, 1], as an array of shape (n,).

    All values are 1 if there is only one group.
    """
    open_sky = np.ones(len(at.p))
    if at.groups == 1:
        return open_sky
    total = at.groups * SKY_SPOTS
    for k in range(at.groups):
        mine = np.flatnonzero(at.group == k)
        p, normals = at.p[mine], at.normals[mine]
        seen, asked = np.zeros(len(mine)), np.full(len(mine), 1e-9)
        for spot in range(k, total, at.groups):
            height, turn = np.sqrt(1 - (spot + 0.5) / total), 2.399963 * spot
            flat = np.sqrt(1 - height**2)
            direction = np.array([flat * np.cos(turn), flat * np.sin(turn), height])
            cosine = np.maximum(dot(normals, direction), 0.0)
            facing = np.flatnonzero(cosine > 0)
            asked[facing] += cosine[facing]
            cosine[facing[in_shadow(surface, Lamp(direction, True, SKY), p[facing])]] = 0.0
            seen[facing] += cosine[facing]
        open_sky[mine] = np.where(asked > 1e-6, seen / asked, 1.0)
    return open_sky


def in_shadow(surface: SceneSurface, lamp: Lamp, points: Array) -> NDArray[np.bool_]:
    """Return a mask of the points at which an opaque surface blocks the lamp, as an array of shape (n,).

    Only the far sides of closed surfaces cast shadows. Other surfaces receive the same shadows as they would from the
    near sides, and the transition to the unlit side of a smooth surface stays soft.
    """
    shadow = np.zeros(len(points), dtype=np.bool_)
    if not len(points) or not len(surface.corners):
        return shadow
    low, high = surface.corners.min(axis=(0, 1)), surface.corners.max(axis=(0, 1))
    center, radius = (low + high) / 2, float(np.linalg.norm(high - low)) / 2 + 1e-9
    origin = center + DISTANT * radius * lamp.p if lamp.distant else lamp.p
    aim = center if float(np.linalg.norm(center - origin)) > 1e-6 else origin - np.array([0.0, 0.0, 1.0])
    R_LW = look_at(origin, aim).rotation.T
    local = turned(R_LW, points - origin)
    reached = np.flatnonzero(local[:, 2] > NEAREST)
    if not len(reached):
        return shadow
    x, y, z = local[reached].T
    far_side = dot(origin - surface.corners[:, 0], area_normals(surface.corners)) < 0
    opaque = np.array([v.rgba[3] >= 1 for v in surface.visuals], dtype=np.bool_)[surface.visual]
    casters = opaque & (far_side | ~surface.closed)
    floor = 1.0 / np.maximum(z - SHADOW_BIAS, NEAREST)
    hits = first_hits(turned(R_LW, surface.corners[casters] - origin), scattered_rays(x / z, y / z), floor)
    shadow[reached] = hits.triangle >= 0
    return shadow


def background(directions: Array) -> Array:
    """Return the linear color of the sky, which is a soft gradient by elevation.

    Args:
        directions: Directions in the world, as an array of shape (n, 3).

    Returns:
        The colors, as an array of shape (n, 3).
    """
    rise = unit(directions)[:, 2:]
    up = np.clip(rise, 0, 1) ** 0.6
    down = np.clip(-rise, 0, 1) ** 0.6
    return np.asarray(HORIZON * (1 - up - down) + ZENITH * up + NADIR * down)


def _albedo(surface: SceneSurface, hits: Hits, facing: Array, focal_squared: float) -> Array:
    """Return the linear base color of each hit, which is the visual's rgba times its texture.

    Returns:
        The colors, as an array of shape (n, 3).
    """
    visual = surface.visual[hits.triangle]
    rgb = np.array([v.rgba[:3] for v in surface.visuals], dtype=np.float64)
    color = decode_srgb(np.clip(rgb, 0, 1))[visual]
    for k, item in enumerate(surface.visuals):
        if isinstance(item.geometry, Mesh) and item.geometry.texture is not None and item.geometry.uv is not None:
            mine = np.flatnonzero(visual == k)
            if len(mine):
                texture = item.geometry.texture
                color[mine] *= _textured(surface, texture, hits.at(mine), facing[mine], focal_squared)
    return color


def _textured(surface: SceneSurface, texture: bytes, hits: Hits, facing: Array, focal_squared: float) -> Array:
    """Return the texture color of each hit, as an array of shape (n, 3).

    The mipmap level is the one whose texels match the pixel size.
    """
    levels = texture_levels(texture)
    density = np.zeros(len(surface.corners))  # of texels [1/m²], where it is needed
    met = np.flatnonzero(np.bincount(hits.triangle, minlength=len(density)))
    density[met] = texel_density(levels, surface.uv[met], surface.corners[met])
    footprint = 1.0 / (hits.inverse_depth**2 * focal_squared * np.maximum(facing, 0.1))
    at = blend(surface.uv[hits.triangle], hits.weights)
    return texture_color(levels, at, density[hits.triangle] * footprint)


def texel_density(levels: Sequence[Array], uv: Array, corners: Array) -> Array:
    """Return the number of texels per area of triangles [1/m²], shape (n,).

    Args:
        levels: The texture, from :func:`texture_pyramid`. The texels are those of the first level.
        uv: Texture coordinates of the corners of each triangle, shape (n, 3, 2).
        corners: The corners [m], shape (n, 3, 3).
    """
    height, width = levels[0].shape[:2]
    (du1, dv1), (du2, dv2) = (uv[:, 1] - uv[:, 0]).T, (uv[:, 2] - uv[:, 0]).T
    normals = area_normals(corners)
    area = np.sqrt(dot(normals, normals))
    return np.asarray(np.abs(du1 * dv2 - dv1 * du2) * width * height / np.maximum(area, 1e-30))


def texture_color(levels: Sequence[Array], at: Array, texels: Array) -> Array:
    """Return the mean colors of a texture around some places, in linear light.

    The mipmap level is the one of which one texel covers the area over which the color is averaged.

    Args:
        levels: The texture, from :func:`texture_pyramid`.
        at: Texture coordinates, shape (n, 2).
        texels: Number of texels of the first level over which each color is averaged, shape (n,).

    Returns:
        The colors, as an array of shape (n, 3).
    """
    level = np.clip(np.floor(0.5 * np.log2(np.maximum(texels, 1e-30)) + 0.5), 0, len(levels) - 1).astype(np.int64)
    color = np.zeros((len(at), 3))
    for k in np.unique(level):
        color[level == k] = _bilinear(levels[k], at[level == k])
    return color


def _bilinear(image: Array, uv: Array) -> Array:
    """Sample a repeating image of shape (h, w, 3) at texture coordinates.

    The coordinates ``uv`` have shape (n, 2), and v points up.
    """
    h, w = image.shape[:2]
    x, y = uv[:, 0] * w - 0.5, (1 - uv[:, 1]) * h - 0.5
    left, top = np.floor(x), np.floor(y)
    fx, fy = (x - left)[:, None], (y - top)[:, None]
    u0, v0 = left.astype(np.int64) % w, top.astype(np.int64) % h
    u1, v1 = (u0 + 1) % w, (v0 + 1) % h
    upper = image[v0, u0] * (1 - fx) + image[v0, u1] * fx
    lower = image[v1, u0] * (1 - fx) + image[v1, u1] * fx
    return np.asarray(upper * (1 - fy) + lower * fy)


@lru_cache(maxsize=TEXTURES_KEPT)
def texture_levels(png: bytes) -> tuple[Array, ...]:
    """Return a texture as :func:`texture_pyramid` does, and keep it."""
    return texture_pyramid(png)


def texture_pyramid(png: bytes, largest: int | None = None) -> tuple[Array, ...]:
    """Return a texture in linear light as a mipmap pyramid. Each level has half the size of the previous one.

    If ``largest`` is given, the first level has at most this width and height [px].
    """
    from PIL import Image

    with Image.open(io.BytesIO(png)) as picture:
        pixels = picture.convert("RGB")
    if largest is not None and max(pixels.size) > largest:
        pixels = pixels.reduce(-(-max(pixels.size) // largest))
    image = decode_srgb(np.arange(256) / 255)[np.asarray(pixels)]  # 256 powers, not one a texel
    levels = [image]
    while min(image.shape[:2]) >= 4:
        even = image[: image.shape[0] // 2 * 2, : image.shape[1] // 2 * 2]
        upper, lower = even[::2], even[1::2]
        image = (upper[:, ::2] + upper[:, 1::2] + lower[:, ::2] + lower[:, 1::2]) / 4
        levels.append(image)
    return tuple(levels)


def decode_srgb(values: Array) -> Array:
    """Convert sRGB in [0, 1] to linear light."""
    return np.where(values <= 0.04045, values / 12.92, ((values + 0.055) / 1.055) ** 2.4)


def encode_srgb(linear: Array) -> NDArray[np.uint8]:
    """Convert linear light to sRGB bytes. Values brighter than white are clipped."""
    c = np.clip(linear, 0, 1)
    encoded = np.where(c <= 0.0031308, 12.92 * c, 1.055 * c ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255 * encoded), dtype=np.uint8)
