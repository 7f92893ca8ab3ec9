"""Versions of a reconstruction: save, compare, take from and export them; other shapes of an object."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.capture.shapes.evidence import FitCandidate
from simfoundry.capture.shapes.fit import FittedShape, candidates, confidence
from simfoundry.capture.shapes.texture import dominant_color
from simfoundry.errors import SimfoundryError
from simfoundry.spec.diagnostics import SpecError
from simfoundry.spec.load import load_scene
from simfoundry.studio.acts.act import ActError, resolved_path
from simfoundry.studio.acts.properties import SetProperties
from simfoundry.studio.acts.versions import TakeObjects, TakeShape
from simfoundry.studio.captures import capture_names
from simfoundry.studio.disk import file_stamp
from simfoundry.studio.versions import (
    exported_versions,
    reconstruct_again,
    reconstructions,
    save_version,
    version_files,
)
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

NONE, DEFAULT = "(none)", "default"


class VersionsPanel(Panel):
    """The versions of the scene, the variants of the selected object, and other shapes that fit its cloud."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Versions"):
            self.version = gui.add_dropdown("Version", (NONE,), initial_value=NONE)
            self._differs = gui.add_markdown("")
            take = gui.add_button_group("Take", ("selected object", "everything"))
            save = gui.add_button("Save as a new version")
            export = gui.add_button("Export the versions")
            self._again = gui.add_button("Reconstruct again", visible=False)
        with gui.add_folder("Shapes of the selected object"):
            self.variant = gui.add_dropdown("Variant", (DEFAULT,), initial_value=DEFAULT, visible=False)
            self._fit = gui.add_button("Fit other shapes", visible=False)
            self.shape = gui.add_dropdown("Shape", (NONE,), initial_value=NONE, visible=False)
        self._shapes: dict[str, tuple[str, FitCandidate, float]] = {}
        self._files: dict[str, Path] = {}
        self._read: tuple[Any, Any] = (None, None)
        self._others: list[Path] = []  # other reconstructions of the same capture
        take.on_click(lambda event: self._take(event.target.value == "everything"))
        save.on_click(lambda _: window.run(self._save))
        export.on_click(lambda event: window.run(lambda: self._export(event.client)))
        self._again.on_click(lambda _: self._in_background(self._reconstruct))
        self._fit.on_click(lambda _: self._in_background(self._fit_shapes))
        self.version.on_update(lambda _: window.request_refresh())
        self._in_background(self._search)
        self.variant.on_update(by_person(lambda event: self._choose_variant(event.target.value)))
        self.shape.on_update(by_person(lambda event: self._take_shape(event.target.value)))

    def refresh(self) -> None:
        """Show the versions, and the choices for the selected object."""
        scene, name, link = self.session.scene, self.window.selected_object, self.window.capture
        if scene is None:
            return
        files = dict.fromkeys((*version_files(scene.loaded.path), *self._others))
        self._files = {self._label(path): path for path in files if path.is_file()}
        _set_options(self.version, (NONE, *self._files))
        set_value(self._differs, self._difference(name))
        spec = scene.spec.objects.get(name)
        variants = tuple(spec.variants) if spec is not None else ()
        _set_options(self.variant, (DEFAULT, *variants))
        set_value(self.variant, (spec.variant if spec is not None else None) or DEFAULT)
        shapes = tuple(label for label, (owner, _, _) in self._shapes.items() if owner == name)
        _set_options(self.shape, (NONE, *shapes))
        for handle, visible in (
            (self.variant, bool(variants)),
            (self.shape, bool(shapes)),
            (self._fit, link.overlay is not None and bool(link.segment(name))),
            (self._again, link.source is not None),
        ):
            if handle.visible != visible:
                handle.visible = visible

    def _label(self, path: Path) -> str:
        scene = self.session.scene
        is_beside = scene is not None and path.parent == scene.loaded.path.parent
        return path.name if is_beside else self.session.shown_path(path)

    def _difference(self, name: str) -> str:
        """Return how the selected object differs in the chosen version."""
        path, scene = self._files.get(str(self.version.value)), self.session.scene
        if path is None or scene is None:
            return f"{len(self._files)} other versions." if self._files else "There are no other versions yet."
        try:
            spec: Any = self._spec(path)
        except SpecError as error:
            return f"{path.name} has an error: {error.diagnostics[0].message}."
        if name not in spec.objects or name not in scene.spec.objects:
            return f"It has {len(spec.objects)} objects." if not name else f"It has no object `{name}`."
        here, there = scene.spec.objects[name], spec.objects[name]
        moved = 1000 * float(np.linalg.norm(np.subtract(here.pose.xyz, there.pose.xyz)))
        errors = [o.fit_error if o is not None else None for o in (here.origin, there.origin)]
        fits = " → ".join("unknown" if e is None else f"{1000 * e:.1f} mm" for e in errors)
        return f"`{name}`: {moved:.1f} mm away, fit error {fits} there."

    def _spec(self, path: Path) -> Any:
        """Return the spec of a version, which is read again only if its file has changed."""
        key = (path, file_stamp(path))
        if self._read[0] != key:
            self._read = (key, load_scene(path).spec)
        return self._read[1]

    def _search(self) -> None:
        """Find the other reconstructions of the capture in the project."""
        scene = self.session.scene
        if scene is not None:
            self._others = reconstructions(scene.loaded.path, self.session.root, capture_names(scene))

    # -- what people do -----------------------------------------------------------------------------------------------

    def _save(self) -> None:
        scene = self.session.scene
        if scene is None or not self.session.is_current:
            raise ActError("the text has an error; correct it before you save a version")
        path = scene.loaded.path
        written = save_version(path, scene.texts.get(resolved_path(path), ""), self.session.root)
        self.window.tell("Saved", self.session.shown_path(written))

    def _export(self, client: Any) -> None:
        scene = self.session.scene
        if scene is not None and client is not None:
            name = scene.loaded.path.name.partition(".")[0]
            data = exported_versions(scene.loaded.path, self.session.root)
            client.send_file_download(f"{name}_versions.zip", data, save_immediately=True)

    def _take(self, everything: bool) -> None:
        path, name = self._files.get(str(self.version.value)), self.window.selected_object

        def work() -> None:
            if path is None or (not everything and not name):
                raise ActError("choose a version, and select an object to take only that")
            try:
                document = load_scene(path).document
            except SpecError as error:
                raise ActError(f"{path.name} has an error: {error.diagnostics[0].message}") from None
            data: Mapping[str, Any] = document.data if document is not None else {}
            self.session.apply(TakeObjects(path, data, () if everything else (name,)))

        self.window.run(work)

    def _choose_variant(self, variant: str) -> None:
        value = None if variant == DEFAULT else variant
        self.window.submit(SetProperties(self.window.selected_object, {"variant": value}))

    def _in_background(self, work: Any) -> None:
        def guarded() -> None:
            try:
                work()
            except (SimfoundryError, OSError) as error:
                self.window.tell("Not possible", str(error), is_error=True)
            self.window.request_refresh()

        Thread(target=guarded, name="studio-versions", daemon=True).start()

    def _reconstruct(self) -> None:
        scene, source = self.session.scene, self.window.capture.source
        if scene is None or source is None:
            return
        if self.session.texts.get(resolved_path(source.document), "") not in ("", source.document.read_text("utf-8")):
            raise ActError("save first, so that the reconstruction respects what you stated about the capture")
        self.window.tell("Reconstructing", "This takes about half a minute; the result appears as a version.")
        found = reconstruct_again(source, scene.loaded.path, self.session.root)
        self.window.tell("Reconstructed", self.session.shown_path(found))
        self._search()

    def _fit_shapes(self) -> None:
        name, link = self.window.selected_object, self.window.capture
        evidence = link.evidence(name)
        if evidence is None:
            raise ActError("the capture shows nothing of the selected object")
        found = sorted((c for c in candidates(evidence) if c.family != "completed"), key=lambda c: c.cost)
        self._shapes = {n: v for n, v in self._shapes.items() if v[0] != name}
        for each in found:
            label = f"{each.family}: fit error {1000 * each.agreement.fit:.1f} mm, cost {each.cost:.3f}"
            self._shapes[label] = (name, each, confidence(each, evidence))

    def _take_shape(self, label: str) -> None:
        overlay, chosen = self.window.capture.overlay, self._shapes.get(label)
        if overlay is None or chosen is None:
            return
        name, found, trust = chosen
        hollow = found.family == "hollow"
        shape = FittedShape(found.geometry, found.X_WO, found.agreement.fit, trust, hollow, found.profile)
        color = dominant_color(overlay.frame, overlay.labels == self.window.capture.segment(name))
        self.window.submit(TakeShape(name, shape, color))


def _set_options(handle: Any, options: tuple[str, ...]) -> None:
    if handle.options != options:
        value = handle.value
        handle.options = options
        handle.value = value if value in options else options[0]
