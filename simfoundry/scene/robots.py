"""Lower a RobotSpec to a Robot: find its models and map the scene's names to theirs."""

from __future__ import annotations

from pathlib import Path
from types import MappingProxyType
from weakref import WeakValueDictionary

from simfoundry.scene.poses import pose
from simfoundry.scene.robot import FILES_ONLY, Attached, Follow, Gripper, LinkFrame, ModelFormat, NativeModel, Robot
from simfoundry.scene.robot_files import digest, find_model, model_files
from simfoundry.scene.robot_packages import NoModelError
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.robot_file import (
    ModelSpec,
    RobotFileSpec,
    known_robot_file,
    own_folder,
    read_robot_file,
    robot_names,
)

_ROBOTS: WeakValueDictionary[tuple[object, ...], Robot] = WeakValueDictionary()
_MODELS: WeakValueDictionary[tuple[object, ...], NativeModel] = WeakValueDictionary()
"""Live robots by content: the scenes of a batch share a robot, and the data that backends have read of it."""

_SUFFIX = {ModelFormat.MJCF: ".xml", ModelFormat.URDF: ".urdf", ModelFormat.USD: ".usd"}


def lower_robot(name: str, spec: RobotSpec, document: Path, fetch: bool = True) -> Robot:
    """Return the robot ``name`` of a scene document; raises :class:`NoModelError` if no model of it is found.

    Packages that download robots on first use do so only with ``fetch``.
    """
    if isinstance(spec.model, str):
        own_folder(must_exist=True)
        found = known_robot_file(spec.model)
        if found is None:
            raise NoModelError(f"no robot is called `{spec.model}`; there are: {', '.join(robot_names())}")
        described, file = found
    elif spec.model.file is not None:
        file = find_model(spec.model.file, document, ".yaml", fetch)
        described = read_robot_file(file)
    else:
        described, file = RobotFileSpec.model_validate(_as_models(spec)), document
    models, missing = _models(described, file, fetch)
    if not models:
        raise NoModelError(missing)
    positions = described.home_positions | (spec.joints if isinstance(spec.joints, dict) else {})
    key = (name, spec.model_dump_json(), *(id(model) for model in models.values()))
    robot = _ROBOTS.get(key) or Robot(
        name=name,
        kind=spec.model if isinstance(spec.model, str) else FILES_ONLY,
        X_WB=pose(spec.pose),
        positions=MappingProxyType(positions),
        reach=spec.reach or described.reach,
        opening=spec.opening or described.opening,
        models=MappingProxyType(models),
    )
    return _ROBOTS.setdefault(key, robot)


def _as_models(spec: RobotSpec) -> dict[str, ModelSpec]:
    assert not isinstance(spec.model, str)
    files = {"mjcf": spec.model.mjcf, "urdf": spec.model.urdf, "usd": spec.model.usd}
    return {key: ModelSpec(file=file) for key, file in files.items() if file is not None}


def _models(spec: RobotFileSpec, document: Path, fetch: bool) -> tuple[dict[ModelFormat, NativeModel], str]:
    """Return the available models, and the reason why the first missing one is missing."""
    found, missing = {}, ""
    for key in ModelFormat:
        model: ModelSpec | None = getattr(spec, key.value)
        if model is not None:
            try:
                found[key] = _model(key, model, document, fetch)
            except NoModelError as error:
                missing = missing or str(error)
    return found, missing


def _model(key: ModelFormat, spec: ModelSpec, document: Path, fetch: bool) -> NativeModel:
    file = _first(spec.files, document, _SUFFIX[key], fetch)
    attached = []
    for name, part in spec.attach.items():
        files = [part.file] if isinstance(part.file, str) else part.file
        attached.append(Attached(name, _first(files, document, _SUFFIX[key], fetch), part.to, pose(part.pose)))
    needed = [path for one in (file, *(a.file for a in attached)) for path in model_files(one)]
    content = digest(needed)
    same = (key, content, file, *(a.file for a in attached), spec.model_dump_json())
    model = _MODELS.get(same) or NativeModel(
        format=key,
        file=file,
        digest=content,
        attached=tuple(attached),
        links=MappingProxyType({n: LinkFrame(f.link, pose(f.pose)) for n, f in spec.links.items()}),
        joints=MappingProxyType({f"joint{k}": joint for k, joint in enumerate(spec.joints, 1)}),
        gripper=_gripper(spec),
        effort=MappingProxyType(dict(spec.effort)),
    )
    return _MODELS.setdefault(same, model)


def _first(references: list[str], document: Path, suffix: str, fetch: bool) -> Path:
    """Return the first file found; otherwise raise the error of the best file whose package is installed."""
    reasons = []
    for reference in references:
        try:
            return find_model(reference, document, suffix, fetch)
        except NoModelError as error:
            reasons.append(error)
    raise next((reason for reason in reasons if reason.is_known), reasons[0])


def _gripper(spec: ModelSpec) -> Gripper | None:
    if spec.gripper is None:
        return None
    follow = {n: Follow(f.joint, f.multiplier, f.offset) for n, f in spec.gripper.follow.items()}
    return Gripper(
        MappingProxyType(dict(spec.gripper.command)),
        MappingProxyType(dict(spec.gripper.joints)),
        MappingProxyType(follow),
    )
