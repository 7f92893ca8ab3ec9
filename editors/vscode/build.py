"""Build the extension for VS Code: ``python -m editors.vscode.build`` writes ``build/simfoundry-VERSION.vsix``."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path

from editors.npm import BrokenPackagesError, NoPackagesError, install
from editors.vscode.snippets import snippets

HERE = Path(__file__).resolve().parent
REPOSITORY = HERE.parents[1]

# What is packed as it is; the code is bundled, the snippets are generated, and the license is that of the repository.
FILES = ("README.md", "icon.png", "language-configuration.json", "syntaxes/simfoundry.tmLanguage.json")

# Parts of the manifest that only developers of the extension need.
PRIVATE = ("devDependencies", "private")

# 1980-01-01, the first time that a zip file can state [s since 1970]: two builds are equal to the byte.
ZIP_EPOCH = 315532800


class BuildError(Exception):
    """Raised if a tool refuses the sources. The message is what the tool says."""


def build(out: Path) -> Path:
    """Build the ``.vsix`` into a folder, and return its path. Files that are there are replaced."""
    modules = install(HERE, REPOSITORY / "build")
    staged = out / "extension"
    shutil.rmtree(staged, ignore_errors=True)
    staged.mkdir(parents=True)
    for name in FILES:
        (staged / name).parent.mkdir(exist_ok=True)
        shutil.copyfile(HERE / name, staged / name)
    shutil.copyfile(REPOSITORY / "LICENSE", staged / "LICENSE")
    (staged / "snippets.json").write_text(json.dumps(snippets(), indent=1) + "\n", encoding="utf-8")
    manifest = json.loads((HERE / "package.json").read_text(encoding="utf-8"))
    public = {key: value for key, value in manifest.items() if key not in PRIVATE}
    (staged / "package.json").write_text(json.dumps(public, indent=2) + "\n", encoding="utf-8")
    bundle(staged)
    target = out / f"simfoundry-{manifest['version']}.vsix"
    vsce = [str(modules / "@vscode" / "vsce" / "vsce"), "package", "--no-dependencies", "--skip-license"]
    run(["node", *vsce, "--allow-missing-repository", "--out", str(target.resolve())], staged)
    return target


def bundle(folder: Path, *options: str) -> None:
    """Bundle the extension into a folder, or its tests with the option ``--tests``."""
    run(["node", "esbuild.mjs", str(folder.resolve()), *options], HERE)


def check_types() -> None:
    """Check the types of the sources and of their tests."""
    run(["node", str(install(HERE, REPOSITORY / "build") / "typescript" / "bin" / "tsc"), "--project", "."], HERE)


def run(command: list[str], folder: Path) -> str:
    """Run a tool, and return what it prints."""
    environment = os.environ | {"SOURCE_DATE_EPOCH": str(ZIP_EPOCH), "VSCE_TELEMETRY": "off", "CI": "1"}
    done = subprocess.run(command, cwd=folder, capture_output=True, text=True, env=environment, check=False)
    if done.returncode:
        raise BuildError(f"{' '.join(map(str, command))}\n{done.stdout}{done.stderr}")
    return done.stdout + done.stderr


def main(arguments: list[str]) -> int:
    """Build the extension after a check of its types. Returns the exit status."""
    try:
        check_types()
        target = build(Path(arguments[0]) if arguments else REPOSITORY / "build")
    except (NoPackagesError, BrokenPackagesError, BuildError) as error:
        print(error, file=sys.stderr)
        return 1
    print(f"wrote {target} ({target.stat().st_size / 1e3:.0f} kB); install it with: code --install-extension {target}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
