"""Lights of a scene as nodes: what lights it in the browser, where its lights are, and the panorama around it."""

from __future__ import annotations

import io
import math
from weakref import WeakKeyDictionary

import numpy as np

from simfoundry.geometry.frames import Array, Pose
from simfoundry.geometry.shapes import Mesh, closed_mesh
from simfoundry.render.shading import FILL, GROUND, KEY_DIRECTION, SKY, encode_srgb
from simfoundry.scene.model import Light, LightType, Scene
from simfoundry.studio.view.contents import LightContent, LinesContent, SurfaceContent
from simfoundry.studio.view.nodes import Nodes, ViewNode

# Number of lights that light the view: each one takes time for each pixel, and browsers refuse a few dozen.
MAX_LIGHTS = 8

# Share of the light of a dome that comes from one direction if a scene has no lamps: in an even light, the edges of
# objects cannot be seen.
KEY_SHARE = 0.5

# Distance [m] of what is infinitely far away: distant lights, from the origin, and the panorama, which is farther away
# than the corners of any room.
DISTANT_M, PANORAMA_M = 100.0, 60.0

# Distance [m] from the origin at which a distant light is drawn, and the length [m] of what is drawn: beside a table.
DRAWN_AT_M, DRAWN_M = 1.2, 0.15

# Color (sRGB, 0 to 255) of the lines that stand for lights.
LIGHT_RGB = (240, 180, 0)

# Width [px] of the panorama that is sent, which is as sharp as the screen at a usual field of view.
PANORAMA_PX = 2048

# Segments of the sphere that shows the panorama, around z; straight edges of a room bend by less than a pixel.
PANORAMA_SEGMENTS = 64


def light_nodes(scene: Scene, casts_shadows: bool = False) -> Nodes:
    """Return what lights a scene: its own lights, up to :data:`MAX_LIGHTS`, or nothing if it has none.

    A scene without a dome gets the ambient light that pictures of it have, too. In a scene without lamps, some of the
    light of the dome comes from one direction, which leaves surfaces that face up as bright as they are.
    """
    if not scene.lights:
        return {}
    nodes: Nodes = {}
    lamps = [light for light in scene.lights if light.type is not LightType.DOME][:MAX_LIGHTS]
    shadow = next((light for light in lamps if light.type is LightType.DISTANT), None) if casts_shadows else None
    for light in lamps:
        rgb = light.intensity * light.rgb
        content = LightContent(light.type, _triple(rgb), casts_shadows=light is shadow)
        nodes[f"/lights/{light.name}"] = ViewNode(content, _lamp_pose(light))
    domes = [light for light in scene.lights if light.type is LightType.DOME]
    up, down = FILL * SKY, FILL * GROUND
    if domes:
        up, down = sum((dome_radiance(light) for light in domes), np.zeros((2, 3)))
    if not lamps:
        key = LightContent(LightType.DISTANT, _triple(KEY_SHARE * up / KEY_DIRECTION[2]), casts_shadows=casts_shadows)
        nodes["/lights/key"] = ViewNode(key, Pose.of(KEY_DIRECTION * DISTANT_M))
        up, down = (1 - KEY_SHARE) * up, (1 - KEY_SHARE) * down
    # The browser takes the direction of the position as that of the sky.
    nodes["/lights/sky"] = ViewNode(LightContent(LightType.DOME, _triple(up), _triple(down)), Pose.of((0, 0, 1)))
    return nodes


def lamp_glyphs(scene: Scene) -> Nodes:
    """Return lines that show where the lights of a scene are, and where distant ones shine."""
    nodes: Nodes = {}
    for light in scene.lights[:MAX_LIGHTS]:
        name, size = f"/light_lines/{light.name}", DRAWN_M / 2
        if light.type is LightType.POINT:
            axes = ((size, 0.0, 0.0), (0.0, size, 0.0), (0.0, 0.0, size))
            star = tuple(((-x, -y, -z), (x, y, z)) for x, y, z in axes)
            nodes[name] = ViewNode(LinesContent(star, LIGHT_RGB, 3.0), Pose.of(light.X_WL.p))
        elif light.type is LightType.DISTANT:
            corners = ((0.0, 0.0), (size, 0.0), (-size, 0.0), (0.0, size), (0.0, -size))
            rays = tuple(((x, y, size), (x, y, -size)) for x, y in corners)
            pose = Pose.of(light.X_WL.rotation[:, 2] * DRAWN_AT_M, light.X_WL.q)
            nodes[name] = ViewNode(LinesContent(rays, LIGHT_RGB, 3.0), pose)
    return nodes


