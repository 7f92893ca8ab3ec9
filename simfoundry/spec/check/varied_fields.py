"""Find the values in a twin that the paths of the axis `vary` stand for.

A path starts with a section in the singular (`light.key.intensity`), with the name of an object that has joints
(`cabinet.drawer`), or with a key of the scene (`gravity`) or of the task (`instruction`).
"""

from __future__ import annotations

import math
import typing
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from fnmatch import fnmatchcase
from typing import Any

from pydantic import BaseModel

from simfoundry.spec.check.scene import OF_LINKS
from simfoundry.spec.check.varied_places import (
    OF_MATERIALS,
    DocumentPath,
    Effect,
    ValueKind,
    VariedField,
    VariedPlace,
    VaryPathError,
    inherited_place,
    place_of,
    value_kind,
)
from simfoundry.spec.check.varied_values import NO_ENDS
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models.asset import AssetSpec, LinkSpec
from simfoundry.spec.models.base import BodySpec, Estimate
from simfoundry.spec.models.joint import JointSpec
from simfoundry.spec.models.robot import RobotSpec
from simfoundry.spec.models.scene import ObjectSpec, SceneSpec, position
from simfoundry.spec.models.task import TaskSpec
from simfoundry.spec.models.types import field_type, flat

# Sections of a scene, by the word with which a path starts.
SECTIONS = {
    "object": "objects", "light": "lights", "camera": "cameras", "material": "materials", "robot": "robots",
    "frame": "frames",
}  # fmt: skip
# Keys of a scene whose values are not in a section.
SCENE_KEYS = ("gravity", "options", "background")
# Keys that change only pictures, wherever they are.
PICTURE_KEYS = ("color", "texture", "texture_size", "visual")


