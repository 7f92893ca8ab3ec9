"""The capture behind the scene of a window: loaded in the background, and measured without holding up the browser."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from threading import Lock, Thread
from typing import TYPE_CHECKING

from simfoundry.capture.outputs.overlay import CaptureOverlay, object_surface
from simfoundry.capture.shapes.evidence import Evidence, RayAgreement
from simfoundry.capture.shapes.register_mesh import pose_agreement
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Pose
from simfoundry.scene.object_shapes import world_bounds
from simfoundry.studio.acts.decomposition import CaptureFrame
from simfoundry.studio.captures import capture_names, find_capture, scene_overlay

if TYPE_CHECKING:
    from simfoundry.studio.view.window import StudioWindow

_log = logging.getLogger(__name__)

# Called with the name of an object, its pose, and the agreement of this pose with the capture.
Measured = Callable[[str, Pose, RayAgreement], None]


class CaptureLink:
    """The capture of a scene, if it has one.

    Attributes:
        source: The frame of the capture, or None.
        overlay: The frame in the world of the scene, or None until it has been loaded.
        problem: A sentence that says why there is no overlay, or an empty string.
    """

    def __init__(self, window: StudioWindow, given: Path | None = None) -> None:
        self.source: CaptureFrame | None = None
        self.overlay: CaptureOverlay | None = None
        self.problem = ""
        self.given = given
        self._window = window
        self._evidence: dict[int, Evidence | None] = {}

    @property
    def is_named(self) -> bool:
        """True if the scene names a capture as its origin."""
        scene = self._window.session.scene
        return scene is not None and bool(capture_names(scene))

    def start(self) -> None:
        """Load the capture in the background, if the scene names one."""
        if self.is_named:
            Thread(target=self.load, name="studio-capture", daemon=True).start()

    def load(self) -> None:
        """Load the capture."""
        window = self._window
        with window.session.lock:
            scene = window.session.scene
        if scene is None:
            return
        try:
            source = find_capture(scene, window.session.root, self.given)
            overlay = scene_overlay(scene, source)
        except (SimfoundryError, OSError) as error:
            self.problem = str(error)
        else:
            self.source, self.overlay, self.problem = source, overlay, ""
            self._evidence.clear()
        window.request_refresh()

    def segment(self, name: str) -> int:
        """Return the number of an object's pixels, or 0 if it is unknown."""
        scene = self._window.session.scene
        spec = scene.spec.objects.get(name) if scene is not None else None
        origin = spec.origin if spec is not None else None
        return origin.segment or 0 if origin is not None else 0

    def evidence(self, name: str) -> Evidence | None:
        """Return what the capture shows of an object, or None if that is unknown.

        It does not change while the object is refined: its height is that at the first call.
        """
        scene, segment = self._window.session.scene, self.segment(name)
        if self.overlay is None or scene is None or not segment or name not in scene.objects:
            return None
        if segment not in self._evidence:
            item = scene.objects[name]
            base_z = float(world_bounds(item, item.X_WO)[0][2])
            self._evidence[segment] = self.overlay.evidence(segment, base_z)
        return self._evidence[segment]


class FitMeter:
    """Measures the fit of poses one after another; those that are replaced before their turn are skipped."""

    def __init__(self, window: StudioWindow, link: CaptureLink, measured: Measured) -> None:
        self._window, self._link, self._measured = window, link, measured
        self._wanted: tuple[str, Pose] | None = None
        self._is_working = False
        self._lock = Lock()

    def request(self, name: str, X_WO: Pose) -> None:
        """Measure the fit of an object at a pose soon."""
        with self._lock:
            self._wanted = name, X_WO
            if not self._is_working:
                self._is_working = True
                Thread(target=self._work, name="studio-fit", daemon=True).start()

    def _work(self) -> None:
        """Measure what is wanted, until nothing is."""
        while True:
            with self._lock:
                if self._wanted is None:
                    self._is_working = False
                    return
                (name, X_WO), self._wanted = self._wanted, None
            try:
                self._measure(name, X_WO)
            except Exception:
                _log.exception("a fit could not be measured")

    def _measure(self, name: str, X_WO: Pose) -> None:
        with self._window.session.lock:
            scene, evidence = self._window.session.scene, self._link.evidence(name)
            item = scene.objects.get(name) if scene is not None else None
        if item is not None and evidence is not None:
            self._measured(name, X_WO, pose_agreement(evidence, object_surface(item), X_WO))
