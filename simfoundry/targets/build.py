"""Build folders, each of which contains one folder per target and a loss report."""

from __future__ import annotations

import hashlib
import json
import os
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from simfoundry.backends import BACKENDS
from simfoundry.backends.artifact import Artifact
from simfoundry.backends.losses import Loss, count_fates
from simfoundry.backends.names import InvalidSceneError
from simfoundry.errors import SimfoundryError
from simfoundry.runtime.files import ensure_folder_replaceable, replace_folder, scratch, strangers, write_files
from simfoundry.runtime.plugins import fault_text
from simfoundry.scene.model import Scene
from simfoundry.targets.compile import compile_target
from simfoundry.targets.find import Target, find_targets

# The default targets of a build, which are the plain backends.
TARGETS = tuple(sorted(BACKENDS.names()))

# The loss report in the build folder; see :func:`simfoundry.targets.build.report`.
LOSSES = "loss.json"

# The record of a build's inputs in the build folder; see :mod:`simfoundry.targets.inputs`.
RECORD = "build.json"

# The file in a target's folder that contains the hashes of its files.
MANIFEST = "manifest.json"


class TargetsError(SimfoundryError):
    """Raised if some targets could not be compiled. All other targets have been written.

    ``artifacts`` contains the artifacts that were written, and ``failures`` maps each failed target to the reason.
    """

    def __init__(self, artifacts: list[Artifact], failures: Mapping[str, str]) -> None:
        super().__init__("; ".join(f"{target} is not written: {reason}" for target, reason in failures.items()))
        self.artifacts, self.failures = artifacts, failures


def build(
    scene: Scene,
    targets: Iterable[str | Path],
    out: Path,
    force: bool = False,
    record: Mapping[str, object] | None = None,
) -> list[Artifact]:
    """Compile ``scene`` for every target into ``out/<target>`` and write ``out/loss.json``.

    A target is a name (a backend or a simulator) or the path of a profile. Everything is compiled and written to
    staging folders before the first target folder is replaced; each replacement is atomic. ``record`` is written last,
    to ``out/build.json``, with the hashes of the manifests.

    Raises:
        OutputError: If a folder contains files that were not written by a build or were edited afterward, unless
            ``force`` is set.
        TargetsError: If a target fails. The other targets are still written, but the record is not, and the failed
            target's folder remains unchanged.
    """
    found, failures = find_targets(targets)
    artifacts = _compile_each(scene, found, failures)
    if failures and not artifacts:
        raise TargetsError(artifacts, failures)
    for artifact in artifacts if not force else ():
        _ensure_ours(out / artifact.target)
    manifests = {artifact.target: artifact.manifest for artifact in artifacts}
    reports = {LOSSES: _json(report(scene, artifacts))}
    if record is not None and not failures:
        written = {f"{target}/{MANIFEST}": data for target, data in manifests.items()} | reports
        hashes = {path: hashlib.sha256(data).hexdigest() for path, data in written.items()}
        reports[RECORD] = _json({"inputs": record, "outputs": hashes})
    with scratch(out, "build") as staging:
        for artifact in artifacts:
            write_files(staging / artifact.target, {**artifact.files, MANIFEST: manifests[artifact.target]})
        write_files(staging, reports)
        for artifact in artifacts:
            replace_folder(staging / artifact.target, out / artifact.target)
        for name in reports:
            os.replace(staging / name, out / name)
    if failures:
        (out / RECORD).unlink(missing_ok=True)  # from now on, the folders may belong to different builds
        raise TargetsError(artifacts, failures)
    return artifacts


def _compile_each(scene: Scene, targets: Iterable[Target], failures: dict[str, str]) -> list[Artifact]:
    """Return the artifacts of the targets that can be compiled.

    The reasons why all other targets fail are added to ``failures``, keyed by target name.
    """
    artifacts: list[Artifact] = []
    for target in targets:
        try:
            artifacts.append(compile_target(scene, target))
        except (SimfoundryError, InvalidSceneError) as error:
            failures[target.name] = str(error)
        except ModuleNotFoundError as error:
            failures[target.name] = f"{error.name} is not installed; `simfoundry doctor` shows how to install it"
        except Exception as error:  # a failing backend must not affect the other targets
            failures[target.name] = f"its backend failed: {fault_text(error, 'simfoundry')}; please report this scene"
    return artifacts


