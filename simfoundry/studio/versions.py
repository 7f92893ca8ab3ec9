"""Versions of a reconstructed scene: each is a document of its own, so that none overwrites another."""

from __future__ import annotations

import io
import os
import re
import sys
import zipfile
from collections.abc import Collection
from pathlib import Path

from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene
from simfoundry.spec.project import document_files
from simfoundry.studio.acts.decomposition import CaptureFrame

# Suffix of scene documents.
SUFFIX = ".scene.yaml"

# Largest number of versions that are listed, and of bytes that are exported. A person compares a handful; the meshes of
# a large scene take a few megabytes.
MAX_LISTED, MAX_BYTES = 200, 500_000_000

# Number of bytes of a scene in which its origin is looked for; that of a reconstruction is a few kilobytes long.
MAX_TEXT = 1_000_000

# Time stamp of exported files, so that the same versions make the same bytes; the earliest that ZIP can express.
_EPOCH = (1980, 1, 1, 0, 0, 0)


def version_files(path: Path) -> list[Path]:
    """Return the versions of a scene, in the order of their names.

    They are the documents ``NAME.v1.scene.yaml``, ``NAME.v2.scene.yaml``, … beside it, and those called like the scene
    in the folders ``FOLDER_2``, ``FOLDER_3``, … beside its folder, into which it was reconstructed again.
    """
    name, folder = _base(path), path.parent
    versions = [p for p in folder.glob(f"{_escaped(name)}.v*{SUFFIX}") if _number(p, name)]
    stem = re.sub(r"_\d+$", "", folder.name)
    runs = [p for p in folder.parent.glob(f"{_escaped(stem)}*/{_escaped(name)}{SUFFIX}") if p.parent != folder]
    runs = [p for p in runs if re.fullmatch(rf"{re.escape(stem)}(_\d+)?", p.parent.name)]
    base = folder / f"{name}{SUFFIX}"
    versions += [base] if base != path and base.is_file() else []
    found = sorted(runs, key=lambda p: (len(p.parent.name), p.parent.name))
    found += sorted((p for p in versions if p != path), key=lambda p: _number(p, name))
    return found[:MAX_LISTED]


def reconstructions(path: Path, root: Path, captures: Collection[str]) -> list[Path]:
    """Return the other scenes of a project that were reconstructed from some captures, in the order of their paths.

    The versions of the scene are not among them. This reads the texts of all scenes of the project.
    """
    if not captures:
        return []
    named = re.compile(rf"\bcapture: *[\"']?({'|'.join(map(re.escape, sorted(captures)))})\b".encode())
    documents = document_files(root)
    own = {path, *version_files(path)}
    found: list[Path] = []
    for file in sorted({*documents.included, *documents.excluded}):
        if len(found) < MAX_LISTED and file.name.endswith(SUFFIX) and file not in own and file.is_file():
            with file.open("rb") as stream:
                if named.search(stream.read(MAX_TEXT)):
                    found.append(file)
    return found


def save_version(path: Path, text: str, root: Path) -> Path:
    """Write the text of a scene to a new version beside it, and return its path.

    Raises:
        SimfoundryError: The scene is outside of the project folder ``root``.
        OSError: The file cannot be written.
    """
    _require_inside(path.parent, root)
    name = _base(path)
    number = max((_number(p, name) for p in path.parent.glob(f"{_escaped(name)}.v*{SUFFIX}")), default=0) + 1
    while True:  # another process may save at the same time
        version = path.parent / f"{name}.v{number}{SUFFIX}"
        try:
            with version.open("x", encoding="utf-8", newline="") as stream:
                stream.write(text)
            return version
        except FileExistsError:
            number += 1


def exported_versions(path: Path, root: Path) -> bytes:
    """Return a ZIP file with a scene, its versions, and all files that they use, at their paths in the project.

    Versions with errors are included without the files that they use. Equal files give equal bytes.

    Raises:
        SimfoundryError: The files are larger than :data:`MAX_BYTES` in total.
    """
    files: set[Path] = set()
    for version in (path, *version_files(path)):
        files.add(Path(os.path.realpath(version)))
        try:
            files |= used_files(version)
        except SpecError:
            continue
    inside = sorted(file for file in files if file.is_relative_to(root) and file.is_file())
    if sum(file.stat().st_size for file in inside) > MAX_BYTES:
        raise SimfoundryError(f"the versions take more than {MAX_BYTES / 1e6:.0f} MB; copy their folder instead")
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        for file in inside:
            entry = zipfile.ZipInfo(file.relative_to(root).as_posix(), _EPOCH)
            entry.compress_type = zipfile.ZIP_DEFLATED
            archive.writestr(entry, file.read_bytes())
    return stream.getvalue()


def used_files(path: Path) -> set[Path]:
    """Return the resolved paths of all files that a scene uses: documents, meshes, and their materials and textures.

    Raises:
        SpecError: The scene has errors.
    """
    found = {Path(os.path.realpath(file)) for file in load_scene(path).files()}
    for file in tuple(found):
        if file.suffix == ".obj":  # its materials and textures have its name, as `simfoundry capture` writes them
            found |= {other for other in file.parent.glob(f"{_escaped(file.stem)}.*") if other.suffix in _BESIDE}
    return found


# Files that belong to a Wavefront mesh.
_BESIDE = (".mtl", ".png", ".jpg")


def reconstruct_again(source: CaptureFrame, scene_file: Path, root: Path) -> Path:
    """Reconstruct a capture into a fresh folder beside that of a scene, in a process of its own.

    Returns:
        The new scene document.

    Raises:
        SimfoundryError: The reconstruction failed, or its folder would be outside of the project folder ``root``.
    """
    import subprocess

    out = fresh_folder(scene_file.parent)
    _require_inside(out, root)
    command = ["capture", str(source.document), "--frame", source.frame, "-o", str(out)]
    run = subprocess.run(
        [sys.executable, "-m", "simfoundry.cli.main", *command], capture_output=True, text=True, check=False
    )
    found = sorted(out.glob(f"*{SUFFIX}")) if out.is_dir() else []
    if run.returncode or not found:
        raise SimfoundryError(f"the reconstruction failed: {run.stderr.strip()[-600:] or run.stdout.strip()[-600:]}")
    return found[0]


def fresh_folder(folder: Path) -> Path:
    """Return the first of ``FOLDER_2``, ``FOLDER_3``, … that does not exist."""
    stem = re.sub(r"_\d+$", "", folder.name)
    number = 2
    while (out := folder.parent / f"{stem}_{number}").exists():
        number += 1
    return out


def _require_inside(folder: Path, root: Path) -> None:
    if not Path(os.path.realpath(folder)).is_relative_to(root):
        raise SimfoundryError(f"{folder} is outside of the project {root}, so nothing is written there")


def _base(path: Path) -> str:
    """Return the name of a scene without the number of its version."""
    return re.sub(r"\.v\d+$", "", path.name.removesuffix(SUFFIX))


def _number(path: Path, name: str) -> int:
    """Return the number of a version, or 0 if the name of the file does not state any."""
    match = re.fullmatch(rf"{re.escape(name)}\.v(\d{{1,9}}){re.escape(SUFFIX)}", path.name)
    return int(match[1]) if match else 0


def _escaped(name: str) -> str:
    """Return a name in which wildcards of file patterns stand for themselves."""
    return re.sub(r"([*?\[])", r"[\1]", name)
