"""Load this world into Isaac Sim.

``load()`` opens the stage, and ``python load.py`` displays and simulates it. Run this script with Isaac Sim's Python.
``SimulationApp`` must exist before any other Isaac Sim module is imported, so start it in your own script before you
call ``load()``.
"""

from __future__ import annotations

import os
import sys
from pathlib import Path
from typing import Any

SCENE = Path(__file__).resolve().parent / "scene.usda"


def load() -> Any:
    """Open the stage in the running app and return it.

    PhysX combines friction coefficients exactly as the scene defines.
    """
    import omni.usd

    context = omni.usd.get_context()
    if not context.open_stage(str(SCENE)):
        raise RuntimeError(f"Isaac Sim could not open {SCENE}")
    return context.get_stage()


def has_display() -> bool:
    """Return true if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Simulate until the window is closed. Without a display, simulate for one second and print a summary."""
    from isaacsim import SimulationApp

    app = SimulationApp({"headless": not has_display()})
    from isaacsim.core.api import SimulationContext

    stage = load()
    simulation = SimulationContext(stage_units_in_meters=1.0)
    simulation.initialize_physics()
    simulation.play()
    steps = 0
    while app.is_running() and (has_display() or steps < 60):
        simulation.step(render=has_display())
        steps += 1
    objects = stage.GetPrimAtPath("/World/Objects").GetChildren()
    print(f"loaded {SCENE}: {', '.join(prim.GetName() for prim in objects)}")
    app.close()


if __name__ == "__main__":
    main()
