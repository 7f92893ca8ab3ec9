"""The displayed scene as data: a tree of named nodes, each with a pose and content that can be compared."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from weakref import WeakKeyDictionary

import numpy as np

from simfoundry.geometry.frames import IDENTITY, Array, Pose
from simfoundry.geometry.shapes import Geometry, Mesh
from simfoundry.scene.kinematics import axis_frame, link_poses
from simfoundry.scene.model import Camera, Link, Scene, SceneObject
from simfoundry.scene.state import SceneState, object_at
from simfoundry.studio.view.contents import (
    FrameContent,
    FrustumContent,
    LabelContent,
    LinesContent,
    NodeContent,
    SplatContent,
    SurfaceContent,
)

# Colors (sRGB in [0, 1]) of colliders and of convex parts: clearly no material of a scene.
COLLIDER_RGBA = (0.1, 0.75, 0.35, 0.35)

# Color (sRGB, 0 to 255) of lines that stand for joints, cameras, regions and the selection.
JOINT_RGB, CAMERA_RGB, REGION_RGB, SELECTION_RGB = (230, 60, 200), (60, 60, 60), (40, 120, 230), (255, 150, 0)

# Length [m] of the pictured camera frusta and of joint axes; the size of a hand, which is visible beside small objects.
FRUSTUM_M, AXIS_M = 0.08, 0.12


@dataclass(frozen=True, eq=False)
class ViewNode:
    """A node of the tree that is shown.

    Attributes:
        content: What is shown. A node with other content is sent again.
        X_PN: Pose in the parent node.
        selects: The name of what a click selects, such as ``objects.mug``, or empty.
        is_visible: Whether it is shown, together with all nodes below it.
    """

    content: NodeContent
    X_PN: Pose = IDENTITY
    selects: str = ""
    is_visible: bool = True


@dataclass(frozen=True)
class DisplayOptions:
    """Parts of a scene that are shown besides its objects.

    Without ``lights``, or if a scene has none, it is lit evenly. Shadows take half of the time of a browser that draws
    without a graphics card, or more, so they are not shown by default.
    """

    visuals: bool = True
    colliders: bool = False
    frames: bool = False
    joints: bool = False
    cameras: bool = True
    names: bool = False
    lights: bool = True
    shadows: bool = False
    pictures: Mapping[str, bytes] = field(default_factory=dict)


Nodes = dict[str, ViewNode]


def scene_nodes(scene: Scene, options: DisplayOptions, state: SceneState | None = None) -> Nodes:
    """Return the nodes of a scene's objects, cameras and background, in a state that defaults to the initial one."""
    nodes: Nodes = {}
    for item in scene.objects:
        nodes |= object_nodes(item if state is None else object_at(item, state), options)
    if options.cameras:
        nodes |= dict(camera_nodes(scene, options.pictures))
    return nodes | background_nodes(scene)


def background_nodes(scene: Scene) -> Nodes:
    """Return the node of a scene's background, if it has one."""
    background = scene.background
    if background is not None and background.visuals:
        pieces = tuple((v.geometry, v.X_LG, tuple(v.rgba.tolist())) for v in background.visuals)
        return {"/background": ViewNode(SurfaceContent(_digest(pieces), pieces), background.X_WB)}
    if background is not None and background.splat is not None:
        return {"/background": ViewNode(SplatContent(background.splat), background.X_WB)}
    return {}


