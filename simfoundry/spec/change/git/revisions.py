"""Read documents and the files that they refer to from a git revision."""

from __future__ import annotations

import posixpath
import re
import subprocess
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import write_file
from simfoundry.spec.files import MAX_PATH
from simfoundry.spec.models.kinds import is_document
from simfoundry.spec.yaml.nodes import YamlError
from simfoundry.spec.yaml.text import parse

# Function that maps a path in the repository (with ``/``) to the content of the file, or to None if it is missing.
Read = Callable[[str], bytes | None]

# Maximum number of files for one document: ten files (including textures) for each of a thousand objects.
MAX_FILES = 10_000

# Lines in mesh and material files that refer to other files; the names may follow options.
_NAMED = {
    ".obj": re.compile(rb"^[ \t]*mtllib[ \t]+(.+?)[ \t\r]*$", re.MULTILINE),
    ".mtl": re.compile(rb"^[ \t]*(?:map_\w+|bump|disp|decal|refl|norm)[ \t]+(.+?)[ \t\r]*$", re.MULTILINE),
}


class GitError(SimfoundryError):
    """Raised if a git command fails. The exception contains git's error message."""


@dataclass(frozen=True)
class Renamed:
    """A file that differs between two revisions.

    ``old`` and ``new`` are its paths in these revisions, or None for a revision in which the file does not exist.
    """

    old: str | None
    new: str | None


def git(root: Path, *args: str) -> bytes:
    """Run git in ``root`` without a shell and return its output.

    Raises:
        GitError: If the command fails.
    """
    try:
        done = subprocess.run(["git", *args], cwd=root, capture_output=True, check=False, stdin=subprocess.DEVNULL)
    except FileNotFoundError:
        raise GitError("git is not installed, so revisions cannot be read") from None
    if done.returncode:
        lines = done.stderr.decode(errors="replace").strip().splitlines()
        raise GitError(lines[0] if lines else f"git {args[0]} failed")
    return done.stdout


def repository(folder: Path) -> Path:
    """Return the root folder of the repository that contains ``folder``."""
    try:
        return Path(git(folder, "rev-parse", "--show-toplevel").decode().rstrip("\n")).resolve()
    except GitError as error:
        if "not a git repository" in str(error):
            raise GitError(f"{folder.resolve()} is not in a git repository; pass two files to compare") from None
        raise


def commit(root: Path, revision: str) -> str:
    """Resolve a ``revision`` (``HEAD~1``, a branch, a tag) to a full commit hash."""
    if not revision.startswith("-") and "\0" not in revision:
        with suppress(GitError):  # with --quiet, git gives no reason; the error below names the revision
            return git(root, "rev-parse", "--verify", "--quiet", f"{revision}^{{commit}}").decode().strip()
    hint = "; the clone is shallow, and `git fetch --unshallow` gets the commits that it lacks"
    shallow = hint if shallow_commits(root) else ""
    raise GitError(f"`{revision}` is neither a file nor a revision of this repository{shallow}")


def shallow_commits(root: Path) -> set[str]:
    """Return the hashes of the commits whose parents a shallow clone lacks."""
    file = root / git(root, "rev-parse", "--git-path", "shallow").decode().rstrip("\n")
    return set(file.read_text().split()) if file.is_file() else set()


def differing(root: Path, old: str, new: str | None, below: str = "") -> list[Renamed]:
    """Return the documents below a folder that differ between two commits, or between a commit and the working tree."""

    def included(name: str | None) -> bool:
        return name is not None and is_document(Path(name)) and (not below or name.startswith(f"{below}/"))

    pairs = renames_between(root, old, *([new] if new is not None else []))
    found = [pair for pair in pairs if included(pair.old) or included(pair.new)]
    return sorted(found, key=lambda pair: pair.new or pair.old or "")


def renames_between(root: Path, *revisions: str) -> Iterator[Renamed]:
    """Yield the files that differ between two commits, or between a commit and the working tree."""
    options = ["--name-status", "-z", "-M", "--no-ext-diff", "--no-color", "--ignore-submodules"]
    fields = iter(git(root, "diff", *options, *revisions, "--").decode(errors="surrogateescape").split("\0"))
    for status in fields:
        if not status:
            break
        before = next(fields)
        after = next(fields) if status[0] in "RC" else before
        yield Renamed(None if status[0] in "AC" else before, None if status[0] == "D" else after)


