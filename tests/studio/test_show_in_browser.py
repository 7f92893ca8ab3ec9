"""What the view shows, as pixels in a real browser."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.studio.browser import StudioPage
from tests.studio.conftest import SCENE, OpenStudio

pytestmark = pytest.mark.slow


def color_at(studio: StudioPage, point: tuple[float, float, float]) -> list[float]:
    """Return the mean color (sRGB, 0 to 255) of a few pixels at a point of the world [m]."""
    x, y = studio.screen_point(point)
    clip = {"x": x - 5, "y": y - 5, "width": 10, "height": 10}
    image = Image.open(io.BytesIO(studio.page.screenshot(clip=clip))).convert("RGB")
    mean: list[float] = np.asarray(image).reshape(-1, 3).mean(axis=0).tolist()
    return mean


def test_the_scene_is_lit_by_its_own_lights_or_evenly(desk: Path, open_studio: OpenStudio) -> None:
    white = SCENE.replace("box: [1.2, 0.8, 0.04]}", "box: [1.2, 0.8, 0.04]}\n    color: [1, 1, 1]")
    desk.write_text(white + "lights: {sun: {type: distant, intensity: 0.8, color: [1, 0.1, 0.1]}}\n")
    studio = open_studio(desk)
    corner = (-0.5, 0.25, 0.0)
    studio.until(lambda: (c := color_at(studio, corner))[0] > 1.3 * c[2] > 40, "the red light of the scene")
    studio.tab("Show")
    studio.control("Lights of the scene").uncheck()
    studio.until(lambda: (c := color_at(studio, corner))[0] < 1.2 * c[2] and c[2] > 120, "even light")
    studio.control("Shadows").check()
    studio.until(lambda: studio.server.window.options.shadows)
    studio.control("Lights of the scene").check()
    studio.until(lambda: (c := color_at(studio, corner))[0] > 1.3 * c[2], "the red light again")
    desk.write_text(white)  # without lights, a scene is lit evenly
    studio.until(lambda: (c := color_at(studio, corner))[0] < 1.2 * c[2] and c[2] > 120, "even light")
    assert studio.problems == [] and "/lights/sun" not in studio.server.window.canvas.nodes
