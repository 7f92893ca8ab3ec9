"""Add objects from shapes and assets of the project, duplicate and remove the selected one."""

from __future__ import annotations

import os
import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

from simfoundry.spec.names.rename import name_problem
from simfoundry.studio.acts.act import Act
from simfoundry.studio.acts.add import AddObject
from simfoundry.studio.acts.cameras import RemoveCamera
from simfoundry.studio.acts.duplicate import MAX_NEW, DuplicateObject
from simfoundry.studio.acts.remove import RemoveObject
from simfoundry.studio.view.panels.panel import Panel, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

# Shapes that are offered, with sizes of things that fit into a hand.
SHAPES: dict[str, dict[str, Any]] = {
    "box": {"box": (0.08, 0.08, 0.08)},
    "cylinder": {"cylinder": {"radius": 0.03, "height": 0.1}},
    "sphere": {"sphere": 0.03},
    "capsule": {"capsule": {"radius": 0.02, "height": 0.06}},
    "cone": {"cone": {"radius": 0.04, "height": 0.1}},
    "tray": {"open_box": {"size": (0.3, 0.2, 0.06), "wall": 0.01}},
    "table": {"box": (1.2, 0.8, 0.04)},
}

# Files that can be the asset of an object.
ASSETS = (".asset.yaml", ".glb", ".obj", ".stl", ".ply")

# Number of characters of a file's name that become the name of an object, which has at most 64 with a number behind it.
MAX_STEM = 40

# Number of files of a project that are looked at; more would delay the start.
MAX_FILES = 20_000


class AddPanel(Panel):
    """Controls for a new object: its shape or asset, its name, and its support."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        self._assets = self._found_assets()
        with gui.add_folder("Add"):
            self._kind = gui.add_dropdown("What", (*SHAPES, *self._assets), initial_value="box")
            self._name = gui.add_text("New name", "", hint="Default: the name of its shape or asset.")
            gui.add_button("Add").on_click(lambda _: self._add())
        with gui.add_folder("Selected object", expand_by_default=False):
            self._count = gui.add_number("Copies", 1, min=1, max=MAX_NEW, step=1)
            gui.add_button("Duplicate").on_click(lambda _: self._duplicate())
            gui.add_button("Remove", color="red").on_click(lambda _: self._remove())
        gui.add_command("Duplicate", hotkey="D", modifier="cmd/ctrl+shift").on_trigger(lambda _: self._duplicate())
        gui.add_command("Remove", hotkey="delete").on_trigger(lambda _: self._remove())
        window.server.on_client_connect(lambda _: window.stage.run(self._search))  # a reloaded page shows new files

    def _found_assets(self) -> dict[str, str]:
        scene = self.session.scene
        folder = (scene.loaded.path if scene is not None else self.session.path).resolve().parent
        return project_assets(self.session.root, folder)

    def _search(self) -> None:
        """Offer the assets that are in the project now."""
        self._assets = self._found_assets()
        options = (*SHAPES, *self._assets)
        if self._kind.options != options:
            value = self._kind.value
            self._kind.options = options
            set_value(self._kind, value if value in options else options[0])

    def _add(self) -> None:
        kind = self._kind.value
        fields: dict[str, Any] = {"shape": SHAPES[kind]} if kind in SHAPES else {"asset": self._assets[kind]}
        if kind == "table":
            fields["fixed"] = True
        name = self._name.value.strip() or self._free_name(kind)
        support = self.window.selected_object
        scene = self.session.scene
        if scene is None or support not in scene.objects or not scene.objects[support].fixed:
            support = ""

        def added() -> None:
            set_value(self._name, "")  # only now, so that a name that is not possible can be corrected
            self.window.select(f"objects.{name}")

        self.window.submit(AddObject(name, fields, support), then=added)

    def _free_name(self, kind: str) -> str:
        """Return a name for something of a kind, such as ``mug_2`` for ``assets/mug.asset.yaml``."""
        stem = re.sub(r"[^a-z0-9_]+", "_", Path(kind).name.partition(".")[0].lower())[:MAX_STEM].strip("_")
        stem = f"object_{stem}" if name_problem(stem) else stem
        taken = self.session.scene.spec.objects if self.session.scene is not None else {}
        names = (stem, *(f"{stem}_{k}" for k in range(2, len(taken) + 3)))
        return next(name for name in names if name not in taken)

    def _duplicate(self) -> None:
        name = self.window.selected_object
        if name:
            self.window.submit(DuplicateObject(name, int(self._count.value)))

    def _remove(self) -> None:
        section, _, name = self.window.selection.partition(".")
        acts: dict[str, type[RemoveObject | RemoveCamera]] = {"objects": RemoveObject, "cameras": RemoveCamera}
        if section in acts and name:
            act: Act = acts[section](name)
            self.window.submit(act, then=lambda: self.window.select(""))


def project_assets(root: Path, folder: Path) -> dict[str, str]:
    """Return the assets of a project: by path in the project, the reference from a document in ``folder``."""
    found: dict[str, str] = {}
    seen = 0
    for parent, folders, files in os.walk(root):
        folders[:] = sorted(name for name in folders if not name.startswith((".", "__")))
        for name in sorted(files):
            seen += 1
            if name.lower().endswith(ASSETS):
                path = Path(parent) / name
                found[path.relative_to(root).as_posix()] = Path(os.path.relpath(path, folder)).as_posix()
        if seen > MAX_FILES:
            break
    return found
