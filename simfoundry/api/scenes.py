"""Scenes that can be loaded or imported, and then edited in place, checked, compiled, simulated and judged."""

from __future__ import annotations

import tempfile
import weakref
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.api.document import EditableDocument
from simfoundry.api.entries import DocumentEntry, EntryField, ExpressionList, ValueField, section
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.models import base, native, origin, reuse, robot, scene, shapes, surroundings

if TYPE_CHECKING:
    import mujoco
    from pxr import Usd

    from simfoundry.api.build import Build
    from simfoundry.predicates import Verdict
    from simfoundry.scene.model import Scene
    from simfoundry.scene.state import SceneState
    from simfoundry.worlds.base import World

Vector = tuple[float, float, float]
Quaternion = tuple[float, float, float, float]
# A mapping of fields as in the YAML file, such as ``{"box": [0.1, 0.1, 0.1]}``.
Values = Mapping[str, object]

Text = ValueField[str | None, str | None]
Names = ValueField[tuple[str, ...], Sequence[str] | None]
Number = ValueField[float, float | None]
OptionalNumber = ValueField[float | None, float | None]
Flag = ValueField[bool, bool | None]
Quantity = ValueField[float | base.Estimate | None, float | base.Estimate | Values | None]
Position = ValueField[Vector, Sequence[float] | None]
Color = ValueField[tuple[float, ...] | None, Sequence[float] | str | None]
Origin = ValueField[origin.Origin | None, origin.Origin | Values | None]


class PoseEntry(DocumentEntry):
    """A pose in the world or in a frame: a position [m] and a rotation in one of three representations."""

    _model = reuse.FramedPose
    frame = Text()
    xyz = Position()
    yaw_deg = OptionalNumber()
    rpy_deg = ValueField[Vector | None, Sequence[float] | None]()
    quat_wxyz = ValueField[Quaternion | None, Sequence[float] | None]()


class CameraPoseEntry(DocumentEntry):
    """The pose of a camera: a position [m], and either a target (a point or a name) or a rotation."""

    _model = base.CameraPose
    frame = Text()
    xyz = Position()
    look_at = ValueField[Vector | str | None, Sequence[float] | str | None]()
    quat_wxyz = ValueField[Quaternion | None, Sequence[float] | None]()


class MaterialEntry(DocumentEntry):
    """A material with a density [kg/m^3], friction coefficients, restitution, color and texture."""

    _model = base.Material
    density = OptionalNumber()
    friction = Number()
    torsional_friction = Number()
    rolling_friction = Number()
    restitution = Number()
    color = Color()
    texture = Text()
    texture_size = OptionalNumber()


class ObjectEntry(DocumentEntry):
    """An object with a shape or asset, mass [kg] or density [kg/m^3], surface properties, and a pose or placement."""

    _model = scene.ObjectSpec
    like = Text()
    repeat = ValueField[reuse.RepeatSpec | str | None, reuse.RepeatSpec | Values | str | None]()
    category = Text()
    labels = Names()
    fixed = Flag()
    shape = ValueField[shapes.Shape | None, shapes.Shape | Values | None]()
    asset = Text()
    scale = ValueField[float | Vector, float | Sequence[float] | None]()
    visual = Text()
    material = Text()
    color = Color()
    mass = Quantity()
    density = Quantity()
    friction = OptionalNumber()
    restitution = OptionalNumber()
    collision = ValueField[str, base.Collision | None]()
    solid = ValueField[str, base.Solid | None]()
    pose = EntryField(PoseEntry)
    place = ValueField[scene.Place | None, scene.Place | Values | None]()
    joints = ValueField[Mapping[str, object], Values | None]()
    variant = Text()
    variants = ValueField[Mapping[str, scene.VariantSpec], Values | None]()
    native = ValueField[native.ObjectNative | None, native.ObjectNative | Values | None]()
    origin = Origin()


class RobotEntry(DocumentEntry):
    """A robot with a model, a base pose, and joint positions."""

    _model = robot.RobotSpec
    model = ValueField[str | robot.RobotFiles, str | robot.RobotFiles | Values]()
    pose = EntryField(PoseEntry)
    joints = ValueField[str | Mapping[str, float], str | Mapping[str, float] | None]()
    gains = ValueField[robot.GainsSpec, robot.GainsSpec | Values | None]()
    reach = OptionalNumber()
    opening = OptionalNumber()


