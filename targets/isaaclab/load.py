"""Load this world into Isaac Lab.

``scene_cfg()`` returns an ``InteractiveSceneCfg`` that clones the world for each environment. Start the app first
(``AppLauncher``), then:

    from load import scene_cfg, simulation_cfg
    simulation = SimulationContext(simulation_cfg())
    scene = InteractiveScene(scene_cfg(num_envs=16))
    simulation.reset()
    scene["cup"].data.root_pos_w

If the build was compiled from a recipe, ``events_cfg()`` returns its random values as event terms, for the field
``events`` of the configuration of an environment:

    from load import events_cfg
    environment.events = events_cfg()

``python load.py`` loads one environment. It accepts the arguments of ``AppLauncher``.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = "{ENV_REGEX_NS}/World"


def description() -> dict[str, Any]:
    """Read ``objects.json``, which contains the gravity and the objects with their prims."""
    found: dict[str, Any] = json.loads((HERE / "objects.json").read_text(encoding="utf-8"))
    return found


def simulation_cfg(**settings: Any) -> Any:
    """Return a ``SimulationCfg`` with the scene's gravity. The ``settings`` are passed as its other fields."""
    import isaaclab.sim as sim_utils

    return sim_utils.SimulationCfg(gravity=tuple(description()["gravity"]), **settings)


def quaternion(wxyz: list[float], identity: tuple[float, ...]) -> tuple[float, ...]:
    """Return a rotation in Isaac Lab's quaternion order, with w first up to version 2, and w last in later versions.

    The order is inferred from ``identity``, a default value in Isaac Lab's configuration, because the version of the
    Python package differs from that of the release (Isaac Lab 2.3 is 0.4x).

    Raises:
        ValueError: If the default value is not an identity in either order.
    """
    w, x, y, z = wxyz
    if tuple(identity) == (1.0, 0.0, 0.0, 0.0):
        return w, x, y, z
    if tuple(identity) == (0.0, 0.0, 0.0, 1.0):
        return x, y, z, w
    message = (
        f"the default rotation of `InitialStateCfg` is {tuple(identity)}, which is not an identity in wxyz or xyzw"
    )
    raise ValueError(f"{message}; this loader supports Isaac Lab 2 and 3")


def scene_cfg(num_envs: int = 1, env_spacing: float = 3.0, **settings: Any) -> Any:
    """Return an ``InteractiveSceneCfg`` with the stage in each environment and all movable objects by name."""
    import isaaclab.sim as sim_utils
    from isaaclab.assets import ArticulationCfg, AssetBaseCfg, RigidObjectCfg
    from isaaclab.scene import InteractiveSceneCfg

    config = InteractiveSceneCfg(num_envs=num_envs, env_spacing=env_spacing, **settings)
    # `environment.usda` is the stage without its physics scene, because the simulation creates its own.
    spawn = sim_utils.UsdFileCfg(usd_path=str(HERE / "environment.usda"))
    config.world = AssetBaseCfg(prim_path=ROOT, spawn=spawn)
    identity = AssetBaseCfg.InitialStateCfg().rot
    for name, item in description()["objects"].items():
        prim, body = (path.replace("/World", ROOT, 1) for path in (item["prim"], item["body"]))
        position, rotation = tuple(item["p"]), quaternion(item["q_wxyz"], identity)
        if item["kind"] == "rigid":
            state = RigidObjectCfg.InitialStateCfg(pos=position, rot=rotation)
            setattr(config, name, RigidObjectCfg(prim_path=body, spawn=None, init_state=state))
        elif item["kind"] == "articulation":
            state = ArticulationCfg.InitialStateCfg(pos=position, rot=rotation, joint_pos=item["joints"])
            setattr(config, name, ArticulationCfg(prim_path=prim, spawn=None, init_state=state, actuators={}))
    return config


def events_cfg() -> Any:
    """Return the event terms in ``events.json`` as a configuration class with one ``EventTermCfg`` for each term.

    Raises:
        FileNotFoundError: If the build was not compiled from a recipe.
    """
    import isaaclab.envs.mdp as mdp
    from isaaclab.managers import EventTermCfg, SceneEntityCfg
    from isaaclab.utils import configclass

    path = HERE / "events.json"
    if not path.exists():
        raise FileNotFoundError(f"{path} does not exist; compile the recipe (*.cousins.yaml) instead of its scene")
    fields: dict[str, Any] = {}
    for name, term in json.loads(path.read_text(encoding="utf-8"))["terms"].items():
        if not hasattr(mdp, term["func"]):
            raise AttributeError(f"this release of Isaac Lab has no event term `{term['func']}`, which `{name}` needs")
        params = {key: as_tuples(value) for key, value in term["params"].items()}
        if term["asset"]:
            params["asset_cfg"] = SceneEntityCfg(**term["asset"])
        fields[name] = EventTermCfg(func=getattr(mdp, term["func"]), mode=term["mode"], params=params)
    annotations = dict.fromkeys(fields, EventTermCfg)
    return configclass(type("EventCfg", (), {"__annotations__": annotations, **fields}))()


def as_tuples(value: Any) -> Any:
    """Return a value with tuples instead of lists, because Isaac Lab validates the types of ranges."""
    if isinstance(value, dict):
        return {key: as_tuples(item) for key, item in value.items()}
    return tuple(as_tuples(item) for item in value) if isinstance(value, list) else value


def main() -> None:
    """Load one environment, simulate it for one second, and print a summary."""
    from isaaclab.app import AppLauncher

    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    AppLauncher.add_app_launcher_args(parser)
    launcher = AppLauncher(parser.parse_args())
    from isaaclab.scene import InteractiveScene
    from isaaclab.sim import SimulationContext

    simulation = SimulationContext(simulation_cfg())
    scene = InteractiveScene(scene_cfg())
    simulation.reset()
    for _ in range(60):
        simulation.step()
        scene.update(simulation.get_physics_dt())
    names = [*scene.rigid_objects, *scene.articulations]
    print(f"loaded {HERE / 'environment.usda'}: {', '.join(names)}")
    launcher.app.close()


if __name__ == "__main__":
    main()
