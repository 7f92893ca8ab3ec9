"""Write out what a scene reuses: parameters, included scenes, templates, and repeated objects.

Each value of the result keeps the position at which it was written, so that findings about a copy point to the line
that a person wrote. An entry with the name of a copy or of an included member changes that member only.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Collection, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import ValidationError

from simfoundry.spec.compose.copies import Group, copied_object, group, is_centered, repeat_of, states_position
from simfoundry.spec.compose.include import IncludedScene, included_scene
from simfoundry.spec.compose.join import LISTS, SCENE, SECTIONS, Joining, Member, members
from simfoundry.spec.compose.lists import with_copied_lists
from simfoundry.spec.compose.templates import Generated, with_templates, without
from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity, SpecError, nearest, similar_fixes
from simfoundry.spec.models.reuse import MAX_DEPTH, IncludeSpec
from simfoundry.spec.yaml.nodes import MAX_NODES, Node
from simfoundry.spec.yaml.text import Document, Path_

if TYPE_CHECKING:
    from simfoundry.spec.compose.compose import Composed

# End of the name of a copy.
INDICES = re.compile(r"(?:_[0-9]+){1,4}\Z")

# Function that reads and composes the scene of an include, given its node and path, the file, and the parameters.
ReadScene = Callable[[Node, tuple[str | int, ...], str, Mapping[str, float]], "Composed"]


@dataclass(frozen=True)
class Reuse:
    """A record of what was written out.

    Attributes:
        written: The data of the document before anything was written out.
        generated: The members that were written out, by section and name.
        groups: The copies of repeated objects, by the name of the object.
        files: The files of included scenes.
        unresolved: Files, lines and columns of expressions that could not be evaluated, for a reason reported
            elsewhere.
    """

    written: Any
    generated: Mapping[Member, Generated]
    groups: Mapping[str, Group]
    files: tuple[Path, ...]
    unresolved: tuple[tuple[str, int, int], ...] = ()

    def base_name(self, name: str) -> str:
        """Return the name of an object without the prefixes of includes and the indices of copies."""
        group = next((each for each, found in self.groups.items() if found.has(name)), name)
        source = self.generated.get(("objects", name))
        include = source.source[1] if source is not None and source.source[0] == "include" else ""
        return group.removeprefix(f"{include}_") if include else group

    def source(self, section: str, name: str) -> Member | None:
        """Return the repeated object or the include that a member comes from, or None if it was written itself."""
        found = self.generated.get((section, name))
        return found.source if found is not None and found.source[0] != "templates" else None


def expand(
    document: Document,
    removals: Mapping[Path_, Diagnostic | None],
    replaced: Mapping[str, Collection[str]],
    parameters: Mapping[str, float],
    read_scene: ReadScene,
) -> tuple[Document, list[Diagnostic], Reuse]:
    """Write out what a scene reuses.

    Anything that cannot be written out is left as it is, with a finding, or because the type check reports it.

    Args:
        document: The document, joined with its bases.
        removals: Entries that remove values; see :class:`simfoundry.spec.compose.join.Joining`.
        replaced: For each list that an overlay replaces, the includes whose items are dropped as well.
        parameters: Values that replace those of the document's parameters.
        read_scene: Reads the scene of an include.
    """
    work = _Expansion(document, Joining(SCENE, document.file, removals=dict(removals)), replaced, read_scene)
    root = document.root
    if isinstance(root.children, dict):
        root = work.with_parameters(root, parameters)
        root = work.with_includes(root)
        root, work.generated = with_templates(root, work.joining, work.generated, work.fault)
        root = work.with_copies(root)
        root = work.without_removals(root)
    reuse = Reuse(document.data, work.generated, work.groups, tuple(work.files), tuple(work.unresolved))
    added, texts = document.added | work.joining.added, {**work.texts, **document.texts}
    expanded = replace(document, data=root.value, root=root, added=added, texts=texts)
    return expanded, [*work.findings, *work.joining.findings], reuse


@dataclass
class _Expansion:
    document: Document
    joining: Joining
    replaced: Mapping[str, Collection[str]]
    read_scene: ReadScene
    findings: list[Diagnostic] = field(default_factory=list)
    generated: dict[Member, Generated] = field(default_factory=dict)
    groups: dict[str, Group] = field(default_factory=dict)
    files: list[Path] = field(default_factory=list)
    removed: set[str] = field(default_factory=set)
    unresolved: list[tuple[str, int, int]] = field(default_factory=list)
    texts: dict[str, str] = field(default_factory=dict)

    def fault(
        self,
        code: str,
        node: Node,
        path: tuple[str | int, ...],
        message: str,
        hint: str = "",
        fixes: tuple[Fix, ...] = (),
    ) -> None:
        """Add an error at a node."""
        place = (node.file or self.document.file, node.line, node.column, ".".join(map(str, path)), hint)
        self.findings.append(Diagnostic(code, Severity.ERROR, message, *place, fixes=fixes))

    # -- parameters -------------------------------------------------------------------------------------------------

    def with_parameters(self, root: Node, given: Mapping[str, float]) -> Node:
        """Replace expressions by their values."""
        from simfoundry.spec.compose.parameters import Substitution, parameter_values

        keys = members(root)
        section = keys.get("parameters")
        for name in given.keys() - members(section).keys():
            hint = nearest(name, members(section)) if members(section) else "the scene does not define any"
            self.fault("SF201", section or root, ("parameters",), f"no parameter is called `{name}`", hint)
        solved = parameter_values(members(section), given, self.document.file)
        values = solved.values
        known = section is None or isinstance(section.children, dict)
        names = members(section) if known else None
        substitution = Substitution(values, self.document.file, names, solved.findings, solved.unresolved)
        new = {key: node if key == "parameters" else substitution.apply(node, (key,)) for key, node in keys.items()}
        self.findings += substitution.findings
        self.unresolved += substitution.unresolved
        if section is not None and isinstance(section.children, dict):
            numbers = {
                name: replace(node, value=values[name], plain="") if name in values else node
                for name, node in section.children.items()
            }
            new["parameters"] = section.with_members(numbers)
        return root.with_members(new)

    # -- includes ---------------------------------------------------------------------------------------------------

    def with_includes(self, root: Node) -> Node:
        """Add the members of included scenes. Entries of this scene with the same names change them."""
        scenes: list[IncludedScene] = []
        for name, node in members(members(root).get("include")).items():
            path = ("include", name)
            try:
                include = IncludeSpec.model_validate(node.value)
                composed = self.read_scene(node, path, include.scene, include.parameters)
            except ValidationError:
                continue  # reported by the type check
            except SpecError as error:
                self.findings += error.diagnostics
                continue
            at = members(node).get("parameters", node)
            is_sound = isinstance(composed.document.data.get("parameters", {}), dict)
            for d in composed.findings:
                if is_sound and d.code == "SF201" and d.path == "parameters":  # an unknown parameter, written here
                    unknown = next((n for n in members(at) if f"`{n}`" in d.message), "")
                    line, column = at.keys.get(unknown, at.place)
                    self.findings.append(
                        replace(
                            d,
                            file=at.file or self.document.file,
                            line=line,
                            column=column,
                            path=".".join((*path, "parameters")),
                            word=unknown,
                        )
                    )
                else:
                    self.findings.append(d)
            scenes.append(included_scene(name, node, include, composed.document.root))
            for message, hint in scenes[-1].faults:
                self.fault("SF107", node, path, message, hint)
            reuse = composed.reuse
            self.files += [Path(composed.document.file), *composed.bases, *(reuse.files if reuse is not None else ())]
            self.unresolved += reuse.unresolved if reuse is not None else ()
            self.texts |= {composed.document.file: composed.document.text, **composed.document.texts}
            for inner, copies in reuse.groups.items() if reuse is not None else ():
                self.groups[f"{name}_{inner}"] = copies.renamed(name)
        return self._joined(root, scenes) if scenes else root

    def _joined(self, root: Node, scenes: list[IncludedScene]) -> Node:
        """Return a document with the content of included scenes before its own."""
        keys, places = dict(members(root)), dict(root.keys)
        for section in SECTIONS:
            theirs = [(scene.name, part) for scene in scenes if (part := scene.sections.get(section)) is not None]
            if theirs and (section not in keys or isinstance(keys[section].children, dict)):
                keys[section] = self._joined_section(section, theirs, keys.get(section))
                places.setdefault(section, keys[section].place)
        for key in LISTS:
            own = keys.get(key)
            added = [scene for scene in scenes if scene.name not in self.replaced.get(key, ())]
            items = [item for scene in added for item in scene.lists.get(key, ())]
            if items and (own is None or isinstance(own.children, list)):
                mine = own.children if own is not None and isinstance(own.children, list) else []
                keys[key] = (own or scenes[0].at).with_members([*items, *mine])
                places.setdefault(key, scenes[0].at.place)
        for allow in (scene.allow for scene in scenes if scene.allow is not None):
            own = keys.get("allow")
            keys["allow"] = allow if own is None else self.joining.join(allow, own, ("allow",))
            places.setdefault("allow", allow.place)
        return root.with_members(keys, places)

    def _joined_section(self, section: str, theirs: list[tuple[str, Node]], own: Node | None) -> Node:
        new, places = dict[str, Node](), dict(own.keys if own is not None else {})
        overs = dict(members(own))
        for include, part in theirs:
            for name, node in members(part).items():
                self.generated[section, name] = Generated(("include", include), node.value)
                places.setdefault(name, part.keys[name])
                over = overs.pop(name, None)
                if over is None:
                    new[name] = node
                elif over.value is not None:
                    new[name] = self.joining.join(node, over, (section, name))
                else:
                    self.removed.add(name)
                    self.joining.removals.pop((section, name), None)
        return (own if own is not None else theirs[0][1]).with_members({**new, **overs}, places)

    # -- copies -----------------------------------------------------------------------------------------------------

    def with_copies(self, root: Node) -> Node:
        """Replace each repeated object by its copies. Entries with the name of a copy change this copy."""
        keys = members(root)
        objects = keys.get("objects")
        items = dict(members(objects))
        own: dict[str, Group] = {}
        for name, item in items.items():
            self._add_group(name, item, items, own, ())
        if objects is None or not own:
            return with_copied_lists(root, self.groups, self.removed, self.fault)
        self._within_limit(items, own, root.weight)
        own = self._without_removed(items, own)
        self.groups |= own
        copies = {copy.name for found in own.values() for copy in found.copies}
        new, places = dict[str, Node](), dict(objects.keys)
        for name in own:
            self.generated.pop(("objects", name), None)  # its template is part of the copies
        self._check_unknown_copies(items, own, copies)
        for name, item in items.items():
            for copy, node in self._copies(name, item, own[name], items).items() if name in own else ():
                self.generated["objects", copy] = Generated(("objects", name), node.value)
                places.setdefault(copy, objects.keys[name])
                if copy in new:
                    self.fault(
                        "SF213", item, ("objects", name), f"two copies are both called `{copy}`", f"rename `{name}`"
                    )
                over = items.get(copy)
                new[copy] = node if over is None else self.joining.join(node, over, ("objects", copy))
            if name not in own and name not in copies:
                new[name] = item
        root = root.with_members({**keys, "objects": objects.with_members(new, places)})
        return with_copied_lists(root, self.groups, self.removed, self.fault)

    def _without_removed(self, items: dict[str, Node], own: Mapping[str, Group]) -> dict[str, Group]:
        """Drop the copies that an entry removes, and the copies that repeat with them unless they have an entry."""
        gone: dict[str, set[tuple[int, ...]]] = {}
        for name, found in own.items():
            removed = [copy for copy in found.copies if copy.name in items and items[copy.name].value is None]
            gone[name] = {copy.index for copy in removed}
            for copy in removed:
                del items[copy.name]
                self.removed.add(copy.name)
                self.joining.removals.pop(("objects", copy.name), None)
        for name, found in own.items():
            followed = [
                copy for copy in found.copies if copy.index in gone.get(found.root, ()) and copy.name not in items
            ]
            gone[name] |= {copy.index for copy in followed}
            self.removed.update(copy.name for copy in followed)
        return {name: found.without(gone[name]) for name, found in own.items()}

    def _check_unknown_copies(self, items: dict[str, Node], own: Mapping[str, Group], copies: set[str]) -> None:
        """Report entries for copies that do not exist, and drop those of a base, since an overlay may repeat less."""
        for name, item in [*items.items()]:
            stem = INDICES.sub("", name)
            group = stem if stem in own and stem != name else None
            if group is None or name in copies or not own[group].copies or {"shape", "asset"} & members(item).keys():
                continue
            del items[name]
            known = own[group].copies
            if not item.file:
                message = f"`{group}` has no copy called `{name}`"
                hint = f"its copies are `{known[0].name}` to `{known[-1].name}`"
                self.fault("SF201", item, ("objects", name), message, hint)
            self.joining.removals.pop(("objects", name), None)

    def _add_group(
        self, name: str, item: Node, items: Mapping[str, Node], own: dict[str, Group], users: tuple[str, ...]
    ) -> None:
        """Add the copies of an object if it is repeated, and of the object that it repeats with."""
        repeat = members(item).get("repeat")
        if repeat is None or name in own:
            return
        path = ("objects", name, "repeat")
        if not isinstance(repeat.value, str):
            found = repeat_of(repeat)
            if found is not None:
                own[name] = group(name, name, found, is_centered(item))
            return
        leader = repeat.value
        if leader in (*users, name):
            self.fault("SF207", repeat, path, f"`{name}` repeats with itself", "give one of them a `count`")
            return
        if len(users) > MAX_DEPTH:
            self.fault("SF005", repeat, path, f"the chain of `repeat` has more than {MAX_DEPTH} objects")
            return
        if leader not in items:
            message, fixes = f"no object is called `{leader}`", similar_fixes(leader, items)
            self.fault("SF201", repeat, path, message, nearest(leader, items), fixes)
            return
        self._add_group(leader, items[leader], items, own, (*users, name))
        if leader in own:
            same = own[leader]
            beside = group(name, same.root, same.repeat, centered=False)
            own[name] = replace(beside, copies=tuple(replace(copy, offset=(0.0, 0.0, 0.0)) for copy in beside.copies))
        elif "repeat" not in members(items[leader]):
            message = f"`{leader}` is not repeated, so `{name}` cannot repeat with it"
            self.fault("SF201", repeat, path, message, "give `count` and `step` instead")

    def _within_limit(self, items: Mapping[str, Node], own: dict[str, Group], weight: int) -> None:
        """Drop repetitions that would make the document too large."""
        for name, found in [*own.items()]:
            weight += len(found.copies) * items[name].weight
            if weight > MAX_NODES:
                message = f"with the copies of `{name}`, the document has more than {MAX_NODES} values"
                self.fault("SF005", items[name], ("objects", name), message, "reduce `count`")
                for each in [each for each, other in own.items() if other.root == found.root]:
                    del own[each]
                return

    def _copies(self, name: str, item: Node, found: Group, items: Mapping[str, Node]) -> dict[str, Node]:
        """Return the nodes of the copies of an object, without the entries that change them."""
        item = without(item, "repeat")
        beside = [(other, same) for other, same in self.groups.items() if same.root == found.root and other != name]
        out = dict[str, Node]()
        for copy in found.copies:
            below = None
            if found.root == name and found.repeat.stack is not None and copy.index[-1] > 1:
                below = f"{name}_{'_'.join(map(str, (*copy.index[:-1], copy.index[-1] - 1)))}"
            names = {other: same.named(copy.index) for other, same in beside}
            if states_position(items.get(copy.name)):  # it is not an offset from the position of the first copy
                copy = replace(copy, offset=(0.0, 0.0, 0.0))
            out[copy.name] = copied_object(item, copy, below, {key: new for key, new in names.items() if new})
        return out

    # -- removals ---------------------------------------------------------------------------------------------------

    def without_removals(self, root: Node) -> Node:
        """Drop entries that remove a value of a base, and report those that have nothing to remove."""
        for path, finding in self.joining.removals.items():
            node = root
            for part in path:
                node = members(node).get(str(part)) or Node((), 0, 0)
            if node.value is None:
                root = _removed(root, path)
                if finding is not None:
                    self.findings.append(finding)
        return root


def _removed(node: Node, path: Path_) -> Node:
    """Return a mapping without the value at a path."""
    children = dict(members(node))
    part = str(path[0])
    if len(path) > 1:
        children[part] = _removed(children[part], path[1:])
    else:
        del children[part]
    return node.with_members(children)