class CameraEntry(DocumentEntry):
    """A pinhole camera with an image size [px], a field of view or focal lengths, a principal point, and a pose."""

    _model = surroundings.CameraSpec
    size = ValueField[tuple[int, int], Sequence[int]]()
    fov_deg = OptionalNumber()
    fx = OptionalNumber()
    fy = OptionalNumber()
    cx = OptionalNumber()
    cy = OptionalNumber()
    pose = EntryField(CameraPoseEntry)
    mount = Text()


class LightEntry(DocumentEntry):
    """A distant, point or dome light."""

    _model = surroundings.LightSpec
    type = ValueField[str, str]()
    intensity = Number()
    color = Color()
    direction = Position()
    xyz = Position()
    texture = Text()
    frame = Text()


class SceneDocument(EditableDocument):
    """A scene document that can be edited in place: ``scene.objects["mug"].mass = 0.3``, then ``scene.save()``."""

    _model, _kind = scene.SceneSpec, "scene/1"

    name = ValueField[str, str]()
    description = Text()
    viewpoint = Text()
    gravity = Position()
    parameters = ValueField[Mapping[str, float], Mapping[str, float] | None]()
    include = ValueField[Mapping[str, reuse.IncludeSpec], Values | None]()
    templates = ValueField[Mapping[str, scene.TemplateSpec], Values | None]()
    frames = ValueField[Mapping[str, reuse.ReferenceFrame], Values | None]()
    background = ValueField[surroundings.BackgroundSpec | None, surroundings.BackgroundSpec | Values | None]()
    objects = section(ObjectEntry)
    materials = section(MaterialEntry)
    robots = section(RobotEntry)
    cameras = section(CameraEntry)
    lights = section(LightEntry)
    no_contact = ValueField[tuple[tuple[str, str], ...], Sequence[Sequence[str]] | None]()
    options = ValueField[scene.OptionsSpec | None, scene.OptionsSpec | Values | None]()
    native = ValueField[native.SceneNative | None, native.SceneNative | Values | None]()
    allow = ValueField[Mapping[str, object], Values | None]()
    origin = Origin()

    @property
    def relations(self) -> ExpressionList:
        """Predicates that should hold in the scene, such as ``OnTop(cup, desk)``. The list is edited in place."""
        return ExpressionList(self, ("relations",))

    @relations.setter
    def relations(self, texts: Sequence[str]) -> None:
        self.update(relations=texts or None)

    def lower(self) -> Scene:
        """Lower the document to an immutable scene in which all poses, masses and inertias are resolved.

        Raises:
            SpecError: If the document has errors; the exception contains every finding.
        """
        from simfoundry.assets.cache import Cache
        from simfoundry.scene.lower import lower

        return lower(self._checked(), Cache.default())

    def _repr_html_(self) -> str | None:
        """Return the scene as HTML that notebooks show, or None if it has errors or the studio is not installed."""
        from simfoundry.runtime.extras import EXTRAS
        from simfoundry.studio.export import notebook_html

        if EXTRAS["studio"].missing:
            return None
        try:
            return notebook_html(self.lower())
        except SpecError:
            return None

    def compile(self, *targets: str | Path, out: str | Path, force: bool = False) -> Build:
        """Compile the scene into one folder per target.

        Args:
            targets: Formats, simulators, or paths of profiles; defaults to every format.
            out: Output folder; each target is written to ``out/<target>``.
            force: Whether to replace target folders that contain other files.

        Raises:
            OutputError: If a target folder contains files that are not from a build and ``force`` is False.
        """
        from simfoundry.api.build import Build
        from simfoundry.targets.build import TARGETS, build

        scene, folder = self.lower(), Path(out)
        return Build(folder, scene, tuple(build(scene, targets or TARGETS, folder, force)))

    def to_mujoco_spec(self) -> mujoco.MjSpec:
        """Return the scene as an editable MuJoCo model without writing any files.

        Raises:
            InvalidSceneError: If MuJoCo cannot load the scene; the message contains MuJoCo's reason.
        """
        import mujoco

        from simfoundry.backends import compile_scene
        from simfoundry.backends.mjcf import naming_scene

        artifact = compile_scene(self.lower(), "mjcf")
        files = dict(artifact.files)
        text = files.pop(artifact.entry).decode()
        included = {name: data for name, data in files.items() if name.endswith(".xml")}
        assets = {name: data for name, data in files.items() if name.startswith("assets/")}
        with naming_scene(self.name):
            return mujoco.MjSpec.from_string(text, include=included, assets=assets)

    def to_mujoco(self) -> mujoco.MjModel:
        """Return the scene as a compiled MuJoCo model without writing any files.

        Raises:
            InvalidSceneError: If MuJoCo cannot load the scene; the message contains MuJoCo's reason.
        """
        from simfoundry.backends.mjcf import naming_scene

        spec = self.to_mujoco_spec()
        with naming_scene(self.name):
            return spec.compile()

    def to_usd(self) -> Usd.Stage:
        """Return the scene as a USD stage. Its temporary files are deleted together with the stage."""
        from pxr import Usd

        from simfoundry.backends import compile_scene

        artifact = compile_scene(self.lower(), "usd")
        folder = tempfile.TemporaryDirectory(prefix="simfoundry_")
        artifact.write(Path(folder.name) / "usd")
        stage = Usd.Stage.Open(str(Path(folder.name) / "usd" / artifact.entry))
        weakref.finalize(stage, folder.cleanup)
        return stage

    def open(self, engine: str = "mujoco") -> World:
        """Load the scene into a simulator.

        The returned world is a context manager with the methods ``step``, ``state`` and ``judge``.
        """
        from simfoundry.worlds import open_world

        return open_world(self.lower(), engine)

    def judge(self, condition: str | None = None, state: SceneState | None = None) -> Verdict:
        """Judge a condition in a state of the scene.

        Args:
            condition: The condition; defaults to all relations in the scene.
            state: The state; defaults to the scene's initial state.

        Raises:
            ExpressionError: If the condition is invalid.
            PredicateError: If the condition cannot be evaluated in this scene.
        """
        from simfoundry.predicates import Judge
        from simfoundry.scene.state import SceneState

        lowered = self.lower()
        asked: object = condition if condition is not None else {"all": tuple(self.relations)}
        return Judge(lowered)(asked, SceneState.initial(lowered) if state is None else state)


