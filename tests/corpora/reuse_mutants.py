"""Corruptions of documents that use reuse, each with the lines that a finding may point to."""

from __future__ import annotations

import random
import re
from collections.abc import Iterator

from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse
from tests.corpora.spec_mutants import Mutant, Spot, _typo, at, mutants, spots

# Sections whose members are referred to by name.
DEFINED = ("parameters", "templates", "frames", "objects", "materials", "include")

EXPRESSIONS = (
    "{} +", "{} ** 2", "{} / 0", "2 * ({}", "{} {}", "{}; 1", "{} m", "{}.real", "{}[0]", "-{} )", "{} // 2", "2{}x",
    "{} % 2", "min({}, 1)", "{}{}", "1e400 * {}", "{} / (1 - 1)", "${}", "{} == 1", "{} if 1 else 2", "lambda: {}",
)  # fmt: skip
REPEATS = (
    "{count: 0, step: 0.1}", "{count: -1, step: 0.1}", "{count: 1.5, step: 0.1}", "{count: three, step: 0.1}",
    "{count: [3, 0], step: [0.1, 0.1]}", "{count: [2, 2, 2, 2], step: [1, 1, 1, 1]}", "{count: 1000000}", "{step: 0.1}",
    "{count: [3, 2], step: 0.1}", "{count: [3, 2], step: [0.1]}", "{count: 3, step: [[0.1, 0]]}", "{stack: 0}",
    "{stack: [2, 2]}", "{}", "4", "[3, 2]", "{count: [], step: []}", "{count: [3, 2], step: [0.1, left]}",
    "{count: [[3]], step: 0.1}", "{count: 3, step: .nan}", "{number: 3, step: 0.1}", "{count: 3, steps: 0.1}",
    "{count: [100, 101], step: [0.1, 0.1]}", "{count: 3, step: {x: 0.1}}", "{count: true}", "{count: 3, stack: -2}",
    "nobody", "[cup]", "true", "{count: 2, count: 3}", "{count: 9999, stack: 9999}",
)  # fmt: skip
SECTIONS = {
    "parameters": ("[gap]", "gap", "3", "{gap: wide}", "{gap: [1]}", "{gap: {x: 1}}", "{Gap: 1}", "{gap: true}"),
    "include": ("station.scene.yaml", "[station.scene.yaml]", "{left: station.scene.yaml}", "{left: {}}", "true"),
    "templates": ("[plate]", "plate", "{plate: 3}", "{plate: cup}", "{plate: [mass]}"),
    "frames": ("[corner]", "corner", "{corner: [0, 0, 1]}", "{corner: 3}"),
}
FILES = (
    "absent.scene.yaml", "../../../../etc/passwd", "/etc/passwd", "serve.task.yaml", "chest.asset.yaml", "station",
    "https://example.org/a.scene.yaml", "[station.scene.yaml]", "3", '""', ".", "station.scene.yml", "{}",
)  # fmt: skip
POSES = (
    "{rpy_deg: [0, 90, 0]}", "{quat_wxyz: [1, 0, 0, 0]}", "[0, 0, 1]", "{xyz: [0, 1]}", "{frame: nowhere}",
    "{xyz: 3}", "{yaw_deg: west}", "{xy: [0, 1]}", "{on: belt}",
)  # fmt: skip


def lines_of(text: str, word: str) -> frozenset[int]:
    """The lines that contain a word, or the name of a copy of it, other than in a comment."""
    pattern = re.compile(rf"(?<![a-z0-9_]){re.escape(word)}(?:_[a-z0-9_]+)?(?![a-z0-9_])")
    rows = enumerate(text.splitlines(), 1)
    return frozenset(k for k, row in rows if pattern.search(row.partition(" #")[0]))


def scalar(spot: Spot) -> bool:
    """Whether a value is a plain scalar."""
    return bool(spot.node.plain) and spot.node.children is None


