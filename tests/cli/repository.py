"""A git repository of documents, for the tests of `diff` and `log`."""

from __future__ import annotations

import os
import shlex
import subprocess
import sys
from pathlib import Path

from tests.conftest import REPOSITORY

CABINET = """\
simfoundry: asset/1
name: cabinet
links:
  body: {mass: 3, parts: {wall: {shape: {box: [0.1, 0.1, 0.1]}}}}
  drawer: {mass: 1, parts: {tray: {shape: {box: [0.08, 0.08, 0.05]}}}}
joints:
  slide: {type: prismatic, parent: body, child: drawer, limits: [0, 0.2], axis: [1, 0, 0]}
"""
BASE = """\
simfoundry: scene/1
name: table
viewpoint: front
materials: {ceramic: {density: 2400, friction: 0.35}}
objects:
  desk: {fixed: true, shape: {box: [0.8, 0.6, 0.04]}, pose: {xyz: [0.4, 0, -0.02]}}
  cup: {shape: {cylinder: {radius: 0.04, height: 0.1}}, material: ceramic, pose: {xyz: [0.3, 0.1, 0.05]}}
  bowl: {shape: {sphere: 0.05}, material: ceramic, color: [0.2, 0.4, 0.8], pose: {xyz: [0.4, -0.1, 0.05]}}
  cabinet: {asset: parts/cabinet.asset.yaml, pose: {xyz: [0.6, 0.1, 0.05]}}
cameras:
  front: {size: [160, 120], fx: 150, fy: 150, pose: {xyz: [-0.4, 0, 0.6], look_at: [0.4, 0, 0]}}
relations: [OnTop(cup, desk)]
"""
OVERLAY = "simfoundry: scene/1\nextends: table.scene.yaml\nname: moved\nobjects: {cup: {friction: 0.7}}\n"
EDITED = BASE.replace("[0.3, 0.1, 0.05]", "[0.33, 0.1, 0.05]").replace("  bowl:", "  dish:")


class Repository:
    """A repository with one commit: a scene, a scene that extends it, and the asset that both use."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.git("init", "--quiet", "--initial-branch=main")
        self.write("table.scene.yaml", BASE)
        self.write("moved.scene.yaml", OVERLAY)
        self.write("parts/cabinet.asset.yaml", CABINET)
        self.commit("one")

    def git(self, *args: str, driver: bool = False) -> str:
        command = f"{shlex.quote(sys.executable)} -m simfoundry.cli.main diff --git"
        options = ["-c", f"diff.simfoundry.command={command}"] if driver else []
        person = {f"GIT_{who}_{what}": "t@example.org" for who in ("AUTHOR", "COMMITTER") for what in ("NAME", "EMAIL")}
        done = subprocess.run(
            ["git", *options, *args],
            cwd=self.folder,
            capture_output=True,
            text=True,
            check=False,
            env={**os.environ, **person, "GIT_CONFIG_GLOBAL": os.devnull, "PYTHONPATH": str(REPOSITORY)},
        )
        assert done.returncode == 0, done.stderr
        assert "Traceback" not in done.stderr
        return done.stdout

    def write(self, name: str, text: str) -> None:
        (self.folder / name).parent.mkdir(parents=True, exist_ok=True)
        (self.folder / name).write_text(text)

    def commit(self, message: str) -> None:
        self.git("add", "--all")
        self.git("commit", "--quiet", "-m", message)


WORDS = ["cup moved 3.0 cm (+x 3.0)", "bowl renamed to dish", "1 moved, 1 renamed"]
