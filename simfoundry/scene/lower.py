"""Lower a SceneSpec to a Scene. This resolves all defaults, composes frames, and computes masses and convex parts.

Identical documents produce identical scenes on every machine. Mesh errors are reported at the line that refers to the
mesh.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from itertools import product
from pathlib import Path
from types import MappingProxyType

import numpy as np

from simfoundry.assets.cache import Cache
from simfoundry.assets.errors import MeshError
from simfoundry.assets.panorama import read_panorama
from simfoundry.geometry.frames import Pose, look_at
from simfoundry.geometry.frames import frozen_array as frozen
from simfoundry.scene import model
from simfoundry.scene.attachments import Options
from simfoundry.scene.cameras import lower_cameras
from simfoundry.scene.carriers import PlaceError
from simfoundry.scene.earlier import EarlierLowering
from simfoundry.scene.frames import FrameTree
from simfoundry.scene.model import LeftOut, Light, Scene, SceneObject
from simfoundry.scene.objects import ObjectLowering, Progress
from simfoundry.scene.place import RELATIONS, KnownPlacement, Placement, needs, order, place_all
from simfoundry.scene.state import pose as pose
from simfoundry.spec.diagnostics import Diagnostic, SpecError
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models.asset import AssetSpec
from simfoundry.spec.models.predicate import parse_call
from simfoundry.spec.models.scene import Place, SceneSpec
from simfoundry.spec.models.surroundings import LightSpec


@dataclass
class Lowering:
    """The state shared by all passes that lower a scene: the document, the options, and the approximate objects.

    If ``fetch`` is set, robot models are downloaded. In a ``draft``, meshes are not decomposed: a mesh without convex
    parts in the ``cache`` is represented by its hull, and its object is added to ``approximate``. A placement that
    depends on an approximate object may then fail without an error; ``unplaced`` contains the objects whose poses are
    uncertain for this reason. A draft that is ``shown`` has the same visuals as a build. Objects that have not changed
    are taken from the ``earlier`` draft. ``lowered`` contains the objects before they are placed.
    """

    loaded: Loaded
    cache: Cache | None = None
    progress: Progress | None = None
    fetch: bool = True
    draft: bool = False
    shown: bool = False
    approximate: set[str] = field(default_factory=set)
    unplaced: set[str] = field(default_factory=set)
    earlier: EarlierLowering | None = None
    lowered: dict[str, SceneObject] = field(default_factory=dict)

    @property
    def spec(self) -> SceneSpec:
        """The content of the document."""
        assert isinstance(self.loaded.spec, SceneSpec)
        return self.loaded.spec

    @property
    def places(self) -> dict[str, Place]:
        """The placements to be solved, keyed by object name."""
        return {name: item.place for name, item in self.spec.objects.items() if item.place is not None}

    @property
    def placements(self) -> dict[str, Placement]:
        """The placements and the poses in frames, keyed by object name."""
        framed = {name: item.pose for name, item in self.spec.objects.items() if item.pose.frame is not None}
        return {**framed, **self.places}

    @cached_property
    def frames(self) -> FrameTree:
        """The frames of the scene."""
        return FrameTree(self.spec)

    def viewer(self, placed: Mapping[str, SceneObject]) -> Pose | None:
        """Return the frame that defines left and right, which may depend on objects that are already placed.

        Raises:
            SpecError: If the viewpoint is a camera at the center of its target.
        """
        try:
            return self.frames.viewer(self.spec.viewpoint, placed)
        except PlaceError as error:
            raise SpecError([self.loaded.finding("SF210", ("viewpoint",), error.message, error.hint)]) from None

    def run(self, passes: tuple[Pass, ...]) -> Scene:
        """Run the passes and return the scene.

        Raises:
            SpecError: If a pass fails. The error contains all findings from this pass.
        """
        if self.loaded.errors:
            raise SpecError(self.loaded.errors)
        viewer = None if self.frames.viewer_needs(self.spec.viewpoint) else self.viewer({})
        scene = Scene(self.spec.name, frozen(self.spec.gravity, (3,)), (), viewer=viewer)
        if (given := self.spec.options) is not None:
            scene = replace(scene, options=Options(given.timestep, given.solver_iterations))
        if (native := self.spec.native) is not None:
            scene = replace(scene, native=MappingProxyType(native.mjcf))
        for lowering_pass in passes:
            scene = lowering_pass(self, scene)
        return scene


Pass = Callable[[Lowering, Scene], Scene]


def lower(loaded: Loaded, cache: Cache | None = None, progress: Progress | None = None, fetch: bool = True) -> Scene:
    """Lower a checked scene document.

    ``cache`` stores convex decompositions for later runs. ``progress`` is called with a name, the number of finished
    objects, and the total number of objects. Robot models are downloaded only if ``fetch`` is set. Robots whose models
    are missing are left out.

    Raises:
        SpecError: If the document cannot be lowered. The error contains all findings.
    """
    return Lowering(loaded, cache, progress, fetch).run(PASSES)


def lower_file(
    path: Path,
    cache: Cache | None = None,
    progress: Progress | None = None,
    fetch: bool = True,
    parameters: Mapping[str, float] | None = None,
) -> Scene:
    """Load, check and lower the scene document at ``path``; see :func:`lower`.

    ``parameters`` replace the values of the scene's parameters.

    Raises:
        SpecError: If the document is invalid or cannot be lowered.
    """
    from simfoundry.spec.load import load_scene

    return lower(load_scene(path, parameters), cache, progress, fetch)


# -- passes, in the order of PASSES ------------------------------------------------------------------------------------


def lower_objects(lowering: Lowering, scene: Scene) -> Scene:
    """Lower the objects without their placements.

    Objects placed inside other objects are lowered first, together with all objects on which they depend. If an object
    does not fit, the error is detected before the remaining meshes are decomposed, which may take minutes. In that
    case, the remaining meshes are only checked.

    Raises:
        SpecError: If an object cannot be lowered. The error contains all findings.
    """
    spec = lowering.spec
    work = ObjectLowering(
        lowering.loaded, lowering.cache, lowering.progress, draft=lowering.draft, shown=lowering.shown
    )
    found: dict[str, SceneObject | None] = {}
    # A viewpoint that looks at an object is unknown until the object is placed.
    is_late = lowering.draft or bool(lowering.frames.viewer_needs(spec.viewpoint))
    first = () if is_late else _containers_and_contents(lowering)
    misfits = _certain_misfits(lowering, first) if first else []
    work.cuts = not misfits
    # The category of a copy depends on the object that is repeated.
    earlier = lowering.earlier if lowering.earlier is not None and lowering.loaded.reuse is None else None
    if earlier is not None and not earlier.has_same_materials(spec):
        earlier = None
    for name in (*first, *(name for name in spec.objects if name not in first)):
        work.report(name)
        known = earlier.lowered_object(name, spec) if earlier is not None else None
        found[name] = known if known is not None else work.lower(name)
        work.done += 1
        if first and len(found) == len(first) and not work.findings and not misfits:
            # These objects do not depend on any others, so their placements can be solved before the rest is lowered.
            objects = {k: item for k, item in found.items() if item is not None}
            places = {k: place for k, place in lowering.placements.items() if k in objects}
            misfits = _findings(lowering, place_all(objects, places, scene.viewer, lowering.frames)[1])
            work.cuts = not misfits
    if work.findings or misfits:
        raise SpecError([*work.findings, *misfits])
    lowering.approximate |= work.approximate
    lowering.lowered = {name: item for name, item in found.items() if item is not None}
    return replace(scene, objects=tuple(item for name in spec.objects if (item := found[name]) is not None))


def _containers_and_contents(lowering: Lowering) -> tuple[str, ...]:
    """Return the objects placed `inside` other objects and all objects on which they depend, in spec order."""
    todo, seen = [name for name, place in lowering.places.items() if place.inside is not None], set[str]()
    places = lowering.placements
    while todo:
        if (name := todo.pop()) not in seen:
            seen.add(name)
            todo += needs(places[name], lowering.frames) if name in places else ()
    return tuple(name for name in lowering.spec.objects if name in seen)


def _certain_misfits(lowering: Lowering, names: tuple[str, ...]) -> list[Diagnostic]:
    """Return findings for `inside` placements that are certain to fail.

    These are found before meshes that are not cached are decomposed.
    """
    from simfoundry.scene.misfits import certain_misfits, uncut

    spec, loaded = lowering.spec, lowering.loaded
    meshes = [name for name in names if spec.objects[name].shape is None]
    draft = ObjectLowering(loaded, lowering.cache, draft=True)
    for name in meshes:
        draft.lower(name)
    if draft.findings or not draft.approximate:
        return []
    work = ObjectLowering(loaded, lowering.cache, cuts=False)
    found = {name: item for name in names if (item := work.lower(name)) is not None}
    shapes = {name: uncut(item) if name in draft.approximate else item for name, item in found.items()}
    viewer = lowering.viewer({})
    placements = lowering.placements
    return _findings(lowering, certain_misfits(shapes, placements, viewer, draft.approximate, lowering.frames))


def _findings(lowering: Lowering, errors: Mapping[str, PlaceError]) -> list[Diagnostic]:
    """Return a finding for each failed placement, located at the keys that specify the placement."""
    paths = {k: ("objects", k, "place" if lowering.spec.objects[k].place is not None else "pose") for k in errors}
    return [lowering.loaded.finding("SF210", paths[k], e.message, e.hint) for k, e in errors.items()]


def place_objects(lowering: Lowering, scene: Scene) -> Scene:
    """Solve every `place` constraint, and replace it and each pose in a frame with a pose in the world."""
    places, frames = lowering.placements, lowering.frames
    if frames.viewer_needs(lowering.spec.viewpoint):
        scene = replace(scene, viewer=_moving_viewer(lowering, scene))
    if not places:
        return scene
    known: KnownPlacement = lambda item, place, placed: None  # noqa: E731
    if (earlier := lowering.earlier) is not None and earlier.has_same_frames(lowering.spec, scene.viewer):
        known = partial(earlier.placed_object, frames=frames)
    solved, errors = place_all(scene.by_name, places, scene.viewer, frames, known)
    for name, item in solved.items():
        if item.variants and name in places and not errors:
            # Solve for the pose of each variant separately, with all other objects unchanged.
            own = {name: places[name]}
            stood = [place_all(solved | {name: v}, own, scene.viewer, frames) for v in item.variants]
            solved[name] = replace(item, variants=tuple(found[name] for found, _ in stood))
            errors |= {k: e for _, wrong in stood for k, e in wrong.items()}
    for name in order(places, frames) if lowering.approximate or lowering.unplaced else ():
        needed = {*needs(places[name], frames)}
        if lowering.approximate & {name, *needed} or lowering.unplaced & needed:
            lowering.unplaced.add(name)
    errors = {name: error for name, error in errors.items() if name not in lowering.unplaced}
    if errors:
        raise SpecError(_findings(lowering, errors))
    return replace(scene, objects=tuple(solved.values()))


def _moving_viewer(lowering: Lowering, scene: Scene) -> Pose | None:
    """Return the frame of a viewpoint that depends on the poses of objects, which are placed first.

    Raises:
        SpecError: If the pose of one of these objects depends on the viewpoint.
    """
    places, frames, viewpoint = lowering.placements, lowering.frames, lowering.spec.viewpoint
    chain, todo = list[str](), frames.viewer_needs(viewpoint)
    while todo:
        if (name := todo.pop()) in places and name not in chain:
            chain.append(name)
            todo += needs(places[name], frames)
    for name in chain:
        place = lowering.places.get(name)
        if place is not None and place.seen_from is None and any(getattr(place, word) for word in RELATIONS):
            message = f"the viewpoint depends on the pose of `{name}`, which in turn depends on the viewpoint"
            hint = "let the camera look at a point"
            raise SpecError([lowering.loaded.finding("SF210", ("viewpoint",), message, hint)])
    placed, _ = place_all(scene.by_name, {name: places[name] for name in chain}, None, frames)
    return lowering.viewer(placed)


def exclude_contacts(lowering: Lowering, scene: Scene) -> Scene:
    """Collect the pairs of links whose contacts are disabled.

    Pairs within an object are stored in the object. Pairs between objects are stored once in the scene, with qualified
    link names.
    """
    by_name = dict(scene.by_name)

    def links(part: str) -> tuple[SceneObject, list[str]]:
        name, _, link = part.partition(".")
        item = by_name[name]
        carried = {joint.name: joint.child for joint in item.joints}
        return item, [carried.get(link, link)] if link else [k.name for k in item.links]

    between: dict[tuple[str, str], None] = {}
    for (a, links_a), (b, links_b) in ((links(a), links(b)) for a, b in lowering.spec.no_contact):
        if a.name == b.name:
            own = (*a.no_contact, *((one, other) for one, other in product(links_a, links_b) if one != other))
            by_name[a.name] = replace(a, no_contact=own)
            continue
        for one, other in product(links_a, links_b):
            first, second = sorted((a.qualified(one), b.qualified(other)))
            between[first, second] = None
    return replace(scene, objects=tuple(by_name.values()), no_contact=tuple(between))


def lower_robots(lowering: Lowering, scene: Scene) -> Scene:
    """Lower the robots whose models are available. All other robots and their cameras are left out."""
    spec = lowering.spec
    if not spec.robots:
        return scene
    from simfoundry.scene.robot import lower_robot
    from simfoundry.scene.robot_files import NoModelError

    found, lost = [], []
    for name, item in spec.robots.items():
        try:
            robot = lower_robot(name, item, lowering.loaded.path, lowering.fetch)
            if item.pose.frame is not None:
                robot = replace(robot, X_WB=lowering.frames.pose(item.pose.frame) @ robot.X_WB)
            found.append(robot)
        except NoModelError as error:
            X_WB = lowering.frames.pose(item.pose.frame) @ pose(item.pose)
            lost.append(LeftOut(f"robots.{name}", f"no model found: {error}", X_WB))
            carried = [n for n, c in spec.cameras.items() if (c.mount or "").partition(".")[0] == name]
            lost += [LeftOut(f"cameras.{n}", f"the camera is mounted on `{name}`, which has no model") for n in carried]
    return replace(scene, robots=tuple(found), left_out=(*scene.left_out, *lost))


def lower_surroundings(lowering: Lowering, scene: Scene) -> Scene:
    """Lower the lights and the background, and leave out unusable object textures."""
    spec = lowering.spec
    frames, placed = lowering.frames, scene.by_name
    lights = tuple(
        _light(lowering.loaded, name, light, frames.pose(light.frame, placed)) for name, light in spec.lights.items()
    )
    scene = replace(scene, lights=lights, left_out=(*scene.left_out, *_unusable_textures(lowering.loaded, spec)))
    if spec.background is None:
        return scene
    from simfoundry.scene.mesh_bodies import lower_background  # imports the mesh and splat readers

    return replace(scene, background=lower_background(lowering.loaded, spec.background))


def keep_source(lowering: Lowering, scene: Scene) -> Scene:
    """Add the document and its relations to the scene, both for evaluation and for targets that embed the document."""
    from simfoundry.spec.yaml.write import to_data  # not needed by lints

    loaded, path = lowering.loaded, lowering.loaded.path.resolve()
    # Use a path relative to the project because it is the same on every machine.
    file = path.relative_to(loaded.root).as_posix() if path.is_relative_to(loaded.root) else path.name
    relations = tuple(model.Relation(c.predicate, c.args) for c in map(parse_call, lowering.spec.relations))
    source = model.Source(file, MappingProxyType(to_data(lowering.spec)))
    return replace(scene, relations=relations, source=source)


OBJECT_PASSES: tuple[Pass, ...] = (lower_objects, exclude_contacts, place_objects)
PASSES: tuple[Pass, ...] = (*OBJECT_PASSES, lower_robots, lower_cameras, lower_surroundings, keep_source)


# -- parts of passes ---------------------------------------------------------------------------------------------------


def _unusable_textures(loaded: Loaded, spec: SceneSpec) -> Iterator[LeftOut]:
    """Yield the object textures that cannot be used, along with the reasons."""
    from simfoundry.assets.textures import document_faults

    for (_, name, _), fault in document_faults(loaded, spec):
        yield LeftOut(f"objects.{name}.texture", fault)
    for name, item in spec.objects.items():
        asset = loaded.used(item.asset) if item.asset is not None and is_document(item.asset) else None
        if asset is not None and isinstance(asset.spec, AssetSpec):
            for _, fault in document_faults(asset, asset.spec):
                yield LeftOut(f"objects.{name}.texture", fault)


def _light(loaded: Loaded, name: str, spec: LightSpec, X_WF: Pose) -> Light:
    """Convert a light, which shines along -z of its frame.

    Raises:
        SpecError: If the panorama of a dome light cannot be read.
    """
    X_WL = Pose.of(spec.xyz)
    if spec.type == "distant":
        aim = look_at(np.zeros(3), np.array(spec.direction)) @ Pose.of(q=(0.0, 1.0, 0.0, 0.0))
        X_WL = Pose.of(q=aim.q)
    panorama = None
    if spec.texture is not None:
        try:
            panorama = read_panorama(loaded.file(spec.texture))
        except MeshError as error:
            place = ("lights", name, "texture")
            raise SpecError([loaded.finding(error.code, place, str(error), error.hint)]) from None
    rgb = frozen(spec.color[:3], (3,))
    return Light(name, model.LightType(spec.type), spec.intensity, rgb, X_WF @ X_WL, panorama)