def replaced_value(text: str, spot: Spot, new: str) -> str | None:
    """The text with the whole value of a key in another form, on the line of the key."""
    if spot.key is None:
        return None
    lines = text.splitlines(keepends=True)
    row, column = spot.key
    head = lines[row - 1][: column - 1] + f"{spot.path[-1]}: "
    if lines[row - 1][: column - 1].strip():  # inside a flow mapping
        old = _flow_value(lines[row - 1], column - 1 + len(f"{spot.path[-1]}: "))
        return None if old is None else at(text, row, len(head) + 1, old, new)
    end = _end(lines, row, column)
    return "".join([*lines[: row - 1], head + new + "\n", *lines[end:]])


def _flow_value(line: str, start: int) -> str | None:
    depth = 0
    for k in range(start, len(line)):
        depth += (line[k] in "[{") - (line[k] in "]}")
        if depth < 0 or (depth == 0 and line[k] == ","):
            return line[start:k]
    return None


def _end(lines: list[str], row: int, column: int) -> int:
    """The number of lines up to the end of the block that starts in a row."""
    end = row
    while end < len(lines):
        line = lines[end]
        indent = len(line) - len(line.lstrip(" "))
        item = indent == column - 1 and line.lstrip().startswith("- ")
        if line.strip() and not item and indent < column:
            break
        end += 1
    while end > row and not lines[end - 1].strip():
        end -= 1
    return end