def object_nodes(item: SceneObject, options: DisplayOptions, group: str = "objects") -> Nodes:
    """Return the nodes of an object: its frame, and below it one node for the surfaces of each link."""
    base, selects = f"/{group}/{item.name}", f"{group}.{item.name}"
    nodes: Nodes = {base: ViewNode(FrameContent(0.1 if options.frames else 0.0), item.X_WO, selects)}
    X_OL = link_poses(item)
    for link in item.links:
        if options.visuals and (content := link_surface(link)) is not None:
            nodes[f"{base}/{link.name}"] = ViewNode(content, X_OL[link.name], selects)
        if options.colliders and (content := link_surface(link, colliders=True)) is not None:
            nodes[f"{base}/{link.name}_colliders"] = ViewNode(content, X_OL[link.name], selects)
    if options.joints:
        for joint in item.joints:
            if joint.has_axis:
                line = ((0.0, 0.0, 0.0), _point(joint.axis * AXIS_M))
                pose = axis_frame(item, joint, X_OL)
                nodes[f"{base}/{joint.name}_axis"] = ViewNode(LinesContent((line,), JOINT_RGB, 4.0), pose, selects)
    if options.names:
        nodes[f"{base}/name"] = ViewNode(LabelContent(item.name))
    return nodes


_visual_surfaces: WeakKeyDictionary[Link, SurfaceContent | None] = WeakKeyDictionary()
_collider_surfaces: WeakKeyDictionary[Link, SurfaceContent | None] = WeakKeyDictionary()


def link_surface(link: Link, colliders: bool = False) -> SurfaceContent | None:
    """Return the visible surfaces of a link, or its colliders, or None if it has none."""
    kept = _collider_surfaces if colliders else _visual_surfaces
    if link not in kept:
        pieces: Sequence[tuple[Geometry, Pose, tuple[float, ...]]]
        if colliders:
            pieces = [(c.geometry, c.X_LG, COLLIDER_RGBA) for c in link.colliders]
        else:
            pieces = [(v.geometry, v.X_LG, tuple(v.rgba.tolist())) for v in link.visuals if v.rgba[3] > 0]
        kept[link] = SurfaceContent(_digest(pieces), tuple(pieces)) if pieces else None
    return kept[link]


def _digest(pieces: Sequence[tuple[Geometry, Pose, tuple[float, ...]]]) -> str:
    """Return a hash of the content of surfaces, so that equal ones are sent once."""
    total = hashlib.sha256()
    for geometry, X_LG, rgba in pieces:
        sizes = (
            [geometry.digest]
            if isinstance(geometry, Mesh)
            else [np.asarray(v).tolist() for v in vars(geometry).values()]
        )
        total.update(repr((type(geometry).__name__, sizes, X_LG.p.tolist(), X_LG.q.tolist(), rgba)).encode())
    return total.hexdigest()


def camera_nodes(scene: Scene, pictures: Mapping[str, bytes]) -> Iterator[tuple[str, ViewNode]]:
    """Yield the frusta of all cameras that are fixed in the world or mounted on an object."""
    for camera in posed_cameras(scene):
        fov = 2 * math.atan2(camera.height / 2, camera.fy)
        content = FrustumContent(fov, camera.width / camera.height, pictures.get(camera.name, b""))
        yield f"/cameras/{camera.name}", ViewNode(content, camera.X_WC, f"cameras.{camera.name}")


def posed_cameras(scene: Scene) -> Iterator[Camera]:
    """Yield the cameras with their poses in the world, except those that are mounted on a robot."""
    from dataclasses import replace

    yield from scene.cameras
    for mounted in scene.mounted:
        item = scene.by_name.get(mounted.carrier)
        if item is not None:
            X_WL = item.X_WO @ link_poses(item)[mounted.link or item.root.name]
            yield replace(mounted.camera, X_WC=X_WL @ mounted.camera.X_WC)


def box_lines(low: Array, high: Array, rgb: tuple[int, int, int], thickness: float = 2.0) -> LinesContent:
    """Return the twelve edges of a box with the corners ``low`` and ``high`` [m]."""
    corners = np.array([[x, y, z] for x in (low[0], high[0]) for y in (low[1], high[1]) for z in (low[2], high[2])])
    pairs = [(a, b) for a in range(8) for b in range(a + 1, 8) if bin(a ^ b).count("1") == 1]
    return LinesContent(tuple((_point(corners[a]), _point(corners[b])) for a, b in pairs), rgb, thickness)


def _point(p: Array) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in p)
    return x, y, z
