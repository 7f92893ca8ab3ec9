"""The colors of the cloud follow an object while it is dragged, and return to what the text says."""

from __future__ import annotations

import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from simfoundry.geometry.frames import Pose
from simfoundry.studio.server import StudioServer
from simfoundry.studio.view.contents import CloudContent
from simfoundry.studio.view.panels.capture import CLOUD, ERRORS, CapturePanel
from simfoundry.studio.view.panels.panel import set_value
from tests.studio.captured import write_project


def until(condition: Callable[[], Any]) -> Any:
    """Wait until a condition holds, and return its value."""
    end = time.monotonic() + 20
    while not (found := condition()):
        assert time.monotonic() < end
        time.sleep(0.01)
    return found


def test_fit_colors_follow_a_drag_and_return_when_it_is_given_up(tmp_path: Path) -> None:
    scene = write_project(tmp_path)[0]
    with StudioServer(scene, port=0) as server:
        window, gizmo = server.window, server.window.gizmo

        def shown() -> CloudContent | None:
            node = window.canvas.nodes.get(CLOUD)
            return node.content if node is not None and isinstance(node.content, CloudContent) else None

        photo = until(shown)
        panel: CapturePanel = window.panel(CapturePanel)
        set_value(panel.colors, ERRORS)
        window.select("objects.tin")
        at_rest = until(lambda: (now := shown()) is not None and now.paint != photo.paint and now)
        assert at_rest.key == photo.key  # the points are not sent again
        assert window.capture.overlay is not None
        numbers = window.capture.overlay.cloud(float(panel.density.value) / 100)[2]
        X_WO = server.session.scene.objects["tin"].X_WO if server.session.scene is not None else Pose.of()
        until(lambda: gizmo.size > 0)
        gizmo.dragged_by = 1
        for preview in window.previews:
            preview("/objects/tin", Pose.of(X_WO.p + np.array([0.0, 0.0, 0.02]), X_WO.q))

        def is_off(cloud: CloudContent | None) -> bool:
            """True if the points on top of the tin are 1 cm or more from it; those beside it still are on its faces."""
            return cloud is not None and bool((cloud.rgb[numbers == 2] == (220, 0, 30)).all(axis=1).mean() > 0.3)

        assert not is_off(at_rest)
        dragged = until(lambda: (now := shown()) is not None and is_off(now) and now)
        assert (dragged.rgb[numbers != 2] == at_rest.rgb[numbers != 2]).all()
        assert server.session.text == scene.read_text()
        gizmo.cancel(1)  # as if the browser had been closed
        until(lambda: (now := shown()) is not None and now.paint == at_rest.paint)
        assert (until(shown).rgb == at_rest.rgb).all()
