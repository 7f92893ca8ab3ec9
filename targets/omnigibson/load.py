"""Load this world into OmniGibson.

``load()`` returns an environment whose scene is ``scene.json``:

    env = load()
    env.scene.object_registry("name", "cup")

``scene.json`` references USD files by relative paths, as OmniGibson's tools expect. This loader makes them absolute.
"""

from __future__ import annotations

import json
import tempfile
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent


def scene_file(folder: Path) -> Path:
    """Copy ``scene.json`` to a folder, making the paths to its files absolute."""
    data = json.loads((HERE / "scene.json").read_text(encoding="utf-8"))
    for info in data["objects_info"]["init_info"].values():
        info["args"]["usd_path"] = str(HERE / info["args"]["usd_path"])
    path = folder / "scene.json"
    path.write_text(json.dumps(data), encoding="utf-8")
    return path


def load(robots: tuple[dict[str, Any], ...] = ()) -> Any:
    """Return the environment, with the robots in ``robots`` added to the scene.

    ``robots`` is a tuple of configurations.
    """
    import omnigibson as og

    with tempfile.TemporaryDirectory(prefix="simfoundry-") as temporary:
        scene = {"type": "Scene", "scene_file": str(scene_file(Path(temporary))), "use_floor_plane": False}
        return og.Environment(configs={"scene": scene, "robots": list(robots)})


def main() -> None:
    """Simulate for one second and print a summary."""
    import omnigibson as og

    env = load()
    for _ in range(60):
        og.sim.step()
    print(f"loaded {HERE / 'scene.json'}: {', '.join(item.name for item in env.scene.objects)}")
    og.shutdown()


if __name__ == "__main__":
    main()