def is_current(out: Path, record: Mapping[str, object]) -> bool:
    """Return true if ``out`` contains exactly the build with this ``record``, byte for byte."""
    try:
        built = json.loads((out / RECORD).read_bytes())
        hashes: dict[str, str] = built["outputs"]
        if built["inputs"] != record or not _hold(out, hashes):
            return False
        for path in hashes:
            folder = (out / path).parent
            if folder != out:
                files: dict[str, str] = json.loads((folder / MANIFEST).read_bytes())["files"]
                if not _hold(folder, files) or strangers(folder, [*files, MANIFEST]):
                    return False
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return False
    return True


def _hold(folder: Path, hashes: Mapping[str, str]) -> bool:
    return all(hashlib.sha256((folder / path).read_bytes()).hexdigest() == value for path, value in hashes.items())


def _json(data: object) -> bytes:
    return (json.dumps(data, indent=2, ensure_ascii=False) + "\n").encode()


def _ensure_ours(folder: Path) -> None:
    """Check that ``folder`` contains only unedited files from its manifest.

    Raises:
        OutputError: If the folder contains edited files or files that are not in the manifest.
    """
    try:
        entry = folder / str(json.loads((folder / MANIFEST).read_bytes())["entry"])
    except (OSError, ValueError, KeyError, TypeError):
        entry = folder
    is_stage = entry.suffix in (".usd", ".usda", ".usdc")
    keeps = f"`simfoundry import {entry} --onto SCENE` keeps edits of the stage" if is_stage else ""
    ensure_folder_replaceable(folder, MANIFEST, keeps)


def report(scene: Scene, artifacts: Iterable[Artifact]) -> dict[str, Any]:
    """Return the content of ``loss.json``, keyed by target.

    For each feature used in the scene, ``features`` counts the elements for which the feature is kept, approximated or
    dropped. ``losses`` lists every :class:`~simfoundry.backends.losses.Loss` with its fields.
    """
    return {
        a.target: {"features": count_fates(scene, a.losses), "losses": [_loss(loss) for loss in a.losses]}
        for a in artifacts
    }


def _loss(loss: Loss) -> dict[str, Any]:
    data = {name: getattr(loss, name) for name in ("path", "feature", "element", "fidelity", "size", "reason")}
    return data | {"size": None if loss.size is None else loss.size._asdict()}


def table(data: Mapping[str, Any]) -> list[str]:
    """Return one line per feature that at least one target does not preserve, with the number of affected elements.

    ``~`` means approximated and ``-`` means dropped. The last line counts the features that all targets preserve.
    """
    fields: dict[str, Mapping[str, Mapping[str, int]]] = {target: entry["features"] for target, entry in data.items()}
    names = list(dict.fromkeys(name for found in fields.values() for name in found))
    lossy = [name for name in names if any(set(found.get(name, ())) - {"kept"} for found in fields.values())]
    kept = len(names) - len(lossy)
    last = f"preserved by all targets: {kept} of the {len(names)} features in use"
    if not lossy:
        return [last]
    rows = [["not kept", *fields], *([name, *(_mark(f.get(name, {})) for f in fields.values())] for name in lossy)]
    return [*aligned(rows), last]


def _mark(found: Mapping[str, int]) -> str:
    parts = [f"{sign}{found[fate]}" for sign, fate in (("~", "approximated"), ("-", "dropped")) if found.get(fate)]
    return " ".join(parts)


def aligned(rows: Sequence[Sequence[str]], align: str = "<") -> list[str]:
    """Format the rows of a table as lines.

    ``align`` is ``<`` or ``>`` and applies to all columns except the first.
    """
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    forms = ["<", *align * (len(widths) - 1)]
    return ["  ".join(map("{:{}{}}".format, row, forms, widths)).rstrip() for row in rows]