def load(path: str | Path) -> SceneDocument:
    """Load a scene document, or import a USD, MJCF or URDF file.

    Raises:
        SpecError: If the document has errors; the exception contains every finding.
    """
    path = Path(path)
    if path.suffix.lower() not in (".yaml", ".yml"):
        from simfoundry.frontends.registry import model_suffixes

        if path.suffix.lower() in model_suffixes():
            return _imported(path)
    return SceneDocument.load(path)


def is_compiled_stage(path: Path) -> bool:
    """Return True if a file is a USD stage that was compiled from a document. Such a stage contains the document."""
    if path.suffix.lower() not in (".usd", ".usda", ".usdc", ".usdz"):
        return False
    from simfoundry.frontends.errors import refusing_faults
    from simfoundry.frontends.usd.compiled.stage import StageError, carrier, open_stage

    try:
        with refusing_faults(path):
            return carrier(open_stage(path)) is not None
    except StageError:
        return False  # the import reports why the stage could not be read


def _imported(path: Path) -> SceneDocument:
    from simfoundry.frontends.importer import import_file

    if is_compiled_stage(path):
        document = SceneDocument.load(path)
        document.mark_imported(path)
        return document
    if not path.is_file():
        raise SimfoundryError(f"file {path} does not exist")
    folder = tempfile.TemporaryDirectory(prefix="simfoundry_")
    report = import_file(path, Path(folder.name) / f"{path.stem}.scene.yaml")
    assert report.out is not None
    document = SceneDocument.load(report.out)
    document.mark_imported(path, Path(folder.name) / f"{path.stem}_files")
    weakref.finalize(document, folder.cleanup)
    return document
