"""Edit the text of a document in place, leaving all unaffected bytes unchanged.

The changes from the current data to the target data are applied one at a time. Values are replaced in place, members
are removed together with the comments above them, and new members are inserted after their neighbor in canonical form.
If a change cannot be applied in place, for example because it affects an anchor that has aliases, the entire text is
rewritten in canonical form, and its comments are kept.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import suppress
from functools import cached_property, lru_cache, reduce
from typing import Any

from simfoundry.spec.change.diff.changes import Add, Change, Path_, Remove, Rename, Reorder, Set, diff, members, same
from simfoundry.spec.change.merge.conflict import ABSENT
from simfoundry.spec.models.base import Model
from simfoundry.spec.models.types import RIVALS, KeyOrder, key_order
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.spans import TextSpan, locate_values
from simfoundry.spec.yaml.spelling import call
from simfoundry.spec.yaml.text import Document, parse
from simfoundry.spec.yaml.tree import YamlTree, plain_tree, read_tree, with_data
from simfoundry.spec.yaml.write import WIDTH, entry_lines, inline_text, write_tree

_BOM = "\ufeff"
# Predicate that is quoted for other YAML readers, which split ``[OnTop(cup, desk)]`` at the comma.
_QUOTED_CALL = re.compile(r'"([A-Za-z]\w*\([\w., ]*\))"')


@lru_cache(maxsize=4)  # an editor edits the texts that its last edit has made, such as those of a task and its scene
def parsed_once(text: str) -> Document:
    """Parse a text, or return the same document as before. It must not be joined with others, which changes its nodes.

    Raises:
        YamlError: If the text could not be parsed.
    """
    return parse(text)


def prepare_edit(text: str) -> None:
    """Do in advance what the next edit of a text takes half of its time for; nothing if it cannot be parsed."""
    with suppress(YamlError):
        _spans(parsed_once(text.removeprefix(_BOM)).text)


def edit_text(text: str, data: Any, model: type[Model] | None) -> str:
    """Edit ``text`` so that it contains ``data``, leaving all unaffected bytes unchanged.

    The order of keys in ``data`` is ignored.

    Raises:
        YamlError: If ``text`` could not be parsed.
    """
    body = text.removeprefix(_BOM)
    mark = text.removesuffix(body)
    document = parsed_once(body)
    changes = diff(document.data, data)
    for turn in range(len(changes) + 2):
        if _same_content(document.data, data):
            return mark + body
        changes = diff(document.data, data) if turn else changes
        splices = _Round(document, data, model).splices(changes)
        for start, end, new in reversed(splices):
            body = body[:start] + new + body[end:]
        try:
            document = parsed_once(body)
        except YamlError:
            break
        if not splices:
            break
    return write_tree(with_data(read_tree(parse(text)), data), model)


def _same_content(a: Any, b: Any) -> bool:
    """Return True if two values are equal, ignoring the order of keys and the spelling of predicates."""
    if isinstance(a, dict) and isinstance(b, dict):
        return a.keys() == b.keys() and all(_same_content(a[key], b[key]) for key in a)
    if isinstance(a, tuple | list) and isinstance(b, tuple | list):
        return len(a) == len(b) and all(map(_same_content, a, b))
    if isinstance(a, str) and isinstance(b, str):
        return call(a) == call(b)
    return same(a, b)


@lru_cache(maxsize=4)  # as many as of `parsed_once`; nothing changes the result
def _spans(text: str) -> TextSpan:
    """Locate every value in a text, without the members of values that are replaced as a whole.

    These are lists in brackets, and mappings in braces that contain a predicate.
    """
    root = locate_values(text)
    todo = [root]
    while todo:
        span = todo.pop()
        if span.flow and (isinstance(span.children, list) or "(" in text[span.start : span.end]):
            span.children = None
        todo += span.members
    return root


# A range of characters in a text (start, exclusive end), and the text that replaces it.
Splice = tuple[int, int, str]


class _Round:
    """One pass over a text, which applies renames, value changes, removals, or additions."""

    def __init__(self, document: Document, data: Any, model: type[Model] | None) -> None:
        self.document, self.data, self.model = document, data, model
        self.text, self.root = document.text, _spans(document.text)
        self.newline = "\r\n" if "\r\n" in self.text else "\n"

    def splices(self, changes: Sequence[Change]) -> list[Splice]:
        """Return the next edits in the order of the text, or an empty list if no change can be applied in place.

        ``changes`` are those from the document to the data.
        """
        renames = [c for c in changes if isinstance(c, Rename)]
        values = {self._place(c.path) for c in changes if isinstance(c, Set)}
        removed, added = dict[Path_, list[str]](), dict[Path_, dict[str, Any]]()
        for change in changes:
            if isinstance(change, Remove):
                removed.setdefault(change.path[:-1], []).append(change.path[-1])
            elif isinstance(change, Add):
                added.setdefault(change.path[:-1], {})[change.path[-1]] = change.value
        found: Sequence[Splice | None]
        if renames:
            found = [self._key(rename) for rename in renames]
        elif values:
            found = [self._value(path) for path in values]
        elif replaced := list(self._replaced_keys(removed, added)):
            found = replaced
        elif removed:
            found = [splice for section, names in removed.items() for splice in self._removals(section, names)]
        elif added:
            found = [splice for section, values_ in added.items() for splice in self._additions(section, values_)]
        else:
            orders = [c.section for c in changes if isinstance(c, Reorder)]
            lists = [path for path in orders if not isinstance(self._wanted(path), dict)]
            found = [self._value(self._place(path)) for path in lists]
        splices: list[Splice] = []
        for splice in sorted((s for s in found if s is not None), key=lambda s: (s[0], -s[1])):
            # A splice inside the previous splice is already covered by it, or is found again in the next round.
            if not splices or splice[0] > splices[-1][1]:
                splices.append(splice)
        return splices

    # -- positions --------------------------------------------------------------------------------------------------

    def _steps(self, path: Path_) -> list[TextSpan]:
        """Return the existing spans along a path, starting with the span of the whole text."""
        spans, data = [self.root], self.document.data
        for k, part in enumerate(path):
            here, children = members(data, path[:k]), spans[-1].children
            if here is None or children is None or part not in here:
                break
            if isinstance(children, list):
                spans.append(children[list(here).index(part)])
            elif part in children:
                spans.append(children[part])
            else:
                break
            data = here[part]
        return spans

    def _place(self, path: Path_) -> Path_:
        """Return the longest prefix of a path that exists in the text."""
        return path[: len(self._steps(path)) - 1]

    @cached_property
    def _whole_tree(self) -> YamlTree:
        return read_tree(self.document)

    def _tree(self, path: Path_) -> YamlTree:
        tree = self._whole_tree
        for k, part in enumerate(path):
            if isinstance(tree.value, tuple):
                tree = tree.value[list(members(tree.data, path[:k]) or ()).index(part)]
            else:
                tree = tree.value[part]
        return tree

    def _wanted(self, path: Path_) -> Any:
        data = self.data
        for k, part in enumerate(path):
            data = (members(data, path[:k]) or {}).get(part, ABSENT)
        return data

    def _line(self, index: int) -> int:
        """Return the start of the line that contains ``index``."""
        return self.text.rfind("\n", 0, index) + 1

    def _line_end(self, index: int) -> int:
        """Return the end of the line that contains ``index``, before the line break."""
        end = self.text.find("\n", index)
        end = len(self.text) if end < 0 else end
        return end - (self.text[end - 1 : end] == "\r")

    def _entry_end(self, span: TextSpan) -> int:
        """Return the end of the last line of a block entry, including more deeply indented comments below it."""
        end, column = self._line_end(span.end), span.key - self._line(span.key)
        while (start := self.text.find("\n", end) + 1) > 0:
            line = self.text[start : self._line_end(start)]
            if not line.lstrip().startswith("#") or len(line) - len(line.lstrip()) <= column:
                break
            end = self._line_end(start)
        return end

    def _above(self, path: Path_, start: int) -> int:
        """Return the start of the comments above the entry whose line starts at ``start``."""
        for _ in self._tree(path).above:
            above = self._line(start - 1)
            if start == 0 or not self.text[above:start].lstrip().startswith("#"):
                break
            start = above
        return start

    # -- splices ----------------------------------------------------------------------------------------------------

    def _key(self, rename: Rename) -> Splice | None:
        steps = self._steps((*rename.section, rename.old))
        if len(steps) != len(rename.section) + 2 or steps[-1].key < 0:
            return None
        key = steps[-1].key
        same_text = self.text.startswith(rename.old, key)
        return (key, key + len(rename.old), rename.new) if same_text else None

    def _value(self, path: Path_) -> Splice | None:
        """Return the edit that sets the value at a path to the target value."""
        steps, wanted = self._steps(path), self._wanted(path)
        if not path or wanted is ABSENT:
            return None
        span, parent = steps[-1], steps[-2]
        block = isinstance(span.children, dict | list) and not span.flow
        if not block and "\n" not in self.text[span.start : span.end]:
            flow = parent.flow or (isinstance(wanted, tuple) and self.text.startswith("[", span.start))
            new = inline_text(wanted, path, self.model, flow)
            if new is not None and not set("'\"") & set(self.text[span.start : span.end]):
                new = _QUOTED_CALL.sub(r"\1", new)
            before = "" if span.start > span.key + len(path[-1]) + 1 or parent.flow else " "
            fits = self._line_end(span.end) - self._line(span.start) - (span.end - span.start) + len(new or "") <= WIDTH
            if new is not None and (fits or parent.flow or not isinstance(wanted, dict | tuple)):
                return span.start, span.end, before + new
        return self._entry(path)

    def _entry(self, path: Path_) -> Splice | None:
        """Return the edit that rewrites a block mapping entry in canonical form, keeping the comments of the entry.

        If ``path`` does not refer to such an entry, the nearest entry above it is rewritten.
        """
        while path:
            steps = self._steps(path)
            span, parent = steps[-1], steps[-2]
            if isinstance(parent.children, dict) and not parent.flow:
                wanted = self._wanted(path)
                tree = plain_tree(wanted) if wanted is ABSENT else with_data(self._tree(path), wanted)
                column = span.key - self._line(span.key)
                lines = entry_lines(tree, path, self.model, column)
                return span.key, self._line_end(span.end), self.newline.join(lines)[column:]
            path = path[:-1]
        return None

    def _replaced_keys(
        self, removed: Mapping[Path_, list[str]], added: Mapping[Path_, Mapping[str, Any]]
    ) -> Iterator[Splice]:
        """Yield the edits that write a key in place of one that it excludes, such as `pose` in place of `place`.

        The comments of the old key stay, because they are about what both of them state.
        """
        for section, names in removed.items():
            for name in names:
                rivals = RIVALS.get(name, set()) & added.get(section, {}).keys()
                steps = self._steps((*section, name))
                if len(rivals) != 1 or len(steps) != len(section) + 2 or steps[-1].key < 0:
                    continue
                (rival,), span, parent = rivals, steps[-1], steps[-2]
                new = inline_text(added[section][rival], (*section, rival), self.model, parent.flow)
                start, end = self._line(span.key), self._line_end(span.end)
                is_line = "\n" not in self.text[span.key : span.end]
                if new is not None and is_line and end - start - (span.end - span.key) + len(rival + new) + 2 <= WIDTH:
                    yield span.key, span.end, f"{rival}: {new}"

    def _removals(self, section: Path_, names: list[str]) -> list[Splice | None]:
        """Return the edits that remove members of a mapping or list."""
        steps = self._steps((*section, names[0]))
        if len(steps) <= len(section) + 1:  # inside a value that is replaced as a whole
            return [self._value(self._place((*section, names[0])))]
        parent = steps[-2]
        siblings = list(parent.children.values() if isinstance(parent.children, dict) else parent.children or ())
        if len(siblings) == len(names):
            return [self._entry(section)]
        if parent.flow:
            k = siblings.index(steps[-1])
            if k + 1 < len(siblings):
                return [(steps[-1].key, siblings[k + 1].key, "")]
            return [(siblings[k - 1].end, steps[-1].end, "")]
        removed: list[tuple[int, int]] = []
        for name in names:
            span = self._steps((*section, name))[-1]
            column = span.key if span.key >= 0 else span.start
            start = self._line(column)
            if self.text[start:column].strip() not in ("", "-" if span.key < 0 else ""):
                return [self._entry(section)]
            start = self._above((*section, name), start)
            if removed and removed[-1][1] == start:
                start = removed.pop()[0]
            removed.append((start, self.text.find("\n", self._entry_end(span)) + 1 or len(self.text)))
        return [self._without_lines(*lines) for lines in removed]

    def _without_lines(self, start: int, end: int) -> Splice:
        """Return the edit that removes lines, including the blank line above them if another one follows."""
        blank_after = not self.text[end : self._line_end(end)].strip()
        if start > 0 and blank_after and not self.text[self._line(start - 1) : start].strip():
            start = self._line(start - 1)
        return start, end, ""

    def _additions(self, section: Path_, added: dict[str, Any]) -> list[Splice | None]:
        """Return the edits that add members to a mapping or list; in a mapping in braces, only the first one."""
        steps = self._steps(section)
        parent = steps[-1]
        if len(steps) <= len(section) or not parent.children:
            return [self._value(self._place(section))]
        if isinstance(parent.children, list):
            last = parent.children[-1]
            indent = self.text[self._line(last.start) : last.start]
            items = [inline_text(value, (*section, key), self.model, False) for key, value in added.items()]
            if indent.strip() != "-" or None in items:
                return [self._entry(section)]
            end = self._line_end(last.end)
            return [(end, end, "".join(f"{self.newline}{indent}{item}" for item in items))]
        placed = self._neighbors(section, parent.children, added)
        if parent.flow:
            name, before = placed[0]
            return [self._flow_addition((*section, name), added[name], parent, before)]
        found: dict[tuple[int, int], str] = {}
        for name, before in placed:
            start, end, new = self._new_entry((*section, name), added[name], parent.children, before)
            found[start, end] = found.get((start, end), "") + new
        return [(start, end, new) for (start, end), new in found.items()]

    def _flow_addition(self, path: Path_, value: Any, parent: TextSpan, before: TextSpan | None) -> Splice | None:
        """Return the edit that adds a member to a mapping in braces, after its neighbor."""
        new = inline_text(value, path, self.model, True)
        if new is None or not isinstance(parent.children, dict) or "\n" in self.text[parent.start : parent.end]:
            return self._entry(path[:-1])
        if before is None:
            first = next(iter(parent.children.values()))
            return first.key, first.key, f"{path[-1]}: {new}, "
        fits = self._line_end(before.end) - self._line(before.end) + len(path[-1]) + len(new) + 4 <= WIDTH
        return (before.end, before.end, f", {path[-1]}: {new}") if fits else self._entry(path[:-1])

    def _new_entry(self, path: Path_, value: Any, siblings: Mapping[str, TextSpan], before: TextSpan | None) -> Splice:
        """Insert a new entry into a block mapping, after its neighbor."""
        anchor = before or next(iter(siblings.values()))
        column = anchor.key - self._line(anchor.key)
        lines = entry_lines(plain_tree(value), path, self.model, column)
        if before is None:
            first = next(key for key, span in siblings.items() if span is anchor)
            start = self._above((*path[:-1], first), self._line(anchor.key))
            if self.text[self._line(anchor.key) : anchor.key].strip():  # after the dash of a list item
                return anchor.key, anchor.key, self.newline.join(lines)[column:] + self.newline + " " * column
            return start, start, self.newline.join(lines) + self.newline
        start = self._line(before.key)
        apart = start > 0 and len(siblings) > 1 and not self.text[self._line(start - 1) : start].strip()
        section = len(path) == 1 and len(lines) > 1
        blank = [""] if section or (apart and len(path) > 1) else []
        end = self._entry_end(before)
        return end, end, self.newline + self.newline.join([*blank, *lines])

    def _neighbors(
        self, section: Path_, siblings: Mapping[str, TextSpan], names: Iterable[str]
    ) -> list[tuple[str, TextSpan | None]]:
        """Return new names in canonical order with the entry that precedes each, or None if the new entry is first."""
        slot: KeyOrder = reduce(KeyOrder.member, section, key_order(self.model))
        spans, places = list(siblings.values()), {key: k for k, key in enumerate(siblings)}
        found, last = list[tuple[str, TextSpan | None]](), -1
        for key in slot.ordered([*siblings, *names]):
            if key in places:
                last = max(last, places[key])
            else:
                found.append((key, spans[last] if last >= 0 else None))
        return found
