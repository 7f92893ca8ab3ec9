"""Complete objects, and templates themselves, with the templates that they name."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from simfoundry.spec.compose.join import Fault, Joining, Member, members
from simfoundry.spec.diagnostics import nearest, similar_fixes
from simfoundry.spec.models.reuse import MAX_DEPTH
from simfoundry.spec.yaml.nodes import Node


@dataclass(frozen=True)
class Generated:
    """A member that was written out, or completed by a template.

    Attributes:
        source: The member that it comes from: a repeated object, a template, or an include.
        value: Its data without the entry that changes it.
    """

    source: Member
    value: Any


def with_templates(
    root: Node, joining: Joining, generated: Mapping[Member, Generated], fault: Fault
) -> tuple[Node, dict[Member, Generated]]:
    """Return a document whose objects are completed by templates, and what was written out so far."""
    keys, found = members(root), dict(generated)
    objects = keys.get("objects")
    if objects is None or not isinstance(objects.children, dict):
        return root, found
    templates = _Templates(members(keys.get("templates")), joining, fault)
    new = {}
    for name, item in objects.children.items():
        new[name] = item
        like = members(item).get("like")
        template = templates.resolve(like, ("objects", name, "like"), ()) if like is not None else None
        if like is not None and template is not None:
            new[name] = joining.join(template, without(item, "like"), ("objects", name))
            found.setdefault(("objects", name), Generated(("templates", str(like.value)), template.value))
    return root.with_members({**keys, "objects": objects.with_members(new)}), found


def without(node: Node, key: str) -> Node:
    """Return a mapping without one of its keys."""
    return node.with_members({name: child for name, child in members(node).items() if name != key})


@dataclass
class _Templates:
    """The templates of a document, and those that are completed already."""

    written: Mapping[str, Node]
    joining: Joining
    fault: Fault
    resolved: dict[str, Node | None] = field(default_factory=dict)

    def resolve(self, like: Node, path: tuple[str | int, ...], users: tuple[str, ...]) -> Node | None:
        """Return a template that is completed by the templates that it names, or None if that is not possible."""
        name = like.value
        if not isinstance(name, str):
            return None  # reported by the type check
        if name in users:
            cycle = " is like ".join(f"`{each}`" for each in (*users[users.index(name) :], name))
            self.fault("SF207", like, path, f"{cycle}, which is a cycle", "remove `like` from one of them")
            return None
        if len(users) > MAX_DEPTH:
            self.fault("SF005", like, path, f"the chain of `like` has more than {MAX_DEPTH} templates", "")
            return None
        if name not in self.written:
            hint = nearest(name, self.written) if self.written else "define it under `templates`"
            fixes = similar_fixes(name, self.written)
            self.fault("SF201", like, path, f"no template is called `{name}`", hint, fixes)
            return None
        if name not in self.resolved:
            template = self.written[name]
            inner = members(template).get("like")
            self.resolved[name] = template if isinstance(template.children, dict) else None
            if inner is not None:
                base = self.resolve(inner, ("templates", name, "like"), (*users, name))
                over = without(template, "like")
                joined = None if base is None else self.joining.join(base, over, ("templates", name))
                self.resolved[name] = joined
        return self.resolved[name]
