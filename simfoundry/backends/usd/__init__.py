"""The USD backend, which uses UsdPhysics, UsdPreviewSurface, UsdLux and UsdSemantics.

This module lays out the stage.
"""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from simfoundry.backends.artifact import Artifact, Backend, rounded
from simfoundry.backends.convex_hulls import REPLACED, hull_losses, with_hulls
from simfoundry.backends.light_links import light_link_losses, with_light_links
from simfoundry.backends.names import check_names
from simfoundry.backends.usd.bodies import Scopes, define_object, filter_pairs
from simfoundry.backends.usd.features import FEATURES, usd_losses
from simfoundry.backends.usd.prims import Prim, usda, vec3
from simfoundry.backends.usd.robots import RobotsInUsd, define_mounted, define_robots
from simfoundry.backends.usd.shapes import MESHES, mesh_layer, texture_of, texture_path
from simfoundry.backends.usd.source import KEY, write_source
from simfoundry.backends.usd.surroundings import (
    SPLAT,
    define_background,
    define_camera,
    define_light,
    panorama_path,
)
from simfoundry.geometry.shapes import Mesh
from simfoundry.runtime.files import shipped
from simfoundry.scene.model import Background, Scene, SceneObject
from simfoundry.splats.usd import splat_layer

_LOADER = shipped("targets/usd") / "load.py"


def compile_usd(scene: Scene) -> Artifact:
    """Compile ``scene`` into ``scene.usda`` with its meshes and textures in ``assets/`` and a loader ``load.py``.

    The default prim ``/World`` contains ``Physics``, ``Objects/<object>/<link>/{Visuals,Colliders}/<name>``,
    ``Objects/<object>/Joints/<joint>``, ``Robots``, ``Background``, ``Cameras``, ``Lights``, ``Looks`` and
    ``Contacts``. The names of these prims start with a capital letter, so they never collide with names in a scene,
    which are lower-case. The source document is stored in metadata; see :mod:`~simfoundry.backends.usd.source`.

    Raises:
        InvalidSceneError: If a name is invalid or not unique.
    """
    check_names(scene)
    hulls = hull_losses(scene, REPLACED["usd"])
    given = with_hulls(scene, REPLACED["usd"])
    scene = with_light_links(given)
    world = Prim("World", "Xform", "/World", kind="assembly")
    robots = _define_world(world, scene)
    about = {} if scene.source is None else {KEY: write_source(world, scene.source)}
    contents = {"scene.usda": usda(world, about), "load.py": _LOADER.read_bytes()}
    contents |= {panorama_path(p): p.content for light in scene.lights if (p := light.panorama) is not None}
    contents |= _assets((*scene.objects, *robots.items), scene.background) | robots.files
    losses = (*usd_losses(given), *light_link_losses(given, "USD"), *hulls, *robots.losses)
    return Artifact("usd", "scene.usda", contents, losses)


def _define_world(world: Prim, scene: Scene) -> RobotsInUsd:
    relations = [str(relation) for relation in scene.relations]
    world.custom_data[KEY] = {"name": scene.name, "relations": relations}
    _define_physics(world, scene)
    objects = world.define("Objects", "Xform")
    objects.kind = "group"
    scopes = Scopes(objects, world.define("Looks", "Scope"), world.define("Contacts", "Scope"))
    for item in scene.objects:
        define_object(scopes, item)
    filter_pairs(scopes, scene)
    robots = define_robots(world, scopes, scene)
    robots.losses.extend(define_mounted(scopes, scene, robots))
    if scene.background is not None:
        define_background(world, scopes.looks, scene.background)
    cameras = world.define("Cameras", "Xform")
    for camera in scene.cameras:
        define_camera(cameras, camera)
    lights = world.define("Lights", "Xform")
    for light in scene.lights:
        define_light(lights, light)
    return robots


def _define_physics(world: Prim, scene: Scene) -> None:
    """Define the physics scene. The direction of gravity must be valid even if there is no gravity."""
    prim = world.define("Physics", "PhysicsScene")
    magnitude = float(np.linalg.norm(scene.gravity))
    direction = scene.gravity / magnitude if magnitude > 0 else np.array([0.0, 0.0, -1.0])
    prim.attribute("physics:gravityDirection", "vector3f", vec3(direction))
    prim.attribute("physics:gravityMagnitude", "float", rounded(magnitude))


def _assets(objects: Iterable[SceneObject], around: Background | None) -> dict[str, bytes]:
    """Return the mesh layer, the splat layer and the visual textures, sorted by path."""
    contents: dict[str, bytes] = {}
    links = [link for each in objects for item in (each, *each.variants) for link in item.links]
    visuals = [visual for link in links for visual in link.visuals] + list(around.visuals if around else ())
    shapes = [v.geometry for v in visuals] + [c.geometry for link in links for c in link.colliders]
    meshes = [shape for shape in shapes if isinstance(shape, Mesh)]
    if meshes:
        contents[MESHES] = mesh_layer(meshes)
    for texture in map(texture_of, visuals):
        if texture is not None:
            contents[texture_path(texture)] = texture
    if around is not None and around.splat is not None:
        contents[SPLAT] = splat_layer(around.splat)
    return dict(sorted(contents.items()))


BACKEND = Backend(compile_usd, FEATURES)
