"""Load this world into Genesis.

``load()`` returns a built scene and its entities by object name:

    scene, entities = load()
    scene.step()

Poses, friction, armatures, joint friction and motors are read from ``poses.json`` and ``physics.json``, because URDF
cannot represent them. Genesis uses the larger of the friction coefficients of two surfaces. Set motor targets with
``entity.control_dofs_position``.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from typing import Any

import genesis as gs

HERE = Path(__file__).resolve().parent
TIMESTEP = 1 / 500
"""Time step [s]."""

FAR = 1e9
"""The force limit that represents an unlimited motor [N or N m]."""

STIFF = (0.01, 1.0, 0.999, 0.999, 0.001, 0.5, 2.0)
"""Stiffness of joint constraints, specified like MuJoCo's solref and solimp.

With Genesis' default, a drawer held by friction creeps at 5 mm/s.
"""

PAIRS = 4096
"""Maximum number of candidate pairs of collision shapes.

If Genesis' default of 150 is exceeded, objects fall through each other.
"""


def load(show_viewer: bool = False, n_envs: int = 0, time_step: float = TIMESTEP) -> tuple[Any, dict[str, Any]]:
    """Call ``gs.init`` if necessary, load all objects, build the scene, and set its initial state."""
    if not gs._initialized:
        gs.init(backend=gs.cpu, logging_level="warning")
    poses = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
    physics = json.loads((HERE / "physics.json").read_text(encoding="utf-8"))
    scene = gs.Scene(
        sim_options=gs.options.SimOptions(dt=time_step, gravity=tuple(physics["gravity"])),
        rigid_options=gs.options.RigidOptions(
            friction_cone=gs.friction_cone.elliptic,  # with a pyramidal cone, boxes slip too early in some directions
            impratio=10.0,  # tangential stiffness that preserves Coulomb's law
            integrator=gs.integrator.implicitfast,
            max_collision_pairs=PAIRS,
        ),
        show_viewer=show_viewer,
    )
    entities = {name: add_object(scene, item) for name, item in poses.items()}
    scene.build(n_envs=n_envs)
    for name, entity in entities.items():
        if name in physics["objects"]:
            said = physics["objects"][name]
            set_surfaces(entity, said["links"])
            set_joints(entity, poses[name]["joints"], said["joints"])
            drives = {joint: values["drive"] for joint, values in said["joints"].items() if "drive" in values}
        else:  # a robot with its own URDF keeps Genesis' default surfaces
            for joint, position in poses[name]["joints"].items():
                entity.set_dofs_position([position], entity.get_joint(joint).dofs_idx_local)
            drives = physics["robots"][name]["motors"]
        for joint, drive in drives.items():
            set_drive(entity, joint, drive)
    return scene, entities


def add_object(scene: Any, item: dict[str, Any]) -> Any:
    """Add one object at its pose. Links are not merged, and meshes are not decomposed because they are convex."""
    morph = gs.morphs.URDF(
        file=str(HERE / item["urdf"]),
        pos=tuple(item["p"]),
        quat=tuple(item["q_wxyz"]),
        fixed=item["fixed"],
        decimate=False,
        decompose_object_error_threshold=float("inf"),
        merge_fixed_links=False,
        prioritize_urdf_material=True,
        default_armature=0.0,
        align=False,
    )
    return scene.add_entity(morph, material=gs.materials.Rigid())


def set_drive(entity: Any, joint: str, drive: dict[str, float]) -> None:
    """Configure a motor that pulls the joint toward its target like a spring and damper, up to the force limit."""
    dofs = entity.get_joint(joint).dofs_idx_local
    limit = drive.get("force_limit", FAR)
    entity.set_dofs_kp([drive["stiffness"]], dofs)
    entity.set_dofs_kv([drive["damping"]], dofs)
    entity.set_dofs_force_range([-limit], [limit], dofs)
    entity.control_dofs_position([drive["target"]], dofs)


def set_surfaces(entity: Any, links: dict[str, dict[str, dict[str, float]]]) -> None:
    """Set the friction of each collision shape, including all parts of a shape that Genesis has split."""
    for link in entity.links:
        surfaces = [surface["friction"] for surface in links[link.name].values()]
        if len(link.geoms) == len(surfaces):
            for geom, mu in zip(link.geoms, surfaces, strict=True):
                geom.set_friction(mu)
        elif surfaces:
            link.set_friction(max(surfaces))


def set_joints(entity: Any, positions: dict[str, float], values: dict[str, dict[str, float]]) -> None:
    """Set the position, Coulomb friction and armature of each joint."""
    for name, position in positions.items():
        joint = entity.get_joint(name)
        dofs = joint.dofs_idx_local
        joint.set_sol_params(STIFF)
        entity.set_dofs_position([position], dofs)
        entity.set_dofs_frictionloss([values[name]["friction"]], dofs)
        entity.set_dofs_armature([values[name]["armature"]], dofs)


def has_display() -> bool:
    """Return true if a window can be opened."""
    return sys.platform != "linux" or bool(os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY"))


def main() -> None:
    """Open the viewer and simulate. Without a display, simulate for one second and print a summary."""
    scene, entities = load(show_viewer=has_display())
    steps = 0
    while steps < 500 or (has_display() and scene.viewer.is_alive()):
        scene.step()
        steps += 1
    print(f"loaded {HERE / 'poses.json'}: {', '.join(entities)}")


if __name__ == "__main__":
    main()
