"""RobotSpec to Robot: its models found, its words mapped onto their names."""

from __future__ import annotations

import os
from pathlib import Path
from types import MappingProxyType
from weakref import WeakValueDictionary

from simfoundry.errors import SimfoundryError
from simfoundry.scene.poses import pose
from simfoundry.scene.robot import FILES_ONLY, Attached, Follow, Gripper, LinkFrame, ModelFormat, NativeModel, Robot
from simfoundry.scene.robot_files import digest, find_model, model_files
from simfoundry.scene.robot_packages import NoModelError
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.robot_file import ModelSpec, RobotModelsSpec, read_models

OWN_MODELS = "SIMFOUNDRY_ROBOTS"
"""The environment variable that names a folder of one's own robot files, `franka_robotiq.yaml` and so on."""

_ROBOTS: WeakValueDictionary[tuple[object, ...], Robot] = WeakValueDictionary()
_MODELS: WeakValueDictionary[tuple[object, ...], NativeModel] = WeakValueDictionary()
"""What is alive of each content: the scenes of a batch share a robot, and what backends have read of it."""

_BUILT_IN = Path(__file__).parents[1] / "robots"
_SUFFIX = {ModelFormat.MJCF: ".xml", ModelFormat.URDF: ".urdf", ModelFormat.USD: ".usd"}


def lower_robot(name: str, spec: RobotSpec, document: Path, fetch: bool = True) -> Robot:
    """The robot ``name`` of a scene document. Raises :class:`NoModelError` where no model of it is found.

    Packages that fetch robots when they are first used do so with ``fetch`` only.
    """
    known = spec.known()
    if isinstance(spec.model, str):
        models, missing = _known_models(spec.model, fetch)
    elif spec.model.file is not None:
        file = find_model(spec.model.file, document, ".yaml", fetch)
        models, missing = _models(read_models(file), file, fetch)
    else:
        models, missing = _models(RobotModelsSpec.model_validate(_as_models(spec)), document, fetch)
    if not models:
        raise NoModelError(missing)
    home = dict(known.home) if known is not None else {}
    positions = home | (spec.joints if isinstance(spec.joints, dict) else {})
    key = (name, spec.model_dump_json(), *(id(model) for model in models.values()))
    robot = _ROBOTS.get(key) or Robot(
        name=name,
        kind=spec.model if isinstance(spec.model, str) else FILES_ONLY,
        X_WB=pose(spec.pose),
        positions=MappingProxyType(positions),
        reach=spec.reach or (known.reach if known is not None else None),
        opening=spec.opening or (known.opening if known is not None else None),
        models=MappingProxyType(models),
    )
    return _ROBOTS.setdefault(key, robot)


def _as_models(spec: RobotSpec) -> dict[str, ModelSpec]:
    assert not isinstance(spec.model, str)
    files = {"mjcf": spec.model.mjcf, "urdf": spec.model.urdf, "usd": spec.model.usd}
    return {key: ModelSpec(file=file) for key, file in files.items() if file is not None}


def _known_models(name: str, fetch: bool) -> tuple[dict[ModelFormat, NativeModel], str]:
    """The models of a known robot; what one's own folder says of a format stands in place of what is built in."""
    folder = os.environ.get(OWN_MODELS)
    own = Path(folder).expanduser().resolve() / f"{name}.yaml" if folder else None
    if own is not None and not own.parent.is_dir():
        raise SimfoundryError(f"{OWN_MODELS} names {own.parent}, and there is no such folder")
    built_in = _BUILT_IN / f"{name}.yaml"
    models = read_models(built_in)
    if own is None or not own.is_file():
        return _models(models, built_in, fetch)
    changed = read_models(own)
    return _models(models.model_copy(update={k: getattr(changed, k) for k in changed.model_fields_set}), own, fetch)


def _models(spec: RobotModelsSpec, document: Path, fetch: bool) -> tuple[dict[ModelFormat, NativeModel], str]:
    """The models that are there, and why the first that is not there is not."""
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
    """The first of the files that is there; else the reason of the best one whose package is here says most."""
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