# Answers of git for a symbolic link that does not lead to a file in the commit.
_UNRESOLVED = (b"symlink", b"dangling", b"loop", b"notdir")


@contextmanager
def files_of(root: Path, revision: str) -> Iterator[Read]:
    """Yield a reader for the files in a commit, which follows symbolic links. A single git process serves all reads."""
    pipe, command = subprocess.PIPE, ["git", "cat-file", "--batch", "--follow-symlinks"]
    process = subprocess.Popen(command, cwd=root, stdin=pipe, stdout=pipe, stderr=subprocess.DEVNULL)
    assert process.stdin is not None and process.stdout is not None
    ask, answer = process.stdin, process.stdout

    def read(path: str) -> bytes | None:
        if "\n" in path:
            return None
        ask.write(f"{revision}:{path}\n".encode(errors="surrogateescape"))
        ask.flush()
        head = answer.readline().split(b" ")
        if head[0] in _UNRESOLVED:
            answer.read(int(head[1]) + 1)  # the name to which git followed the link
            return None
        if len(head) != 3 or not head[2].strip().isdigit():
            return None  # missing
        data = answer.read(int(head[2]) + 1)[:-1]
        return data if head[1] == b"blob" else None

    with process:
        yield read


def export(read: Read, path: str, folder: Path) -> Path | None:
    """Write a document and all files that it refers to into ``folder``, keeping their repository paths.

    Returns:
        The path of the written document, or None if the document does not exist.

    Raises:
        GitError: If the document refers to too many files.
    """
    files = ((name, data) for name, data in referenced_files(read, path) if data is not None)
    for count, (name, data) in enumerate(files):
        if count == MAX_FILES:
            raise GitError(f"{path} refers to more than {MAX_FILES} files, so its revisions cannot be compared")
        write_file(folder / name, data)
    target = folder / path
    return target if target.is_file() else None


def referenced_files(read: Read, path: str, suffix: str = "") -> Iterator[tuple[str, bytes | None]]:
    """Yield the path and content of a document and of every file that it refers to, directly or indirectly.

    The content is None for missing files and for files whose names do not end with ``suffix``, which are not read.
    """
    todo, seen = [path], {path}
    while todo:
        name = todo.pop()
        data = read(name) if name.endswith(suffix) else None
        yield name, data
        new = [reference for reference in references(name, data) if reference not in seen] if data is not None else []
        seen.update(new)
        todo += new


def document_references(name: str, data: bytes) -> list[str]:
    """Return the repository paths of the documents that ``name`` may refer to."""
    return [path for path in references(name, data) if path.endswith(".yaml")]


def bases_of(name: str, data: bytes) -> list[str]:
    """Return the repository paths of the documents that ``name`` extends or includes."""
    try:
        written = parse(data.decode("utf-8")).data
    except (YamlError, UnicodeDecodeError):
        return []
    keys = written if isinstance(written, dict) else {}
    included = keys.get("include")
    scenes = included.values() if isinstance(included, dict) else ()
    named = [keys.get("extends"), *(scene.get("scene") for scene in scenes if isinstance(scene, dict))]
    folder = posixpath.dirname(name)
    return [posixpath.normpath(posixpath.join(folder, base)) for base in named if isinstance(base, str)]


def references(name: str, data: bytes) -> Iterator[str]:
    """Yield the repository paths of the files that ``name`` may refer to."""
    folder = posixpath.dirname(name)
    for written in dict.fromkeys(_file_names(posixpath.splitext(name)[1].lower(), data)):
        path = posixpath.normpath(posixpath.join(folder, written))
        if not path.startswith(("/", "../")) and path.isprintable() and len(path) < MAX_PATH:
            yield path


def _file_names(kind: str, data: bytes) -> Iterator[str]:
    """Yield every string in a file that may be the name of another file."""
    if kind == ".yaml":
        try:
            document = parse(data.decode("utf-8"))
        except (YamlError, UnicodeDecodeError):  # reported when the file is read
            return
        yield from (text for text in _texts(document.data) if posixpath.splitext(text)[1])
    elif kind in _NAMED:
        for match in _NAMED[kind].finditer(data):
            line = match[1].decode("utf-8", "replace")
            yield line
            yield from line.split()


def _texts(data: Any) -> Iterator[str]:
    todo = [data]
    while todo:
        item = todo.pop()
        if isinstance(item, str):
            yield item
        elif isinstance(item, dict | tuple):
            todo += item.values() if isinstance(item, dict) else item
