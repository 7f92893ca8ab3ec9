"""The pictures of whole documents that an editor shows beside the text and renews after each change."""

from __future__ import annotations

import asyncio
import base64
from collections.abc import Awaitable, Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

from simfoundry.language_server.analysis import Analysis
from simfoundry.language_server.display.pictures import (
    ObjectPictures,
    ScenePicture,
    ViewRequest,
    VisibleScene,
    scene_picture,
    visible_scene,
)
from simfoundry.spec.models.scene import SceneSpec
from simfoundry.spec.models.task import TaskSpec

# Number of times that a picture gives way to a check before it is finished beside one; otherwise, it would never appear
# while someone types.
PATIENCE = 2

# Number of documents whose last sound text is kept for pictures.
MOST_KEPT = 32

NO_PICTURE = "There is no picture yet, because the document has errors."
OLDER = "The picture shows an earlier text, because the present one has errors."
NOT_SHOWN = "There is no picture, because the document does not describe a scene that can be lowered."
REPLACED = "This picture was replaced by a later one."


class _StoppedError(Exception):
    """Raised on the thread of the pictures if a picture is no longer wanted, or has to wait."""


@dataclass
class Previews:
    """The pictures that an editor shows. A later request for a document replaces an earlier one.

    Attributes:
        is_busy: A function that returns True while documents are checked, which is more urgent.
        idle: A function that waits until no documents are checked.
    """

    is_busy: Callable[[], bool]
    idle: Callable[[], Awaitable[None]]
    _sound: dict[Path, Analysis] = field(default_factory=dict)
    _visible: dict[Path, tuple[Analysis, VisibleScene | None]] = field(default_factory=dict)
    _latest: dict[str, int] = field(default_factory=dict)
    _count: int = 0
    _objects: ObjectPictures = field(default_factory=ObjectPictures)
    _thread: ThreadPoolExecutor = field(default_factory=lambda: ThreadPoolExecutor(1, "pictures"))

    def checked(self, analysis: Analysis) -> None:
        """Keep the analysis of a document without errors for its next picture."""
        is_lowered = analysis.draft is not None or not isinstance(analysis.loaded.spec, SceneSpec | TaskSpec)
        if is_lowered and not analysis.has_errors:
            self._sound.pop(analysis.path, None)
            self._sound[analysis.path] = analysis
            if len(self._sound) > MOST_KEPT:
                oldest = next(iter(self._sound))
                del self._sound[oldest]
                self._visible.pop(oldest, None)

    def is_shown(self, uri: str) -> bool:
        """Return True if the editor has asked for a picture of a document."""
        return uri in self._latest

    def close(self, uri: str, path: Path) -> None:
        """Forget a document that the editor has closed."""
        self._latest.pop(uri, None)
        self._sound.pop(path, None)
        self._visible.pop(path, None)

    async def answer(self, uri: str, path: Path, version: int | None, params: object) -> dict[str, Any]:
        """Return the answer to a request for a picture.

        Args:
            uri: The document.
            path: Its file.
            version: The version of its present text.
            params: The request; see :meth:`ViewRequest.of`.

        Returns:
            The ``version`` of the text that the picture shows, the picture (``png``) in base64 or None, its ``width``
            and ``height`` [px], the position of its camera, and a ``message`` or None.
        """
        view = ViewRequest.of(params)
        self._count += 1
        mine = self._latest[uri] = self._count
        for attempt in range(PATIENCE + 1):
            await self.idle()
            if self._latest.get(uri) != mine:
                return _answer(version, view, REPLACED)
            analysis = self._sound.get(path)
            if analysis is None:
                return _answer(version, view, NO_PICTURE)
            stop = partial(self._stop, uri, mine, attempt < PATIENCE)
            make = partial(self._picture, analysis, view, stop)
            try:
                found = await asyncio.get_running_loop().run_in_executor(self._thread, make)
            except _StoppedError:
                continue
            if found is None:
                return _answer(version, view, NOT_SHOWN)
            older = OLDER if analysis.version != version else None
            return _answer(analysis.version, view, older, found)
        return _answer(version, view, REPLACED)

    def _stop(self, uri: str, mine: int, gives_way: bool) -> None:
        if self._latest.get(uri) != mine or (gives_way and self.is_busy()):
            raise _StoppedError

    def _picture(self, analysis: Analysis, view: ViewRequest, stop: Callable[[], None]) -> ScenePicture | None:
        """Return a picture, on the thread of the pictures, or None if the document has no scene that can be lowered."""
        stop()
        visible = self._visible_scene(analysis)
        stop()
        return scene_picture(visible, view, stop) if visible is not None else None

    def _visible_scene(self, analysis: Analysis) -> VisibleScene | None:
        kept = self._visible.get(analysis.path)
        if kept is None or kept[0] is not analysis:
            kept = self._visible[analysis.path] = analysis, visible_scene(analysis)
        return kept[1]

    async def object_picture(self, path: Path, name: str) -> str:
        """Return a small picture of an object as a data URI, or an empty string if there is none."""
        analysis = self._sound.get(path)
        if analysis is None:
            return ""
        make = partial(self._object_picture, analysis, name)
        return await asyncio.get_running_loop().run_in_executor(self._thread, make)

    def _object_picture(self, analysis: Analysis, name: str) -> str:
        visible = self._visible_scene(analysis)
        item = visible.scene.by_name.get(name) if visible is not None else None
        return self._objects.uri(item) if item is not None else ""


def _answer(
    version: int | None, view: ViewRequest, message: str | None, picture: ScenePicture | None = None
) -> dict[str, Any]:
    answer: dict[str, Any] = {"version": version, "png": None, "width": view.width, "height": view.height}
    if picture is not None:
        answer |= {"png": base64.b64encode(picture.png).decode(), "width": picture.width, "height": picture.height}
        orbit = picture.orbit
        answer |= {"azimuth_deg": orbit.azimuth_deg, "elevation_deg": orbit.elevation_deg, "distance": orbit.distance}
    return answer | {"message": message}
