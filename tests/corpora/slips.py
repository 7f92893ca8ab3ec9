"""Slips of a typist in the real specs: each must be underlined at its place, and each suggestion must mend it.

``python -m tests.corpora.slips [--count N] [--seed S]`` drives the language server over standard input and output and
prints a table, kind by kind; it exits with 1 where a bar is missed.

A slip is made from the text and the positions of its values alone. It counts as underlined if a finding that was not
there before the slip touches the slipped word. If a number or list is of a wrong size, its key or the key right above
(`pose` of `xyz`) counts too; a slip of layout has no word, and its line or the next one counts, and what is between a
bracket and the one that closed it. A suggestion is a quick fix called "Replace ... by ..." of such a finding; after it,
the document must have no finding that it did not have before the slip.

Slips that leave a valid document with a plausible meaning are none, by these rules:

- a word that the slip turns into another word of the language, or into another name of this document;
- free texts: names of documents, descriptions, categories, labels, notes, reasons, prompts, colors by number;
- the definition of a name (this is a new name), unless the name is used in the same document: then a use counts;
- numbers that a unit leaves as they are (0), and lengths below 1 mm, of which nobody says that they are small;
- places of things that can be anywhere: lights without a target, and the camera of a capture;
- an additional or missing argument of predicates with optional arguments, an opacity after a color;
- an indentation after which the text has the same content, or by which an optional key moves to where it is allowed.
"""

from __future__ import annotations

import argparse
import random
import re
import shutil
import sys
import tempfile
from dataclasses import dataclass, field
from pathlib import Path

from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.names.positions import TextIndex
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import Document, parse
from tests.conftest import REPOSITORY
from tests.corpora.slip_makers import MAKERS, Slip, Source
from tests.editor.client import Message, Server, started

COUNT, SEED = 500, 7
BAR = 0.97
"""The share of slips that must be underlined."""


def is_same(before: Document, after: str) -> bool:
    """Whether a slip of layout leaves the content as it is."""
    try:
        return parse(after).data == before.data  # type: ignore[no-any-return]
    except YamlError:
        return False


def reached(path: Path, parsed: dict[Path, Document]) -> set[Path]:
    """The documents that a document names, directly or indirectly, and itself."""
    found, todo = {path}, [path]
    while todo:
        path = todo.pop()
        for name in re.findall(r"[\w./-]+\.yaml", parsed[path].text):
            target = (path.parent / name).resolve()
            if target in parsed and target not in found:
                found.add(target)
                todo.append(target)
    return found


def slips(root: Path, seed: int) -> dict[str, list[tuple[Path, Slip]]]:
    """Every slip in the documents of a folder, by kind, in random order."""
    paths = sorted(p for p in root.rglob("*.yaml") if is_document(p))
    parsed = {path: parse(path.read_text(), str(path)) for path in paths}
    defined = {
        path: {name for section in ("objects", "materials", "links", "joints") for name in document.section(section)}
        for path, document in parsed.items()
    }
    every: dict[str, list[tuple[Path, Slip]]] = {}
    for path, document in parsed.items():
        rng = random.Random(f"{seed} {path.relative_to(root)}")
        used = reached(path, parsed)
        here = frozenset().union(*(defined[other] for other in used))
        elsewhere = frozenset().union(*(names for other, names in defined.items() if other not in used)) - here
        source = Source(document.text, document, frozenset(elsewhere))
        for make in MAKERS:
            for slip in make(source, rng):
                if slip is not None and not is_same(document, slip.text):
                    every.setdefault(slip.kind, []).append((path, slip))
    rng = random.Random(seed)
    for chosen in every.values():
        rng.shuffle(chosen)
    return every


@dataclass
class Tally:
    """What became of the slips of one kind."""

    count: int = 0
    unseen: list[str] = field(default_factory=list)
    fixes: int = 0
    restored: int = 0
    bad_fixes: list[str] = field(default_factory=list)


COMMAND = [sys.executable, "-m", "simfoundry", "lsp", "--stdio"]


