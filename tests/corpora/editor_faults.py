"""What no editor should send, and what people do to files: the server must survive it and still be right.

    python -m tests.corpora.editor_faults [--edits 10000] [--seed 0]

Random edits of the open documents of a project (insertions, deletions, pasted garbage, huge lines, astral characters,
mixed line ends, null bytes), their files written, deleted, renamed and linked in cycles, documents saved, closed and
opened again, requests at valid and invalid places, and messages that are not of the protocol. In the end, the server
must have the same findings as a new one with the same texts, must have logged no error except about messages that are
not of the protocol, and must not have grown by more than :data:`GROWTH` since the first tenth of the edits.
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import random
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from tests.benchmarks.editor import COMMAND, memory
from tests.benchmarks.keystrokes import write_project
from tests.corpora.editor_messages import BODIES, FRAMES, GARBAGE, METHODS, URIS
from tests.editor.client import Message, Server, framed, started

# Growth of the resident memory after the first tenth of the edits [MiB]: caches of geometry fill up to their bounds,
# and texts of up to 200 kB are parsed, so that the allocator keeps pages.
GROWTH = 128.0

# Number of objects in each scene of the project.
OBJECTS = 12


@dataclass
class Faults:
    """A session of an editor with a server, and the texts that the editor shows."""

    server: Server
    folder: Path
    paths: list[Path]
    chance: random.Random
    texts: dict[Path, str] = field(default_factory=dict)
    versions: dict[Path, int] = field(default_factory=dict)
    originals: dict[Path, str] = field(default_factory=dict)
    before: dict[Path, list[str]] = field(default_factory=dict)
    edits: int = 0

    def start(self) -> None:
        """Open all documents."""
        self.originals = {path: path.read_text(encoding="utf-8") for path in self.paths}
        for path in self.paths:
            self.open(path)

    def open(self, path: Path) -> None:
        """Open a document with the text of its file, or with its original text."""
        try:
            text = path.read_bytes().decode("utf-8", "replace")
        except OSError:
            text = self.originals[path]
        self.texts[path], self.versions[path] = text, 1
        self.server.open(path, text)

    def close(self, path: Path) -> None:
        """Close a document."""
        del self.texts[path]
        self.server.close(path)

    def edit(self, path: Path, start: int, end: int, new: str) -> None:
        """Replace a part of a text."""
        text = self.texts[path]
        self.edits += 1
        self.before.setdefault(path, []).append(text)
        del self.before[path][:-20]
        self.texts[path] = text[:start] + new + text[end:]
        span = {"start": place(text, start), "end": place(text, end)}
        self.versions[path] = self.server.change(path, new, **span)

    def replace(self, path: Path, text: str) -> None:
        """Replace a whole text."""
        self.edits += 1
        self.texts[path] = text
        self.versions[path] = self.server.change(path, text)

    def step(self) -> None:
        """Do one random thing to an open document."""
        shown = [path for path in self.paths if path in self.texts]
        if not shown:
            self.open(self.chance.choice(self.paths))
            return
        path = self.chance.choice(shown)
        if len(self.texts[path]) > 300_000 or self.chance.random() < 0.02:
            self.replace(path, self.originals[path])
        self.chance.choices(*zip(*self.actions, strict=True))[0](path)

    @property
    def actions(self) -> list[tuple[Callable[[Path], None], float]]:
        """What can be done to an open document, and how often."""
        return [
            (self.type_character, 30), (self.delete, 20), (self.undo, 14), (self.paste, 8), (self.insert_garbage, 8),
            (self.save, 2), (self.reopen, 2), (self.change_disk, 3), (self.request, 20), (self.cancel, 3),
            (self.beyond, 2), (self.strange_uri, 2), (self.malformed, 3),
        ]  # fmt: skip

    # -- edits ------------------------------------------------------------------------------------------------------

    def at(self, text: str) -> int:
        """A random offset that is not inside a line break."""
        offset = self.chance.randint(0, len(text))
        return offset + (text[offset - 1 : offset + 1] == "\r\n")

    def type_character(self, path: Path) -> None:
        """Type a character or a word."""
        at = self.at(self.texts[path])
        words = ("a", "1", " ", "\n", ":", ".", "-", "on: ", "box_3", "mass: 2\n", "  ", ", ", "null", "é")
        self.edit(path, at, at, self.chance.choice(words))

    def delete(self, path: Path) -> None:
        """Delete a few characters."""
        start = self.at(self.texts[path])
        length = self.chance.choice((1, 1, 2, 5, 40))
        self.edit(path, start, self.aligned(path, min(start + length, len(self.texts[path]))), "")

    def aligned(self, path: Path, at: int) -> int:
        """The offset, or the next one if it is inside a line break."""
        return at + (self.texts[path][at - 1 : at + 1] == "\r\n")

    def undo(self, path: Path) -> None:
        """Return to an earlier text."""
        if self.before.get(path):
            self.replace(path, self.before[path].pop())
        else:
            self.replace(path, self.originals[path])

    def paste(self, path: Path) -> None:
        """Paste a part of a text into another place, with other line ends at times."""
        source = self.texts[self.chance.choice(list(self.texts))]
        start = self.at(source)
        part = source[start : start + self.chance.choice((10, 100, 1000))]
        if self.chance.random() < 0.3:
            part = re.sub("\r?\n", self.chance.choice(("\r\n", "\r", "\n")), part)
        at = self.at(self.texts[path])
        self.edit(path, at, at, part)

    def insert_garbage(self, path: Path) -> None:
        """Insert what does not belong into a document."""
        at = self.at(self.texts[path])
        self.edit(path, at, at, self.chance.choice(GARBAGE))

    def beyond(self, path: Path) -> None:
        """Edit at places that do not exist; the whole text follows, because the result is not defined."""
        numbers = (-1, 10**9, 2**31, 0, 3)
        ends = [{"line": self.chance.choice(numbers), "character": self.chance.choice(numbers)} for _ in range(2)]
        self.server.change(path, "x", start=ends[0], end=ends[1])
        self.replace(path, self.texts[path])

    # -- files ------------------------------------------------------------------------------------------------------

    def save(self, path: Path) -> None:
        """Write the text into its file."""
        write(path, self.texts[path])
        self.server.tell("textDocument/didSave", textDocument={"uri": path.as_uri()})

    def reopen(self, path: Path) -> None:
        """Close a document without saving, and open it again at times."""
        self.close(path)
        if self.chance.random() < 0.8:
            self.open(path)

    def change_disk(self, _: Path) -> None:
        """Change, delete, rename, link or restore a file of the project; the editor tells of it at times."""
        files = [*self.paths, *self.folder.glob("item_*"), *self.folder.glob("mesh_1*")]
        file = self.chance.choice(files)
        original = self.originals.get(file)
        match self.chance.randrange(8):
            case 0:
                file.unlink(missing_ok=True)
            case 1 if file.is_file():
                file.rename(file.with_name(f"moved_{file.name}"))
            case 2:
                file.unlink(missing_ok=True)
                file.symlink_to(file.name)
            case 3:
                write(file, self.chance.choice(GARBAGE))
            case 4:
                file.unlink(missing_ok=True)
                file.symlink_to(self.chance.choice(files).name)
            case _ if original is not None:
                write(file, original)
            case _:
                moved = file.with_name(f"moved_{file.name}")
                if moved.is_file() and not file.exists():
                    file.unlink(missing_ok=True)
                    moved.rename(file)
        if self.chance.random() < 0.7:
            change = {"uri": file.as_uri(), "type": self.chance.randint(1, 3)}
            self.server.tell("workspace/didChangeWatchedFiles", changes=[change])

    # -- requests ---------------------------------------------------------------------------------------------------

    def parameters(self, path: Path) -> Message:
        """The parameters of a request at a random place, which may not exist."""
        text = self.texts[path]
        numbers = (-1, 0, 7, 10**9)
        nowhere = {"line": self.chance.choice(numbers), "character": self.chance.choice(numbers)}
        position = place(text, self.at(text)) if self.chance.random() < 0.85 else nowhere
        uri = path.as_uri() if self.chance.random() < 0.95 else self.chance.choice(URIS)
        return {
            "textDocument": {"uri": uri}, "position": position, "positions": [position], "newName": "other",
            "range": {"start": position, "end": place(text, self.at(text))},
            "options": {"tabSize": 2, "insertSpaces": True},
            "context": {"includeDeclaration": True, "diagnostics": [], "triggerKind": 1},
            "color": {"red": 1, "green": 0, "blue": 2, "alpha": 1},
        }  # fmt: skip

    def request(self, path: Path) -> None:
        """Ask something, and wait for the answer at times."""
        method = f"textDocument/{self.chance.choice(METHODS)}"
        number = self.send(method, self.parameters(path))
        if self.chance.random() < 0.5:
            self.answer(number)

    def send(self, method: str, params: Any) -> int:
        """Send a request, and return its number."""
        self.server.count += 1
        number = self.server.count
        self.server.answers[number] = queue.Queue()
        self.server.send_bytes(
            framed(json.dumps({"jsonrpc": "2.0", "id": number, "method": method, "params": params}).encode())
        )
        return number

    def answer(self, number: int) -> None:
        """Wait for an answer, which may be an error."""
        answers = self.server.answers.get(number)
        if answers is not None:
            answers.get(timeout=60)

    def cancel(self, path: Path) -> None:
        """Ask something, and no longer want to know it."""
        number = self.send(f"textDocument/{self.chance.choice(METHODS)}", self.parameters(path))
        self.server.tell("$/cancelRequest", id=number)

    def strange_uri(self, _: Path) -> None:
        """Open, change and close something that is not a file of the project."""
        uri = self.chance.choice(URIS)
        text = self.originals[self.paths[0]]
        item = {"uri": uri, "languageId": "yaml", "version": 1, "text": text}
        self.server.tell("textDocument/didOpen", textDocument=item)
        changes = [{"text": text.replace("box_1", "box_0")}]
        self.server.tell("textDocument/didChange", textDocument={"uri": uri, "version": 2}, contentChanges=changes)
        self.server.tell("textDocument/didSave", textDocument={"uri": uri})
        self.server.tell("textDocument/didClose", textDocument={"uri": uri})

    def malformed(self, path: Path) -> None:
        """Send what is not a message, or a request whose parameters have other types."""
        match self.chance.randrange(3):
            case 0:
                self.server.send_bytes(framed(self.chance.choice(BODIES)))
            case 1:
                self.server.send_bytes(self.chance.choice(FRAMES))
            case _:
                params = self.parameters(path)
                key = self.chance.choice(("textDocument", "position", "context", "range"))
                params[key] = self.chance.choice((None, 5, "x", [], {"uri": 5}, {"line": "a"}))
                self.answer(self.send(f"textDocument/{self.chance.choice(METHODS[:8])}", params))

    # -- results ----------------------------------------------------------------------------------------------------

    def settled(self) -> dict[Path, list[str]]:
        """The findings of each open document, once nothing changes any more."""
        self.server.tell("workspace/didChangeWatchedFiles", changes=[])
        return settled(self.server, self.versions, list(self.texts))


def settled(server: Server, versions: dict[Path, int], paths: list[Path]) -> dict[Path, list[str]]:
    """The last findings of documents, once the server has said nothing for a second."""
    last: dict[Path, Message] = {}
    quiet = time.monotonic()
    while time.monotonic() - quiet < 1.0 or any(last.get(p, {}).get("version") != versions[p] for p in paths):
        if time.monotonic() - quiet > 60:
            raise RuntimeError(
                f"no findings of {[p for p in paths if p not in last or last[p].get('version') != versions[p]]}"
            )
        for path in paths:
            while not server.published[path.as_uri()].empty():
                last[path] = server.published[path.as_uri()].get()
                quiet = time.monotonic()
        time.sleep(0.05)
    return {path: sorted(json.dumps(one, sort_keys=True) for one in last[path]["diagnostics"]) for path in paths}


def place(text: str, offset: int) -> dict[str, int]:
    """The position of an offset, in lines and UTF-16 code units."""
    before = re.split(r"\r\n|\r|\n", text[:offset])
    return {"line": len(before) - 1, "character": len(before[-1].encode("utf-16-le", "surrogatepass")) // 2}


def write(file: Path, text: str) -> None:
    """Write a text into a file, which may be a link."""
    file.unlink(missing_ok=True)
    file.write_bytes(text.encode("utf-8", "surrogatepass"))


def faults(folder: Path, edits: int, seed: int) -> list[str]:
    """Run a session of random edits, and return what went wrong."""
    paths = [*write_project(folder, OBJECTS), folder / "item_0.asset.yaml"]
    log = folder.parent / f"{folder.name}.log"
    wrong: list[str] = []
    with log.open("wb") as errors, started(COMMAND, folder, errors) as server:
        session = Faults(server, folder, paths, random.Random(seed))
        session.start()
        early, tenths, steps = 0.0, 0, 0
        while session.edits < edits:
            session.step()
            steps += 1
            if steps % 10 == 0:
                session.answer(session.send("textDocument/hover", {}))  # so that the editor is not far ahead
            if server.process.poll() is not None:
                return [f"the server ended after {session.edits} edits", log.read_text(errors="replace")[-3000:]]
            if 10 * session.edits >= edits * (tenths + 1):
                tenths += 1
                early = early or memory(server.process.pid)
                print(f"{session.edits:6} edits, {steps} steps, {memory(server.process.pid):.0f} MiB", flush=True)
        found = session.settled()
        late = memory(server.process.pid)
        print(f"{edits:6} edits, {late:.0f} MiB, of which {late - early:.0f} MiB after the first tenth")
        if late - early > GROWTH:
            wrong.append(f"the server has grown by {late - early:.0f} MiB")
        wrong += [f"logged: {one['message'][:300]}" for one in server.logged if one["type"] == 1]
        texts = session.texts
    with started(COMMAND, folder) as server:
        for path, text in texts.items():
            server.open(path, text)
        server.tell("workspace/didChangeWatchedFiles", changes=[])
        fresh = settled(server, dict.fromkeys(texts, 1), list(texts))
    for path in texts:
        if found[path] != fresh[path]:
            wrong.append(f"{path.name}: {found[path][:3]} instead of {fresh[path][:3]}")
    return wrong


def main() -> int:
    """Print what went wrong; 1 if anything did."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--edits", type=int, default=10_000)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        project = Path(folder).resolve() / "project"
        project.mkdir()
        start = time.monotonic()
        wrong = faults(project, arguments.edits, arguments.seed)
        print(f"{time.monotonic() - start:.0f} s")
        for one in wrong[:20]:
            print(one)
        shutil.copy(project.parent / "project.log", os.environ.get("LOG", os.devnull))
    print("survived" if not wrong else f"{len(wrong)} faults")
    return bool(wrong)


if __name__ == "__main__":
    sys.exit(main())