class FieldFinder:
    """Finds the values of a twin by path.

    Attributes:
        scene: The twin's scene, without errors.
        task: The twin's task, or None if the twin is a scene.
        assets: Documents that replace the assets of objects, by object name.
    """

    def __init__(self, scene: Loaded, task: Loaded | None = None, assets: Mapping[str, Loaded] | None = None) -> None:
        assert isinstance(scene.spec, SceneSpec)
        self.scene, self.spec, self.assets = scene, scene.spec, assets or {}
        self.task = task.spec if task is not None and isinstance(task.spec, TaskSpec) else None
        self._as_density = False

    def asset(self, name: str) -> AssetSpec | None:
        """Return the asset document of an object, or None if the object is a shape or a mesh."""
        if name in self.assets:
            found = self.assets[name].spec
            return found if isinstance(found, AssetSpec) else None
        item = self.spec.objects[name]
        if item.asset is None or not is_document(item.asset):
            return None
        used = self.scene.used(item.asset)
        return used.spec if used is not None and isinstance(used.spec, AssetSpec) else None

    def find(self, entry: str, as_density: bool = False) -> list[VariedField]:
        """Return the values that a path stands for, in the order of the documents.

        Args:
            entry: The path.
            as_density: Stand for the density of a body whose mass is not stated; both change by the same factor.

        Raises:
            VaryPathError: No value has this path. The error says why.
        """
        head, *rest = entry.split(".")
        self._as_density = as_density
        if entry == "instruction":
            return [self._instruction()]
        if head == "disturbances":
            return self._of_disturbances(rest, entry)
        if head == "parameter":
            return self._of_parameters(rest, entry)
        if head in SCENE_KEYS:
            return self._of_scene(head, rest, entry)
        if head in SECTIONS:
            return self._of_section(head, rest, entry)
        if head in SECTIONS.values():
            singular = next(word for word, section in SECTIONS.items() if section == head)
            raise VaryPathError(f"`{entry}` names no value", f"write `{'.'.join((singular, *rest))}`")
        return self._of_joints(head, rest, entry)

    # -- roots --------------------------------------------------------------------------------------------------------

    def _instruction(self) -> VariedField:
        if self.task is None:
            raise VaryPathError("the twin is a scene, which has no `instruction`", "name a task as the `twin`")
        place = VariedPlace("task", ("instruction",), self.task.instruction, owner=self.task)
        return VariedField("instruction", ValueKind.WORD, (place,), "instruction")

    def _of_disturbances(self, rest: Sequence[str], entry: str) -> list[VariedField]:
        if self.task is None:
            raise VaryPathError("the twin is a scene, which has no `disturbances`", "name a task as the `twin`")
        keys = ("disturbances", *rest)
        found = [self._field("task", path, owner) for path, owner in _walk(self.task, keys)]
        kinds: dict[str, Effect] = {"action": "action", "observation": "observation"}
        found = [replace(field, effect=kinds[field.places[0].path[1]]) for field in found]
        return _needed(found, self.task, keys, entry)

    def _of_parameters(self, rest: Sequence[str], entry: str) -> list[VariedField]:
        known = self.scene.parameters
        names = [name for name in known if len(rest) == 1 and fnmatchcase(name, rest[0])]
        if not names:
            hint = nearest(rest[0], known) if rest and known else "write `parameter.NAME`"
            raise VaryPathError(f"no parameter of the twin has the path `{entry}`", hint)
        places = {name: VariedPlace("scene", ("parameters", name), float(known[name])) for name in names}
        return [VariedField(f"parameter.{name}", ValueKind.NUMBER, (place,)) for name, place in places.items()]

    def _of_scene(self, head: str, rest: Sequence[str], entry: str) -> list[VariedField]:
        if head == "background" and not rest:
            place = VariedPlace("scene", ("background", "mesh"), self.spec.background)
            return [VariedField("background", ValueKind.BACKGROUND, (place,), "pictures")]
        if self.spec.background is None and head == "background":
            raise VaryPathError("the twin has no background", "write `background: {choose: [FILE]}`, or add one to it")
        found = [self._field("scene", path, owner) for path, owner in _walk(self.spec, (head, *rest))]
        return _needed(found, self.spec, (head, *rest), entry)

    def _of_section(self, head: str, rest: Sequence[str], entry: str) -> list[VariedField]:
        members: Mapping[str, Any] = getattr(self.spec, SECTIONS[head])
        if not rest:
            raise VaryPathError(f"`{entry}` names no value", f"write a name and a key, such as `{head}.*.KEY`")
        names = [name for name in members if fnmatchcase(name, rest[0])]
        if not names:
            some = nearest(rest[0], members) if members else f"the twin has no {SECTIONS[head]}"
            raise VaryPathError(f"no {head} of the twin is called `{rest[0]}`", some)
        if len(rest) == 1:
            keys = [key for key in type(members[names[0]]).model_fields if value_kind(type(members[names[0]]), key)]
            article = "an" if head == "object" else "a"
            raise VaryPathError(
                f"`{entry}` is {article} {head}, not a value", f"append a key, such as `{entry}.{keys[0]}`"
            )
        found: list[VariedField] = []
        for name in names:
            if head == "object" and "*" in rest[0] and rest[1] in ("mass", "density") and self.spec.objects[name].fixed:
                continue  # objects that are welded to the world have no mass in effect
            if head == "object":
                found += self._of_object(name, rest[1:])
            elif head == "robot" and rest[1] == "joints":
                found += self._of_arm(name, members[name], rest[2:])
            else:
                at = (SECTIONS[head], name)
                found += [self._field("scene", (*at, *p), owner, name) for p, owner in _walk(members[name], rest[1:])]
        return _needed(found, members[names[0]], rest[1:], entry)

    def _field(self, document: str, path: DocumentPath, owner: BaseModel, name: str = "") -> VariedField:
        """Return the field of a model as a value that varies."""
        kind = value_kind(type(owner), path[-1])
        if kind is None:
            message = "it is neither a number, a vector, a pose, a color, a file nor a text"
            below = _default(type(owner), path[-1])
            keys = list(type(below).model_fields) if below is not None else []
            hint = f"append a key, such as `{_shown(document, path)}.{keys[0]}`" if keys else ""
            raise VaryPathError(f"`{path[-1]}` cannot vary, because {message}", hint)
        if isinstance(owner, Estimate):
            whole = _shown(document, path[:-1])
            raise VaryPathError(f"`{_shown(document, path)}` is a part of an estimate", f"write `{whole}`")
        place = place_of(document, path, owner)
        integer = kind is ValueKind.NUMBER and all(k is not float for _, k in flat(field_type(type(owner), path[-1])))
        shown = _shown(document, path)
        return VariedField(shown, kind, (place,), self._effect(path, document), name, whole=integer)

    def _effect(self, path: DocumentPath, document: str) -> Effect:
        """Return what depends on a value. Left and right depend on the pose of the camera that defines them."""
        if path[-1] in PICTURE_KEYS or (document == "scene" and path[0] in ("lights", "background")):
            return "pictures"
        if document == "scene" and path[0] == "cameras":
            views = {item.place.seen_from for item in self.spec.objects.values() if item.place is not None}
            return (
                "physics" if path[1] in views | {self.spec.viewpoint} and path[2] in ("pose", "mount") else "pictures"
            )
        return "physics"

    # -- objects ------------------------------------------------------------------------------------------------------

    def _of_object(self, name: str, keys: Sequence[str]) -> Iterator[VariedField]:
        item, asset = self.spec.objects[name], self.asset(name)
        if list(keys) == ["height"]:
            place = VariedPlace("scene", ("objects", name, "pose"), item.pose)
            yield VariedField(f"object.{name}.height", ValueKind.HEIGHT, (place,), object=name)
        elif keys[0] == "asset" and len(keys) > 1:
            for path, owner in _walk(asset, keys[1:]) if asset is not None else ():
                yield self._field(f"{name}.asset", path, owner, name)
        elif asset is not None and keys[0] in OF_LINKS:
            yield from self._of_links(name, asset, keys)
        else:
            yield from self._of_body(name, item, keys)

    def _of_body(self, name: str, item: ObjectSpec, keys: Sequence[str]) -> Iterator[VariedField]:
        """Yield values of an object that is a shape or a mesh, from its selected variant if that states them."""
        at: DocumentPath = ("objects", name)
        owner: Any = item
        if item.variant in item.variants and keys[0] in item.variants[str(item.variant)].model_fields_set:
            owner, at = item.variants[str(item.variant)], (*at, "variants", str(item.variant))
        for path, model in _walk(owner, keys):
            found = self._field("scene", (*at, *path), model, name)
            if model is owner and isinstance(owner, BodySpec) and path[0] in OF_MATERIALS:
                place = inherited_place(found.places[0], item, path[0], self.spec.materials, self._as_density)
                yield VariedField(f"object.{name}.{path[0]}", found.kind, (place,), found.effect, name)
            else:
                yield VariedField(
                    f"object.{name}.{'.'.join(path)}", found.kind, found.places, found.effect, name, found.whole
                )

    def _of_links(self, name: str, asset: AssetSpec, keys: Sequence[str]) -> Iterator[VariedField]:
        """Yield a value that belongs to the links of an object's asset. All links share one draw."""
        if len(keys) > 1 or keys[0] not in LinkSpec.model_fields:
            return
        kind = value_kind(LinkSpec, keys[0])
        places = []
        for link, body in asset.links.items():
            place = place_of(f"{name}.asset", ("links", link, keys[0]), body)
            places.append(inherited_place(place, body, keys[0], asset.materials, self._as_density))
        if kind is not None:
            yield VariedField(f"object.{name}.{keys[0]}", kind, tuple(places), self._effect((keys[0],), ""), name)

    # -- joints -------------------------------------------------------------------------------------------------------

    def _of_joints(self, head: str, rest: Sequence[str], entry: str) -> list[VariedField]:
        names = [name for name in self.spec.objects if fnmatchcase(name, head)]
        if not names:
            first = nearest(head, [*SECTIONS, *SCENE_KEYS, "instruction", "disturbances", *self.spec.objects])
            raise VaryPathError(f"`{entry}` starts with `{head}`, which is neither a section nor an object", first)
        if not rest:
            hint = f"write `object.{entry}.KEY` or `{entry}.JOINT`"
            raise VaryPathError(f"`{entry}` is an object, not a value", hint)
        found: list[VariedField] = []
        joints: list[str] = []
        for name in names:
            asset = self.asset(name)
            joints += asset.single_joints if asset is not None else ()
            for joint in asset.single_joints if asset is not None else ():
                if fnmatchcase(joint, rest[0]):
                    found += self._of_joint(name, typing.cast(AssetSpec, asset), joint, rest[1:])
        if not found and any(fnmatchcase(joint, rest[0]) for joint in joints):
            raise VaryPathError(f"`{entry}` names no value of a joint", nearest(rest[-1], [*JointSpec.model_fields]))
        if not found:
            hint = nearest(rest[0], joints) if joints else f"for its other values, write `object.{head}.{rest[0]}`"
            raise VaryPathError(f"`{head}` has no joint `{rest[0]}`", hint)
        return found

    def _of_joint(self, name: str, asset: AssetSpec, joint: str, keys: Sequence[str]) -> Iterator[VariedField]:
        spec, shown = asset.single_joints[joint], f"{name}.{joint}"
        if keys and list(keys) != ["deg"]:
            at = _joint_path(asset, joint)
            for path, owner in _walk(spec, keys):
                found = self._field(f"{name}.asset", (*at, *path), owner, name)
                yield VariedField(f"{shown}.{'.'.join(path)}", found.kind, found.places, found.effect, name)
            return
        if spec.mimic is not None or spec.type not in ("revolute", "prismatic", "continuous"):
            return  # its leader determines its position, or its position is not a number
        turns, degrees = spec.type != "prismatic", bool(keys)
        if degrees and not turns:
            return
        starts = self.task.start.joints.get(name, {}) if self.task is not None else {}
        document, given = ("task", starts) if joint in starts else ("scene", self.spec.objects[name].joints)
        at = ("start", "joints", name, joint) if document == "task" else ("objects", name, "joints", joint)
        base = position(asset, joint, given)
        limits = spec.limits or spec.limits_deg or NO_ENDS
        if turns and not degrees:  # limits of joints that rotate are in degrees, and positions in radians
            limits = math.radians(limits[0]), math.radians(limits[1])
        place = VariedPlace(document, at, math.degrees(base) if degrees else base, limits)
        yield VariedField(
            f"{shown}.deg" if degrees else shown, ValueKind.JOINT, (place,), "physics", name, False, degrees, turns
        )

    def _of_arm(self, name: str, robot: RobotSpec, keys: Sequence[str]) -> Iterator[VariedField]:
        """Yield the positions of an arm's joints. Positions that the scene does not state are at home."""
        known = robot.known()
        home = dict(known.home) if known is not None else {}
        positions = home | ({} if isinstance(robot.joints, str) else dict(robot.joints))
        if not keys:
            if not positions:
                hint = f"write the positions of its joints under `robots.{name}.joints` in the scene"
                raise VaryPathError(f"the home positions of `{name}` are unknown", hint)
            place = VariedPlace("scene", ("robots", name, "joints"), positions)
            yield VariedField(f"robot.{name}.joints", ValueKind.ARM, (place,), object=name, turns=True)
            return
        for joint, value in positions.items() if len(keys) == 1 else ():
            if fnmatchcase(joint, keys[0]):
                place = VariedPlace("scene", ("robots", name, "joints", joint), value)
                shown = f"robot.{name}.joints.{joint}"
                yield VariedField(shown, ValueKind.JOINT, (place,), object=name, turns=True)


