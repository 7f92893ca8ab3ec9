"""Renders the pictures of ``specs/README.md`` anew: ``python specs/render_pictures.py``, or only those that are named.

Each is what ``simfoundry render`` draws of a scene, made smaller.
"""

from __future__ import annotations

import io
import subprocess
import sys
import tempfile
from pathlib import Path

from PIL import Image

SPECS = Path(__file__).resolve().parent
PICTURES = SPECS.parent / "docs" / "images" / "specs"
CAMERAS = {"pot_on_stove": "top", "gallery": "view"}
"""Which camera shows a scene; the others are seen by ``exterior_left``."""

WIDTHS = {"gallery": 640}
"""Width of a picture [px]; the others are 480 wide."""

MARGINS = {"gallery": 0.0}
"""Share of each side that is cut off; the exterior cameras see more than the things."""

MAX_BYTES = 60_000
CELLS = ("droid", "yam")
"""Scenes without things, which have no picture."""


def main() -> int:
    """Render all, or those that the command line names; returns the exit code."""
    scenes = [*sorted((SPECS / "scenes").glob("*.scene.yaml")), SPECS / "assets" / "gallery.scene.yaml"]
    by_name = {path.name.split(".")[0]: path for path in scenes}
    names = sys.argv[1:] or [n for n in by_name if n not in CELLS]
    if unknown := [n for n in names if n not in by_name]:
        print(f"there is no scene {', '.join(unknown)}; there are {', '.join(by_name)}", file=sys.stderr)
        return 2
    PICTURES.mkdir(parents=True, exist_ok=True)
    for name in names:
        whole = rendered(by_name[name], CAMERAS.get(name, "exterior_left"))
        picture = small(whole, WIDTHS.get(name, 480), MARGINS.get(name, 0.06))
        (PICTURES / f"{name}.png").write_bytes(picture)
        print(f"{name}.png  {len(picture) / 1000:.0f} kB")
    return 0


def rendered(scene: Path, camera: str) -> Image.Image:
    """A scene as one of its cameras sees it, by the ray caster: it draws the same everywhere."""
    with tempfile.TemporaryDirectory(prefix="simfoundry-pictures-") as folder:
        out = Path(folder) / "picture.png"
        command = ["render", str(scene), "--camera", camera, "--engine", "raycast", "--out", str(out)]
        subprocess.run([sys.executable, "-m", "simfoundry.cli.main", *command], check=True, stdout=subprocess.DEVNULL)
        with Image.open(out) as picture:
            return picture.convert("RGB")


def small(picture: Image.Image, width: int, margin: float) -> bytes:
    """The picture without a margin (share of its size) at a width [px]; of 256 colors where it must."""
    x, y = margin * picture.width, margin * picture.height
    box = (x, y, picture.width - x, picture.height - y)
    height = round(picture.height * width / picture.width)
    resized = picture.resize((width, height), Image.Resampling.LANCZOS, box)
    data = png(resized)
    if len(data) <= MAX_BYTES:
        return data
    palette = resized.quantize(256, Image.Quantize.MEDIANCUT, kmeans=4)
    return png(resized.quantize(palette=palette, dither=Image.Dither.FLOYDSTEINBERG))


def png(picture: Image.Image) -> bytes:
    """A picture as PNG."""
    stream = io.BytesIO()
    picture.save(stream, "PNG", optimize=True)
    return stream.getvalue()


if __name__ == "__main__":
    sys.exit(main())
