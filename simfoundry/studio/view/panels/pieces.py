"""The objects of a reconstruction: lock, hide, merge and split them, and state which one occludes which."""

from __future__ import annotations

from itertools import count, islice
from typing import TYPE_CHECKING, Any

import numpy as np

from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.spec.models.capture import Decomposition, Pixel
from simfoundry.studio.acts.act import ActError
from simfoundry.studio.acts.decomposition import (
    CaptureFrame,
    IgnorePiece,
    MergePieces,
    SplitPiece,
    StateOcclusion,
    stated_decomposition,
)
from simfoundry.studio.view.contents import LabelContent
from simfoundry.studio.view.nodes import Nodes, ViewNode
from simfoundry.studio.view.panels.panel import Panel, by_person, set_value

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

NONE = "(none)"

# Parts into which an object can be split at once; more are made by splitting a part again.
PARTS = ("part 1", "part 2", "part 3")


class PiecesPanel(Panel):
    """Switches of the selected object, and the constraints of the capture's decomposition."""

    def __init__(self, window: StudioWindow) -> None:
        super().__init__(window)
        gui = window.gui
        with gui.add_folder("Objects"):
            self.lock = gui.add_checkbox("Locked", False, hint="No act changes the selected object.")
            self.hide = gui.add_checkbox("Hidden", False, hint="The selected object is not shown.")
            show = gui.add_button("Show all")
        self._folder = gui.add_folder("Decomposition of the capture", visible=False)
        with self._folder:
            self._stated = gui.add_markdown("")
            self.other = gui.add_dropdown("Other object", (NONE,), initial_value=NONE)
            pairs = gui.add_button_group("Selected and other", ("one piece", "occludes", "does not occlude"))
            ignore = gui.add_button("Not an object")
            self.part = gui.add_dropdown("Mark", PARTS, initial_value=PARTS[0])
            self.marking = gui.add_checkbox("Mark by clicks", False, hint="Click on points of the selected object.")
            split = gui.add_button("Split at the marks")
        self._marks: dict[str, list[Pixel]] = {}
        self._marked = ""
        self.lock.on_update(by_person(lambda event: self._switch("locked", event.target.value)))
        self.hide.on_update(by_person(lambda event: self._switch("hidden", event.target.value)))
        show.on_click(lambda _: self._show_all())
        pairs.on_click(lambda event: self._relate(event.target.value))
        ignore.on_click(lambda _: self._run(self._ignore))
        split.on_click(lambda _: self._run(self._split))
        self.marking.on_update(by_person(lambda event: self._listen(bool(event.target.value))))

    def refresh(self) -> None:
        """Show the switches of the selected object, and what the capture states."""
        scene, name, link = self.session.scene, self.window.selected_object, self.window.capture
        set_value(self.lock, name in self.session.locked)
        set_value(self.hide, name in self.window.hidden)
        visible = link.overlay is not None and scene is not None
        if self._folder.visible != visible:
            self._folder.visible = visible
        if name != self._marked and not self.marking.value:  # clicks on the cloud may select what is beside it
            self._marked, self._marks = name, {}
        if scene is None or link.source is None or not visible:
            return
        others = (NONE, *(n for n in scene.objects if n != name and link.segment(n)))
        if self.other.options != others:
            self.other.options = others
        try:
            set_value(self._stated, stated_text(stated_decomposition(scene, link.source)))
        except SimfoundryError as error:
            set_value(self._stated, f"{error}.")

    def nodes(self) -> Nodes:
        """Return the marks."""
        overlay, nodes = self.window.capture.overlay, Nodes()
        if overlay is None:
            return nodes
        for part, pixels in self._marks.items():
            for k, (u, v) in enumerate(pixels):
                where = overlay.points_W[v, u]
                if np.isfinite(where).all():
                    key = f"/marks_{part.replace(' ', '_')}_{k}"
                    nodes[key] = ViewNode(LabelContent(part), Pose.of(where))
        return nodes

    # -- what people do -----------------------------------------------------------------------------------------------

    def _switch(self, what: str, on: bool) -> None:
        name = self.window.selected_object
        marks = {"locked": self.session.locked, "hidden": self.window.hidden}
        if name:
            marks[what] = marks[what] | {name} if on else marks[what] - {name}
        self.window.mark(**marks)

    def _show_all(self) -> None:
        self.window.mark(self.session.locked, frozenset())

    def _run(self, make: Any) -> None:
        def work() -> None:
            self.session.apply(make())

        self.window.run(work)

    def _source(self) -> CaptureFrame:
        if self.window.capture.source is None:
            raise ActError("the scene was not reconstructed from a capture")
        return self.window.capture.source

    def _pixel(self, name: str) -> Pixel:
        overlay, segment = self.window.capture.overlay, self.window.capture.segment(name)
        pixel = overlay.pixel_of(segment) if overlay is not None and segment else None
        if pixel is None:
            raise ActError(f"it is unknown where `{name}` is in the picture" if name else "select an object first")
        return pixel

    def _relate(self, relation: str) -> None:
        name, other = self.window.selected_object, str(self.other.value)

        def make() -> Any:
            if other == NONE:
                raise ActError("choose the other object first")
            pixels = {each: self._pixel(each) for each in (name, other)}
            if relation == "one piece":
                return MergePieces(self._source(), pixels)
            front, behind = (name, pixels[name]), (other, pixels[other])
            return StateOcclusion(self._source(), front, behind, holds=relation == "occludes")

        self._run(make)

    def _ignore(self) -> Any:
        name = self.window.selected_object
        return IgnorePiece(self._source(), name, self._pixel(name))

    def _split(self) -> Any:
        name = self.window.selected_object
        parts = dict(
            zip(self._part_names(name), (self._marks[part] for part in PARTS if part in self._marks), strict=False)
        )
        act = SplitPiece(self._source(), name, {n: tuple(pixels) for n, pixels in parts.items()})
        self._marks = {}
        return act

    def _part_names(self, name: str) -> list[str]:
        """Return names for the parts of an object, which no other object has."""
        scene = self.session.scene
        taken = scene.objects.keys() if scene is not None else set()
        free = (f"{name}_{k}" for k in count(2) if f"{name}_{k}" not in taken)
        return [name, *islice(free, len(PARTS) - 1)]

    def _listen(self, on: bool) -> None:
        self.window.is_picking = on
        self.window.request_refresh()
        scene = self.window.server.scene
        if on:
            scene.on_click()(self._click)
        else:
            scene.remove_click_callback(self._click)

    def _click(self, event: Any) -> None:
        """Mark the point of the selected object's cloud under a click."""
        overlay, name = self.window.capture.overlay, self._marked
        if overlay is None or not name:
            return
        pixel = overlay.pixel_on_ray(np.array(event.ray_origin), np.array(event.ray_direction))
        segment = self.window.capture.segment(name)
        if pixel is None or overlay.labels[pixel[1], pixel[0]] != segment:
            self.window.tell("No mark", f"the click does not meet a point of the cloud that belongs to {name}")
            return
        self._marks.setdefault(str(self.part.value), []).append(pixel)
        self.window.select(f"objects.{name}")


def stated_text(given: Decomposition) -> str:
    """Return the constraints of a decomposition as a list."""
    lines = [f"- {name}: one piece, {len(pixels)} pixels" for name, pixels in given.pieces.items()]
    lines += [f"- {name} occludes {', '.join(hidden)}" for name, hidden in given.occludes.items()]
    lines += [f"- {len(given.ignore)} pixels belong to no object"] if given.ignore else []
    return "\n".join(lines) or "Nothing is stated. The next reconstruction respects what you state here."