def run(count: int, seed: int) -> dict[str, Tally]:
    """Make slips, evenly of each kind, in a running server; what became of them, by kind."""
    tallies: dict[str, Tally] = {}
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder).resolve() / "specs"
        shutil.copytree(REPOSITORY / "specs", work)
        (work / "simfoundry.yaml").touch()
        every = slips(work, seed)
        chosen: list[tuple[Path, Slip]] = []
        while len(chosen) < count and any(every.values()):
            chosen += [made.pop() for made in every.values() if made]
        chosen = sorted(chosen[:count], key=lambda each: each[0])
        with started(COMMAND, work) as server:
            for path in dict.fromkeys(path for path, _ in chosen):
                server.open(path, path.read_text())
                before = _known(server.diagnostics_of(path, 1))
                for other, slip in chosen:
                    if other == path:
                        judge(server, path, slip, before, tallies.setdefault(slip.kind, Tally()))
                server.close(path)
    return tallies


def _known(found: list[Message]) -> set[tuple[str, str]]:
    return {(one["code"], one["message"]) for one in found}


def judge(server: Server, path: Path, slip: Slip, before: set[tuple[str, str]], tally: Tally) -> None:
    """Make a slip, look at what is underlined, and apply every suggestion."""
    tally.count += 1
    what = f"{path.name} {slip.done}"
    index = TextIndex(slip.text)
    found = _diagnostics(server, path, slip.text)
    new = [one for one in found if (one["code"], one["message"]) not in before]
    seen = [
        one
        for one in new
        for start, end in [_range(index, one["range"])]
        if any(start <= b and a <= end for a, b in slip.places)
    ]
    if not seen:
        said = "; ".join(f"{d['range']['start']['line'] + 1} {d['code']} {d['message'][:60]}" for d in new[:2])
        tally.unseen.append(f"{what}: {said or 'nothing'}")
    for one in seen:
        asked: Message = {
            "textDocument": {"uri": path.as_uri()},
            "range": one["range"],
            "context": {"diagnostics": [one]},
        }
        for action in server.ask("textDocument/codeAction", **asked) or []:
            about = [(d["code"], d["message"]) for d in action.get("diagnostics") or ()]
            if not action["title"].startswith("Replace") or (one["code"], one["message"]) not in about:
                continue
            tally.fixes += 1
            (edit,) = action["edit"]["changes"][path.as_uri()]
            start, end = _range(index, edit["range"])
            text = slip.text[:start] + edit["newText"] + slip.text[end:]
            after = _known(_diagnostics(server, path, text)) - before
            tally.restored += text == path.read_text()
            if after:
                tally.bad_fixes.append(f"{what}: {action['title']}: {sorted(after)[0]}")
            _diagnostics(server, path, slip.text)


def _diagnostics(server: Server, path: Path, text: str) -> list[Message]:
    return server.diagnostics_of(path, server.change(path, text))


def _range(index: TextIndex, found: Message) -> tuple[int, int]:
    start, end = (index.offset(found[k]["line"] + 1, found[k]["character"] + 1) for k in ("start", "end"))
    return start, end


def report(tallies: dict[str, Tally], show: bool) -> int:
    """Print the table; 1 where a bar is missed."""
    print("| slip | count | underlined | suggestions | as it was | not valid |\n|---|---|---|---|---|---|")
    total = Tally()
    for kind, t in tallies.items():
        print(f"| {kind} | {t.count} | {t.count - len(t.unseen)} | {t.fixes} | {t.restored} | {len(t.bad_fixes)} |")
        total.count, total.fixes = total.count + t.count, total.fixes + t.fixes
        total.restored += t.restored
        total.unseen += t.unseen
        total.bad_fixes += t.bad_fixes
        for line in (*t.unseen, *t.bad_fixes) if show else ():
            print(f"  {line}", file=sys.stderr)
    share = 1 - len(total.unseen) / total.count
    print(f"| all | {total.count} | {share:.1%} | {total.fixes} | {total.restored} | {len(total.bad_fixes)} |")
    return int(share < BAR or bool(total.bad_fixes))


def main() -> int:
    """Slip in the specs of the repository."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--seed", type=int, default=SEED)
    parser.add_argument("--show", action="store_true", help="List what was missed.")
    given = parser.parse_args()
    return report(run(given.count, given.seed), given.show)


if __name__ == "__main__":
    sys.exit(main())