def panorama_nodes(scene: Scene) -> Nodes:
    """Return the sphere around a scene that shows the panorama of its first dome light that can be shown."""
    for light in scene.lights:
        if light.type is LightType.DOME and light.panorama is not None and (content := _panorama(light)) is not None:
            return {"/panorama": ViewNode(content, Pose.of(q=light.X_WL.q))}
    return {}


def dome_radiance(light: Light) -> Array:
    """Return the mean radiance from above and from below of a dome light (linear, shape (2, 3)).

    It is the radiance of an even sky that lights a matt surface facing up, or down, as much as the panorama does.
    """
    if light not in _radiances:
        pixels = light.panorama.pixels() if light.panorama is not None else None
        mean = np.ones((2, 3))
        if pixels is not None and len(pixels) >= 2:
            rows = pixels.mean(axis=1, dtype=np.float64)
            elevation = math.pi / 2 - (np.arange(len(rows)) + 0.5) / len(rows) * math.pi
            weight = np.abs(np.sin(elevation) * np.cos(elevation))
            mean = np.array(
                [np.average(rows[half], axis=0, weights=weight[half]) for half in (elevation > 0, elevation < 0)]
            )
            if light.X_WL.rotation[2, 2] < 0:  # the panorama is upside down
                mean = mean[::-1]
        _radiances[light] = mean
    return np.asarray(light.intensity * light.rgb * _radiances[light])


_radiances: WeakKeyDictionary[Light, Array] = WeakKeyDictionary()
_panoramas: WeakKeyDictionary[Light, SurfaceContent | None] = WeakKeyDictionary()


def _lamp_pose(light: Light) -> Pose:
    """Return where the browser has to put a light: distant ones shine from their position to the origin."""
    return Pose.of(light.X_WL.rotation[:, 2] * DISTANT_M if light.type is LightType.DISTANT else light.X_WL.p)


def _panorama(light: Light) -> SurfaceContent | None:
    """Return a sphere with the panorama inside, in which radiances above 1 are clipped."""
    if light not in _panoramas:
        from PIL import Image

        pixels = light.panorama.pixels() if light.panorama is not None else None
        if pixels is None:
            _panoramas[light] = None
            return None
        step = max(1, pixels.shape[1] // PANORAMA_PX)
        out = io.BytesIO()
        Image.fromarray(encode_srgb(pixels[::step, ::step] * light.intensity * light.rgb)).save(out, format="PNG")
        mesh = _sphere(out.getvalue())
        _panoramas[light] = SurfaceContent(mesh.digest, ((mesh, Pose.of(), (1.0, 1.0, 1.0, 1.0)),), is_lit=False)
    return _panoramas[light]


def _sphere(texture: bytes) -> Mesh:
    """Return a sphere that is seen from inside, with the center of the texture in the direction of x."""
    columns, rows = PANORAMA_SEGMENTS, PANORAMA_SEGMENTS // 2
    u, v = np.meshgrid(np.linspace(0, 1, columns + 1), np.linspace(0, 1, rows + 1))
    azimuth, elevation = (0.5 - u) * 2 * math.pi, (v - 0.5) * math.pi
    x, y = np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth)
    vertices = PANORAMA_M * np.stack([x, y, np.sin(elevation)], axis=-1).reshape(-1, 3)
    corner = np.arange(rows)[:, None] * (columns + 1) + np.arange(columns)
    a, b, c, d = (corner + offset for offset in (0, 1, columns + 2, columns + 1))
    faces = np.stack([np.stack([a, b, c], axis=-1), np.stack([a, c, d], axis=-1)], axis=-2).reshape(-1, 3)
    return closed_mesh(vertices, faces, np.stack([u, v], axis=-1).reshape(-1, 2), texture)


def _triple(rgb: Array) -> tuple[float, float, float]:
    r, g, b = (float(v) for v in rgb)
    return r, g, b
