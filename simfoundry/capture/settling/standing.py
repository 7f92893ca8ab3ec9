"""Bring every object of a reconstruction to rest: with its best solid, with its next best one, or held in place."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

from simfoundry.assets.cache import Cache
from simfoundry.assets.convex import file_key
from simfoundry.assets.errors import MeshError, Scale
from simfoundry.capture.description import describe
from simfoundry.capture.description.describe import mesh_files
from simfoundry.capture.description.kinds import kind_of
from simfoundry.capture.findings import HELD, CaptureFinding
from simfoundry.capture.frame import Frame
from simfoundry.capture.model_stages.joints import ARTICULATED
from simfoundry.capture.reconstruct import Progress, Reconstruction, with_supports
from simfoundry.capture.settling.containment import with_containers
from simfoundry.capture.shapes.fit import FittedShape
from simfoundry.capture.shapes.texture import textured_mesh
from simfoundry.runtime.files import write_file
from simfoundry.runtime.process_pair import ProcessPair
from simfoundry.scene.bodies import MeshUse
from simfoundry.scene.lower import lower, pose
from simfoundry.scene.mesh_bodies import read_body
from simfoundry.scene.model import Scene
from simfoundry.scene.state import SceneState, with_poses
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.load import load_scene
from simfoundry.spec.models.predicate import parse_call
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.yaml.write import to_yaml
from simfoundry.worlds.base import World
from simfoundry.worlds.rest import simulate
from simfoundry.worlds.settle import SettleResult, settle

TOPPLED_DEG, TOPPLED_M = 20.0, 0.03  # tilt and drift beyond which a solid is wrong; fitted poses are off by less
# Depth [m] to which two solids penetrate each other if they are wedged: MuJoCo keeps their convex parts in place, but
# PyBullet throws them out, from 5 mm on. What rests penetrates less than 1 mm.
WEDGED_M = 0.002

OF_SHAPE = ("mesh", "pose", "parts", "articulate")  # tasks of models whose shape is replaced
HELD_HINT = "correct its shape or pose in the studio, and remove `fixed`"
HELD_NOTE = "held in place: none of its fitted solids comes to rest"


@dataclass(frozen=True, eq=False)
class StandingScene:
    """A reconstruction at rest, with the lowered scene and the result of settling it."""

    reconstruction: Reconstruction
    scene: Scene
    settled: SettleResult


def settle_objects(
    built: Reconstruction,
    frame: Frame,
    scene_file: Path,
    cache: Cache | None,
    progress: Progress,
    draw: Callable[[Scene, SceneState], object] = lambda scene, state: None,
    processes: ProcessPair | None = None,
) -> StandingScene:
    """Settle a scene, and write it with its meshes and the poses and relations at rest to ``scene_file``.

    Relations state what supports each object, and which container holds it.

    An object whose solid does not come to rest, topples, or moves away from the pose that was written, gets its next
    best solid. Rounding by 0.1 mm, for example, may tip over an object that is balanced on the edge of its base. If two
    rest wedged into each other, the one with less confidence gets another solid. One that topples with all of its
    solids lies where it fell. One that does not rest with any of them is held in place by ``fixed``, so that nothing
    that was seen is missing, and reported as a finding.

    ``draw`` is called with each scene that rests, and starts to draw it; meanwhile, a simulation checks that
    it stays at rest.
    ``processes`` decompose meshes into convex parts.
    """
    from simfoundry.worlds.mujoco_world import MujocoWorld

    while True:
        write_scene(built, scene_file, built.spec)
        loaded = load_scene(scene_file)
        if processes is not None and cache is not None:
            _decompose_meshes(loaded, cache, processes)
        scene = lower(loaded, cache, lambda name, done, total: progress(f"collide {name}", 0.6 + 0.2 * done / total))
        with MujocoWorld(scene) as world:
            settled = settle(
                world,
                progress=lambda stage, share: progress(stage, 0.8 + 0.1 * share),
                is_hopeless=partial(_wedged, built, world),
            )
            spec = with_poses(built.spec, settled.state.poses)
            toppled = tuple(name for name in _toppled(settled) if built.shapes[name].alternatives)
            fallen = tuple(dict.fromkeys((*settled.lost, *toppled))) or _wedged(built, world)
            if not fallen:
                draw(scene, settled.state)
                fallen = _leaving(world, spec)
            if not fallen:
                supports = {o.name: o.supports for o in settled.objects}
                spec = with_containers(with_supports(spec, supports), scene)
                break
        for name in _suspects(built, fallen):
            built = _supported(built, name, frame)
        for folder in ("meshes", ARTICULATED):
            shutil.rmtree(scene_file.parent / folder, ignore_errors=True)
    write_scene(built, scene_file, spec)
    return StandingScene(replace(built, spec=spec), scene, settled)


def _decompose_meshes(loaded: Loaded, cache: Cache, processes: ProcessPair) -> None:
    """Put the convex parts of the meshes of a scene into the cache, if there are several that it lacks.

    Each takes seconds.
    """
    assert isinstance(loaded.spec, SceneSpec)
    uses = ((loaded.file(o.asset), o) for o in loaded.spec.objects.values() if o.asset and not is_document(o.asset))
    missing = [(path, o) for path, o in uses if cache.get(file_key(path, o.scale, o.collision)) is None]
    if len(missing) > 1:
        with ThreadPoolExecutor(processes.size) as threads:
            calls = [partial(_decompose_mesh, path, o.scale, o.collision, cache) for path, o in missing]
            list(threads.map(processes.run, calls))


def _decompose_mesh(path: Path, scale: Scale, how: str, cache: Cache) -> None:
    with suppress(MeshError):  # reported when the scene is lowered
        read_body(path, MeshUse(scale, solid="given", collision=how), cache, lambda step: None)


def _suspects(built: Reconstruction, fallen: tuple[str, ...]) -> tuple[str, ...]:
    """Return which solids are to be replaced: meshes of models that fell or are beneath what fell, else what fell.

    A model does not know that an object stands, so its mesh may be bent, and what stands on it is not to blame.
    """
    calls = [parse_call(text) for text in built.spec.relations]
    carriers = {call.args[0]: call.args[1] for call in calls}
    meshes = []
    for fallen_one in fallen:
        stack = [fallen_one]
        while carriers.get(stack[-1]) in built.shapes and carriers[stack[-1]] not in stack:
            stack.append(carriers[stack[-1]])
        meshes += [name for name in stack if _is_model_mesh(built, name)][:1]
    return tuple(dict.fromkeys(meshes)) or fallen


def _is_model_mesh(built: Reconstruction, name: str) -> bool:
    """Return True if an object uses the mesh of a model and has a fitted solid to fall back on."""
    origin = built.spec.objects[name].origin
    is_made = origin is not None and any(use.task == "mesh" for use in origin.models)
    return is_made and bool(built.shapes[name].alternatives)


def _toppled(settled: SettleResult) -> tuple[str, ...]:
    """Return the objects that rest, but not as they were seen."""
    return tuple(o.name for o in settled.objects if o.problems and (o.tilt_deg > TOPPLED_DEG or o.drift > TOPPLED_M))


def _wedged(built: Reconstruction, world: World) -> tuple[str, ...]:
    """Return the less certain one of each two objects that are wedged into each other, unless it is held in place."""
    pairs = {tuple(sorted((c.a, c.b))) for c in world.contacts() if c.depth > WEDGED_M}
    free = {name for name in built.shapes if not built.spec.objects[name].fixed}
    sure = {name: (built.shapes[name].confidence, name) for name in free}
    return tuple(sorted({min(free.intersection(pair), key=sure.__getitem__) for pair in pairs if free & {*pair}}))


def _supported(built: Reconstruction, name: str, frame: Frame) -> Reconstruction:
    """Return the reconstruction in which an object has its next best solid, or is held in place."""
    shape = built.shapes[name]
    if not shape.alternatives:
        return _held(built, name)
    following = replace(shape.alternatives[0], alternatives=shape.alternatives[1:])
    return _reshaped(built, name, following, frame)


def _reshaped(built: Reconstruction, name: str, shape: FittedShape, frame: Frame) -> Reconstruction:
    k = built.names[name]
    mesh = textured_mesh(shape, frame, built.support, built.segmentation.labels == k)
    own = (f"meshes/{name}.", f"{ARTICULATED}/{name}/")
    files = {path: data for path, data in built.files.items() if not path.startswith(own)} | mesh_files(name, mesh)
    item = describe.object_spec(built.spec.name, name, shape, k)
    before = built.spec.objects[name]
    if item.origin is not None and before.origin is not None and before.origin.models:
        uses = tuple(use for use in before.origin.models if use.task not in OF_SHAPE)
        stated: dict[str, object] = {"origin": item.origin.model_copy(update={"models": uses})}
        if before.mass is not None and any(use.task == "read_scene" for use in uses):
            stated |= {"category": before.category, "material": before.material, "mass": before.mass}
        item = item.model_copy(update=stated)
    prior = kind_of(shape).material
    materials = {**built.spec.materials, prior.name: prior.material}
    update = {"objects": {**built.spec.objects, name: item}, "materials": materials}
    spec = built.spec.model_copy(update=update)
    return replace(built, spec=spec, files=files, shapes={**built.shapes, name: shape})


def _held(built: Reconstruction, name: str) -> Reconstruction:
    """Return the reconstruction with an object that does not move, and the finding that says so."""
    item = built.spec.objects[name]
    origin = None if item.origin is None else item.origin.model_copy(update={"note": HELD_NOTE})
    held = item.model_copy(update={"fixed": True, "origin": origin})
    relations = tuple(text for text in built.spec.relations if parse_call(text).args[0] != name)
    spec = built.spec.model_copy(update={"objects": {**built.spec.objects, name: held}, "relations": relations})
    finding = CaptureFinding(
        HELD, "none of its fitted solids comes to rest, so it is held in place", HELD_HINT, (name,)
    )
    return replace(built, spec=spec, findings=(*built.findings, finding))


def _leaving(world: World, spec: SceneSpec) -> tuple[str, ...]:
    """Return the name of the object that moves farthest from its pose in ``spec`` within two seconds.

    The result is a tuple, which is empty if no object moves.
    """
    state = SceneState.of({name: pose(item.pose) for name, item in spec.objects.items()}, {})
    motions = [m for m in simulate(world, 2.0, state) if not m.stays]
    return tuple(m.name for m in sorted(motions, key=lambda m: (-m.moved, m.name))[:1])


def write_scene(built: Reconstruction, scene_file: Path, spec: SceneSpec) -> None:
    """Write a scene with its meshes."""
    for relative, data in built.files.items():
        write_file(scene_file.parent / relative, data)
    write_file(scene_file, to_yaml(spec, comment="Estimated from one picture; see report.json.").encode())