def forms(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """Values of the keys for reuse in forms that they cannot have."""
    for s in found:
        own, here = s.path[-1], ".".join(map(str, s.path))
        choices: tuple[str, ...] = ()
        if own == "repeat":
            choices = REPEATS
        elif len(s.path) == 1 and own in SECTIONS:
            choices = SECTIONS[str(own)]
        elif own in ("scene", "extends") and s.path[0] in ("include", "extends"):
            choices = FILES
        elif own == "pose" and s.path[0] == "include":
            choices = POSES
        elif own == "like":
            choices = ("[plate]", "3", "{}", "true", "Plate", "no plate", "plate.cup")
        elif own == "count":
            choices = ("0", "-2", "2.5", "many", "[0, 1]", "{x: 3}", "$nothing", '"3"')
        for new in rng.sample(choices, min(8, len(choices))):
            changed = replaced_value(text, s, new)
            if changed is not None and s.key is not None:
                yield Mutant(f"form of {own}", changed, s.key[0], f"{here}: {new}")


def nulls(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """Values that are missing."""
    extends = any(s.path == ("extends",) for s in found)
    for s in found:
        if s.key is None or s.node.value is None:
            continue
        if len(s.path) > 1 and (extends or _may_remove(s, found)):
            continue  # removes the value of the base, the template or the copy
        changed = replaced_value(text, s, rng.choice(["null", "~", ""]))
        if changed is not None:
            uses = lines_of(changed, str(s.path[-1])) if len(s.path) == 2 else frozenset()
            yield Mutant("null", changed, s.key[0], f"{'.'.join(map(str, s.path))}: null", uses)


def _may_remove(spot: Spot, found: list[Spot]) -> bool:
    """Whether null would remove a value that comes from elsewhere."""
    if spot.path[0] not in ("objects", "templates", "frames", "materials"):
        return False
    names = {str(s.path[1]) for s in found if s.path[0] in ("objects", "include") and len(s.path) == 2}
    owner = str(spot.path[1])
    copy = any(owner.startswith(f"{name}_") for name in names)
    return copy or any(s.path == (*spot.path[:2], "like") for s in found)


def expressions(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """Expressions that cannot be evaluated, and parameters that there are not."""
    names = [str(s.path[1]) for s in found if s.path[0] == "parameters" and len(s.path) == 2]
    for s in found:
        if not scalar(s):
            continue
        place, here = (s.node.line, s.node.column), ".".join(map(str, s.path))
        if "$" in s.node.plain:
            name = re.findall(r"\$([a-z_0-9]+)", s.node.plain)[0]
            for new in (f"${_typo(name, rng)}", f"${name.upper()}", name, "$", f"${name}$"):
                changed = at(text, *place, s.node.plain, s.node.plain.replace(f"${name}", new))
                if changed is not None:
                    yield Mutant("parameter", changed, s.node.line, f"{here}: {s.node.plain} with {new}")
        numeric = isinstance(s.node.value, int | float) and not isinstance(s.node.value, bool)
        if names and (numeric or "$" in s.node.plain):
            form = rng.choice(EXPRESSIONS)
            new = form.replace("{}", f"${rng.choice(names)}")
            changed = at(text, *place, s.node.plain, new)
            if changed is not None and not ("{" in text.splitlines()[place[0] - 1] and set("[],") & set(new)):
                yield Mutant("expression", changed, s.node.line, f"{here}: {new}")


def definitions(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """Definitions that are gone or misspelled; a finding points to their uses."""
    lines = text.splitlines(keepends=True)
    extends = any(s.path == ("extends",) for s in found)
    for s in found:
        if len(s.path) != 2 or s.path[0] not in DEFINED or s.key is None or extends:
            continue  # without an entry, the base's still holds
        name, (row, column) = str(s.path[1]), s.key
        if lines[row - 1][: column - 1].strip() or any(name.startswith(f"{o.path[-1]}_") for o in found):
            continue  # in a flow mapping, or the exception of a copy
        end = _end(lines, row, column)
        rest = [*lines[: row - 1], *["\n"] * (end - row + 1), *lines[end:]]
        uses = lines_of("".join(rest), name)
        if s.path[0] == "include":
            names = [f"{name}_{word}" for word in ("tool", "drawers", "oak", "corner", "bench")]
            uses = uses.union(*(lines_of("".join(rest), word) for word in names))
        own = {str(o.path[0]) for o in found if len(o.path) == 2 and o.path[1] == name} - {s.path[0]}
        if not uses or own:
            continue
        shown = f"{s.path[0]}.{name}"
        yield Mutant("removed definition", "".join(rest), row, f"{shown} is gone", uses)
        changed = at(text, row, column, name, _typo(name, rng))
        if changed is not None:
            yield Mutant("misspelled definition", changed, row, f"{shown} is misspelled", uses)


def exceptions(text: str, found: list[Spot]) -> Iterator[Mutant]:
    """Exceptions of copies and of included members that there are not."""
    lines = text.splitlines(keepends=True)
    extends = any(s.path == ("extends",) for s in found)
    for s in found:
        if s.path[0] != "objects" or s.key is None or len(s.path) != 2:
            continue
        name, (row, column) = str(s.path[1]), s.key
        indent = " " * (column - 1)
        if any(o.path == (*s.path, "repeat") for o in found) or extends:
            for copy in ("999", "1_1_1_1", "0", "x"):
                for entry in ("mass: 0.3", "place: {yaw_deg: 3}", "fixed: true", "category: odd"):
                    new = [*lines[: row - 1], f"{indent}{name}_{copy}:\n", f"{indent}  {entry}\n", *lines[row - 1 :]]
                    yield Mutant("absent copy", "".join(new), row, f"{name}_{copy}", frozenset({row + 1}))
                new = [*lines[: row - 1], f"{indent}{name}_{copy}: null\n", *lines[row - 1 :]]
                yield Mutant("absent copy", "".join(new), row, f"{name}_{copy}: null")
        match = re.fullmatch(r"(.*_)([0-9]+)", name)
        if match is not None:
            changed = at(text, row, column, name, match[1] + "77")
            if changed is not None:
                yield Mutant(
                    "absent copy", changed, row, f"{name} -> {match[1]}77", lines_of(changed, name) | {row + 1}
                )


def cycles(text: str, found: list[Spot], file: str) -> Iterator[Mutant]:
    """Templates, parameters, frames, repetitions and includes that lead back to themselves."""
    for s in found:
        name, here = str(s.path[1]) if len(s.path) > 1 else "", ".".join(map(str, s.path))
        new, line = "", s.key[0] if s.key else 0
        match s.path:
            case ("templates", _, "like") | ("frames", _, "frame") | ("objects", _, "repeat"):
                new = name
            case ("parameters", _):
                new = f"2 * ${name}"
            case ("include", _, "scene"):
                new = file
        if new:
            changed = replaced_value(text, s, new)
            if changed is not None:
                yield Mutant("cycle", changed, line, f"{here}: {new}")
    likes = [s for s in found if s.path[:1] == ("templates",) and s.path[2:] == ("like",)]
    for s in likes:
        for other in found:
            if other.path == ("templates", s.node.plain) and other.key is not None:
                shown = f"templates.{s.node.plain} is like {s.path[1]}"
                changed = replaced_value(text, other, f"{{like: {s.path[1]}}}")
                if changed is not None:
                    yield Mutant("cycle", changed, other.key[0], shown, frozenset({s.node.line}))


def layout(text: str, found: list[Spot], rng: random.Random) -> Iterator[Mutant]:
    """Lines that are indented wrongly, and brackets and colons that are missing."""
    lines = text.splitlines(keepends=True)
    blocks = {s.key[0] for s in found if s.key is not None and isinstance(s.node.children, dict)}
    for k, line in enumerate(lines, 1):
        body = line.lstrip(" ")
        if not body.strip() or body.startswith("#"):
            continue
        for shown, new in (
            ("shifted right", " " + line),
            ("tab", "\t" + line),
            ("no closing bracket", line.rstrip().rstrip("]}") + "\n" if line.rstrip()[-1] in "]}" else line),
            ("extra bracket", line.rstrip() + rng.choice("]}") + "\n"),
            ("no colon", line.replace(":", "", 1)),
            ("no space", line.replace(": ", ":", 1)),
        ):
            if new == line or (shown == "no colon" and "#" in line.partition(":")[0]):
                continue
            changed = "".join([*lines[: k - 1], new, *lines[k:]])
            if _means_the_same(changed, text):
                continue
            near = frozenset({k - 1, k + 1}) if shown == "shifted right" or k in blocks else frozenset()
            yield Mutant("layout", changed, k, f"line {k}: {shown}", near)


def _means_the_same(a: str, b: str) -> bool:
    try:
        return bool(parse(a).data == parse(b).data)
    except YamlError:
        return False


def extended(text: str, file: str, rng: random.Random) -> Iterator[Mutant]:
    """Every corruption of a document with reuse."""
    found = [s for s in spots(parse(text).root) if s.path]
    yield from mutants(text, file, rng)
    yield from forms(text, found, rng)
    yield from nulls(text, found, rng)
    yield from expressions(text, found, rng)
    yield from definitions(text, found, rng)
    yield from exceptions(text, found)
    yield from cycles(text, found, file)
    yield from layout(text, found, rng)
    yield from in_users(text, found, file, rng)


# Documents of the corpus with the document that includes or extends them.
USERS = {"station.scene.yaml": "cell.scene.yaml", "cups.scene.yaml": "night.scene.yaml"}

# Values of `cups.scene.yaml` that `night.scene.yaml` replaces or removes.
OVERRIDDEN = (("lights",), ("parameters",), ("objects", "plates", "repeat"))


def in_users(text: str, found: list[Spot], file: str, rng: random.Random) -> Iterator[Mutant]:
    """Corruptions of a document that another one includes or extends; the finding points into the corrupted one."""
    if file not in USERS:
        return
    user = USERS[file]
    for kind, some in (("forms", forms), ("expression", expressions)):
        kept = [s for s in found if user.startswith("cell") or not any(s.path[: len(p)] == p for p in OVERRIDDEN)]
        for mutant in some(text, kept, rng):
            yield Mutant(f"{kind} in {'an include' if 'station' in file else 'a base'}", mutant.text, mutant.line,
                         f"{mutant.done} checked in {user}", mutant.uses, user)  # fmt: skip
