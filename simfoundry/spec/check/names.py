"""Check the names in conditions and places: objects, their parts and joints, and robots."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from typing import TYPE_CHECKING, Any

from simfoundry.spec.check.checker import Checker, Path_
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.expressions import ExpressionError, parse_call, texts
from simfoundry.spec.models.place import DEPTHS, SIDES, Place
from simfoundry.spec.models.scene import SceneSpec

if TYPE_CHECKING:
    from simfoundry.spec.models.asset import AssetSpec

EXAMPLE = "write it as `OnTop(cup, desk)` or `Closed(cabinet.drawer)`"


class SceneNames:
    """Names in a scene: ``objects`` and ``robots`` of its text, including faulty ones, and their parts."""

    def __init__(self, scene: Loaded, spec: SceneSpec | None) -> None:
        self.scene, self.spec = scene, spec
        data: Any = scene.document.data if scene.document is not None else {}
        self.objects, self.robots = (_mapping(data, section) for section in ("objects", "robots"))

    def asset(self, name: str) -> AssetSpec | None:
        """Return the asset document of the object ``name``; None if it has none or the document is invalid."""
        item = self.spec.objects.get(name) if self.spec is not None else None
        used = self.scene.used(item.asset) if item is not None and item.asset is not None else None
        if used is None:
            return None
        from simfoundry.spec.models.asset import AssetSpec

        return used.spec if isinstance(used.spec, AssetSpec) else None

    def is_known(self, name: str) -> bool:
        """Return True if the parts of the object ``name`` are known."""
        item = self.spec.objects.get(name) if self.spec is not None else None
        if item is None:
            return False
        used = self.scene.used(item.asset) if item.asset is not None else None
        return used is None or used.spec is not None

    # -- findings -----------------------------------------------------------------------------------------------

    def check_call(self, c: Checker, text: str, path: Path_) -> None:
        """Check one predicate."""
        try:
            call = parse_call(text)
        except ExpressionError as error:
            c.add("SF202", path, str(error), nearest(error.word, error.choices) or EXAMPLE)
            return
        things = [a for a, kind in zip(call.args, call.kinds, strict=True) if kind in ("thing", "body")]
        if len(things) == 2 and self._overlap(*things):
            both = (
                f"`{things[0]}` is given for both" if things[0] == things[1] else "one of these is a part of the other"
            )
            message = f"`{call.predicate}` relates two objects, and {both}"
            c.add("SF202", path, message, f"{call.predicate}: {call.declaration.meaning}")
        for argument, kind in zip(call.args, call.kinds, strict=True):
            match kind:
                case "robot":
                    c.name(argument, self.robots, path, "robot")
                case "joint":
                    self.check_joint(c, argument, path)
                case "body" if argument.partition(".")[0] in self.robots:
                    pass
                case "body" | "thing":
                    self.check_part(c, argument, path)

    def _overlap(self, a: str, b: str) -> bool:
        """Return True if two arguments share a link: one contains the other, or one is a joint that moves the other."""
        (owner, _, one), (other, _, two) = a.partition("."), b.partition(".")
        asset = self.asset(owner)
        if asset is not None:
            one, two = (asset.joints[part].child if part in asset.joints else part for part in (one, two))
        return owner == other and (not one or not two or one == two)

    def check_condition(self, c: Checker, condition: Any, path: Path_) -> None:
        """Check a condition."""
        for text, below in texts(condition):
            self.check_call(c, text, (*path, *below))

    def check_part(self, c: Checker, argument: str, path: Path_) -> None:
        """Check the name of an object, of one of its links, or of one of its joints (the link that it moves)."""
        name, _, part = argument.partition(".")
        if c.name(name, self.objects, path, "object") and part:
            asset = self.asset(name)
            if asset is not None:
                c.name(part, [*asset.links, *asset.joints], path, f"link or joint of `{name}`")
            elif self.is_known(name):
                c.add("SF201", path, f"`{name}` has no parts, so none is called `{part}`")

    def check_joint(self, c: Checker, argument: str, path: Path_) -> None:
        """Check the name of an object with joints, or of one of its joints."""
        name, _, joint = argument.partition(".")
        if not c.name(name, self.objects, path, "object"):
            return
        asset = self.asset(name)
        moving = [n for n, j in asset.joints.items() if j.type != "fixed"] if asset is not None else []
        if joint and asset is not None and asset.joints:
            c.name(joint, asset.joints, path, f"joint of `{name}`")
        elif not moving and self.is_known(name):
            c.add("SF201", path, f"`{name}` has no joints" + (f", so none is called `{joint}`" if joint else ""))

    def check_place(self, c: Checker, name: str, place: Place, path: Path_) -> None:
        """Check the names in the place of the object ``name``."""
        for key in ("on", "inside"):
            carrier: str | None = getattr(place, key)
            if carrier is not None:
                self.check_part(c, carrier, (*path, key))
        for key in (*SIDES, *DEPTHS):
            anchor: str | None = getattr(place, key)
            if anchor is not None:
                c.name(anchor, self.objects, (*path, key), "object")

    def check_order(self, c: Checker, places: Mapping[str, Place], paths: Mapping[str, Path_]) -> None:
        """Check that no place depends on itself through other places."""
        needs = _unsolved({name: _needs(place) & places.keys() for name, place in places.items()})
        for name in needs:
            cycle = _cycle(name, needs)
            if cycle:
                shown = " → ".join(f"`{n}`" for n in (*cycle, name))
                hint = "give one of them a `pose`, or place it on something else"
                c.add("SF208", paths[name], f"the place of `{name}` depends on itself: {shown}", hint)


def _needs(place: Place) -> set[str]:
    named = (place.on, place.inside, place.left_of, place.right_of, place.in_front_of, place.behind)
    return {name.partition(".")[0] for name in named if name is not None}


def _unsolved(needs: Mapping[str, set[str]]) -> dict[str, set[str]]:
    """Return the entries that cannot be resolved: cycles, and entries that depend on them."""
    waiting = {name: len(needed) for name, needed in needs.items()}
    wanted: dict[str, list[str]] = {}
    for name, needed in needs.items():
        for other in needed:
            wanted.setdefault(other, []).append(name)
    free = [name for name, count in waiting.items() if count == 0]
    while free:
        for name in wanted.get(free.pop(), ()):
            waiting[name] -= 1
            if waiting[name] == 0:
                free.append(name)
    return {name: needs[name] for name, count in waiting.items() if count}


def _cycle(name: str, needs: Mapping[str, Collection[str]]) -> tuple[str, ...]:
    """Return the path from ``name`` back to itself; empty if there is none."""
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


def _mapping(data: Any, section: str) -> dict[str, Any]:
    members = data.get(section) if isinstance(data, dict) else None
    return members if isinstance(members, dict) else {}