def _walk(value: Any, keys: Sequence[str], at: DocumentPath = ()) -> Iterator[tuple[DocumentPath, BaseModel]]:
    """Yield the path of each field that ``keys`` stand for below a model, with the model that has the field."""
    head, rest = keys[0], keys[1:]
    if isinstance(value, Mapping):
        for name in [name for name in value if rest and fnmatchcase(name, head)]:
            yield from _walk(value[name], rest, (*at, name))
    elif isinstance(value, BaseModel) and head in type(value).model_fields:
        if not rest:
            yield (*at, head), value
        else:
            below = getattr(value, head)
            yield from _walk(_default(type(value), head) if below is None else below, rest, (*at, head))


def _default(model: type[BaseModel], name: str) -> BaseModel | None:
    """Return the default of a model that a field can have, or None if it has required fields."""
    for _, kind in flat(field_type(model, name)):
        is_model = isinstance(kind, type) and issubclass(kind, BaseModel)
        if is_model and not any(info.is_required() for info in kind.model_fields.values()):
            return typing.cast(BaseModel, kind.model_construct())
    return None


def _needed(found: list[VariedField], example: BaseModel, keys: Sequence[str], entry: str) -> list[VariedField]:
    """Return the values that were found.

    Raises:
        VaryPathError: If there are none. The hint names the keys where the path leaves the documents.
    """
    if found:
        return found
    choices, word = list(type(example).model_fields), keys[0]
    value: Any = example
    for key in keys:
        word = key
        if isinstance(value, Mapping):
            choices, value = list(value), next((v for k, v in value.items() if fnmatchcase(k, key)), None)
        elif isinstance(value, BaseModel):
            choices, value = list(type(value).model_fields), getattr(value, key, None)
        else:
            break
        if value is None:
            break
    raise VaryPathError(f"no value of the twin has the path `{entry}`", nearest(word, choices))


def _joint_path(asset: AssetSpec, joint: str) -> DocumentPath:
    """Return the path of a joint, or of an axis of a joint with several axes."""
    if joint in asset.joints:
        return ("joints", joint)
    parent = next(name for name, found in asset.joints.items() if joint in found.axes)
    return ("joints", parent, "axes", joint)


def _shown(document: str, path: DocumentPath) -> str:
    """Return the path of a value as it is written in recipes."""
    singular = {section: word for word, section in SECTIONS.items()}
    if document.endswith(".asset"):
        return ".".join(("object", document, *path))
    return ".".join((singular.get(path[0], path[0]), *path[1:]))
