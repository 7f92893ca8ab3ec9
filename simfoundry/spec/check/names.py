"""Check names in scenes: objects and their parts, robots, and the names in predicates and places."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from contextlib import suppress
from graphlib import CycleError, TopologicalSorter
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.check.frames import check_reference
from simfoundry.spec.diagnostics import nearest, similar_fixes
from simfoundry.spec.files import Loaded, is_document
from simfoundry.spec.models.predicate import ExpressionError, argument_indices, parse_call, texts
from simfoundry.spec.models.reuse import FramedPose, frame_carrier
from simfoundry.spec.models.scene import (
    PLACE_REFERENCES,
    ObjectSpec,
    Place,
    SceneSpec,
    variant_of,
)
from simfoundry.spec.yaml.text import Mark

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec


def asset_in(used: Loaded | None) -> AssetSpec | None:
    """Return the asset in a document that a scene uses, or None if the document is invalid or of another kind."""
    if used is None:
        return None
    from simfoundry.spec.models.asset import AssetSpec

    return used.spec if isinstance(used.spec, AssetSpec) else None


EXAMPLE = "write it as `OnTop(cup, desk)` or `Closed(cabinet.drawer)`"


def _selected(item: ObjectSpec) -> ObjectSpec:
    """Return the variant of an object that a scene selects, or the object itself if the variant is invalid."""
    if item.variant in item.variants:
        with suppress(ValidationError):
            return variant_of(item, str(item.variant))
    return item


class SceneNames:
    """Names in a scene, including those of invalid objects, robots, frames and cameras, and their parts."""

    def __init__(self, scene: Loaded, spec: SceneSpec | None) -> None:
        assert scene.document is not None
        self.scene, self.spec = scene, spec
        self.objects, self.robots, self.frames, self.cameras = (
            scene.document.section(name) for name in ("objects", "robots", "frames", "cameras")
        )
        self._items = {name: _selected(item) for name, item in spec.objects.items()} if spec is not None else {}

    def asset(self, name: str) -> AssetSpec | None:
        """Return the asset document of an object, or None if the document does not exist or is invalid."""
        return asset_in(self._used(name))

    def is_fixed(self, name: str) -> bool:
        """Return True if an object is fixed to the world."""
        return name in self._items and self._items[name].fixed

    def is_known(self, name: str) -> bool:
        """Return True if the parts of an object are known."""
        used = self._used(name)
        return name in self._items and (used is None or used.spec is not None)

    def _used(self, name: str) -> Loaded | None:
        reference = self._items[name].asset if name in self._items else None
        return self.scene.used(reference) if reference is not None else None

    def links(self, name: str) -> set[str]:
        """Return the links that an object has in any of its variants. Cameras are mounted on those that exist."""
        item = self.spec.objects.get(name) if self.spec is not None else None
        given = [item, *item.variants.values()] if item is not None else []
        references = [each.asset for each in given if each.asset is not None and is_document(each.asset)]
        assets = [asset_in(self.scene.used(reference)) for reference in references]
        return {link for asset in assets if asset is not None for link in asset.links}

    # -- findings -----------------------------------------------------------------------------------------------

    def check_call(self, c: Checker, text: str, path: Path_) -> None:
        """Check one predicate."""
        try:
            call = parse_call(text)
        except ExpressionError as error:
            fixes = error.fixes or (similar_fixes(error.word, self.objects) if error.word[:1].isalpha() else ())
            mark = Mark(error.word, error.index, fixes)
            hint = error.hint or (nearest(error.word, self.objects) if fixes else EXAMPLE)
            c.add("SF202", path, error.message, hint, mark=mark)
            return
        things = [a for a, kind in zip(call.args, call.kinds, strict=True) if kind in ("thing", "body")]
        if len(things) == 2 and self._overlap(*things):
            same = f"`{things[0]}` is used for both" if len({*things}) == 1 else "one of these is a part of the other"
            message = f"`{call.predicate}` relates two different objects, but {same}"
            c.add("SF202", path, message, f"{call.predicate}: {call.declaration.meaning}")
        for argument, kind, index in zip(call.args, call.kinds, argument_indices(text), strict=True):
            match kind:
                case "robot":
                    c.name(argument, self.robots, path, "robot", index)
                case "joint":
                    self.check_joint(c, argument, path, index)
                case "body" if argument.partition(".")[0] in self.robots:
                    pass
                case "body" | "thing":
                    self.check_part(c, argument, path, index)

    def _overlap(self, a: str, b: str) -> bool:
        """Return True if two arguments share a link.

        This is the case if one of them contains the other, or is a joint that moves the other.
        """
        (owner, _, one), (other, _, two) = a.partition("."), b.partition(".")
        asset = self.asset(owner)
        if asset is not None:
            one, two = (asset.single_joints[part].child if part in asset.single_joints else part for part in (one, two))
        return owner == other and (not one or not two or one == two)

    def check_condition(self, c: Checker, condition: Any, path: Path_) -> None:
        """Check a condition."""
        for text, below in texts(condition):
            self.check_call(c, text, (*path, *below))

    def check_part(self, c: Checker, argument: str, path: Path_, index: int = 0) -> None:
        """Check the name of an object, a link, or a joint. A joint stands for the link that it moves.

        The name stands at ``index`` in the string at ``path``.
        """
        name, dot, part = argument.partition(".")
        inner = index + len(name + dot)
        if c.name(name, self.objects, path, "object", index) and part:
            asset = self.asset(name)
            if asset is not None:
                c.name(part, [*asset.links, *asset.single_joints], path, f"link or joint of `{name}`", inner)
            elif self.is_known(name):
                message = f"`{name}` does not have any parts, so there is no part `{part}`"
                c.add("SF201", path, message, mark=Mark(part, inner))

    def check_link(self, c: Checker, argument: str, path: Path_, with_parts: bool = False) -> None:
        """Check the name of an object, or of a link. Here, a joint does not stand for the link that it moves.

        If ``with_parts`` is set, the name of a part of a link is valid as well.
        """
        name, _, part = argument.partition(".")
        asset = self.asset(name)
        if part and name in self.objects and asset is not None:
            inner = [piece for link in asset.links.values() for piece in link.parts] if with_parts else []
            what = f"link or part of `{name}`" if with_parts else f"link of `{name}`"
            c.name(part, [*asset.links, *inner], path, what, len(name) + 1)
        else:
            self.check_part(c, argument, path)

    def check_joint(self, c: Checker, argument: str, path: Path_, index: int) -> None:
        """Check the name of an object with joints, or of one of its joints, that have limits and so can be closed.

        The name stands at ``index`` in the string at ``path``.
        """
        name, dot, joint = argument.partition(".")
        if not c.name(name, self.objects, path, "object", index):
            return
        inner = index + len(name + dot)
        asset = self.asset(name)
        joints = asset.single_joints if asset is not None else {}
        moving = [n for n, each in joints.items() if each.type != "fixed"]
        limited = [n for n in moving if joints[n].type in ("prismatic", "revolute")]
        if joint and joints:
            if c.name(joint, joints, path, f"joint of `{name}`", inner) and joint not in limited:
                message = f"`{joint}` is a {joints[joint].type} joint without limits, so it has no closed position"
                hint = nearest("", limited) if limited else "use a joint with limits"
                c.add("SF201", path, message, hint, mark=Mark(joint, inner))
        elif moving and not limited:
            message = f"no joint of `{name}` has limits, so its closed position is undefined"
            c.add("SF201", path, message, mark=Mark(name, index))
        elif not moving and self.is_known(name):
            so = f", so there is no joint `{joint}`" if joint else ""
            mark = Mark(joint, inner) if joint else Mark(name, index)
            c.add("SF201", path, f"`{name}` does not have any joints{so}", mark=mark)

    def check_places(self, c: Checker, places: Mapping[str, Place | FramedPose], paths: Mapping[str, Path_]) -> None:
        """Check the names in the places of objects, and that no place depends on itself through other places."""
        needs: dict[str, set[str]] = {}
        frames = self.spec.frames if self.spec is not None else {}
        for name, place in places.items():
            carrier = frame_carrier(frames, place.frame)
            named = [carrier] if carrier is not None else []
            if isinstance(place, Place):
                named += self._check_place(c, place, paths[name])
            needs[name] = {other.partition(".")[0] for other in named} & places.keys()
        needs = _unsolved(needs)
        for name in needs:
            cycle = _cycle(name, needs)
            if cycle:
                shown = " → ".join(f"`{n}`" for n in (*cycle, name))
                hint = "give one of them a `pose`, or place it on something else"
                key = _key_for((*cycle, name)[1], places[name])
                c.add("SF208", (*paths[name], key), f"the place of `{name}` depends on itself: {shown}", hint)

    def _check_place(self, c: Checker, place: Place, path: Path_) -> list[str]:
        """Check the names in a place, and return the objects to which it refers."""
        named = {key: other for key in PLACE_REFERENCES if (other := getattr(place, key)) is not None}
        for key, other in named.items():
            if key in ("on", "inside"):
                self.check_link(c, other, (*path, key), with_parts=True)
            else:
                c.name(other, self.objects, (*path, key), "object")
        if place.frame is not None:
            check_reference(c, self, place.frame, (*path, "frame"))
        if place.seen_from is not None:
            views = [*self.cameras, *self.robots, *self.frames]
            c.name(place.seen_from, views, (*path, "seen_from"), "camera, robot or frame")
        return list(named.values())


def _key_for(name: str, place: Place | FramedPose) -> str:
    """Return the key of a place or pose that refers to an object, directly or by a named frame."""
    given = {key: getattr(place, key) for key in (*PLACE_REFERENCES, "frame") if key in place.model_fields_set}
    return next((key for key, other in given.items() if (other or "").partition(".")[0] == name), "frame")


def _unsolved(needs: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the entries that cannot be resolved: cycles, and entries that depend on them."""
    sorter, solved = TopologicalSorter(needs), set[str]()
    with suppress(CycleError):  # the sorter still yields all entries that do not depend on a cycle
        sorter.prepare()
    while ready := sorter.get_ready():
        solved.update(ready)
        sorter.done(*ready)
    return {name: needed for name, needed in needs.items() if name not in solved}


def _cycle(name: str, needs: Mapping[str, Collection[str]]) -> tuple[str, ...]:
    """Return the path from ``name`` back to itself, or an empty path if it is not part of a cycle."""
    todo: list[tuple[str, ...]] = [(name,)]
    seen: set[str] = set()
    while todo:
        way = todo.pop(0)
        for following in sorted(needs.get(way[-1], ())):
            if following == name:
                return way
            if following not in seen:
                seen.add(following)
                todo.append((*way, following))
    return ()
