"""Load this world into ManiSkill.

Importing this file registers the environment ``SimFoundryScene-v1``:

    import gymnasium, load
    env = gymnasium.make("SimFoundryScene-v1", num_envs=16, robot_uids="panda")
    env.reset(seed=0)
    env.unwrapped.things["cup"].pose

Poses, contact materials, joint friction and motors are read from ``poses.json`` and ``physics.json``, because URDF
cannot represent them.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import sapien
import torch
from mani_skill.envs.sapien_env import BaseEnv
from mani_skill.utils.registration import register_env
from mani_skill.utils.structs.types import SceneConfig, SimConfig

HERE = Path(__file__).resolve().parent
POSES: dict[str, Any] = json.loads((HERE / "poses.json").read_text(encoding="utf-8"))
PHYSICS: dict[str, Any] = json.loads((HERE / "physics.json").read_text(encoding="utf-8"))
FAR = 3.4e38
"""The force limit that represents an unlimited motor [N or N m]."""


@register_env("SimFoundryScene-v1", max_episode_steps=600)
class SceneEnv(BaseEnv):
    """An environment with the scene but without a task, success or reward.

    Each reset restores the initial object poses.
    """

    SUPPORTED_REWARD_MODES = ("none",)

    def __init__(self, *args: Any, robot_uids: str = "none", **kwargs: Any) -> None:
        self.things: dict[str, Any] = {}
        super().__init__(*args, robot_uids=robot_uids, **kwargs)

    @property
    def _default_sim_config(self) -> SimConfig:
        return SimConfig(scene_config=SceneConfig(gravity=np.array(PHYSICS["gravity"])))

    def _load_agent(self, options: dict[str, Any]) -> None:
        super()._load_agent(options, sapien.Pose())

    def _load_scene(self, options: dict[str, Any]) -> None:
        for name, item in POSES.items():
            self.things[name] = self._load_object(name, item)

    def _load_object(self, name: str, item: dict[str, Any]) -> Any:
        loader = self.scene.create_urdf_loader()
        loader.name, loader.fix_root_link = name, item["fixed"]
        parsed = loader.parse(str(HERE / item["urdf"]))
        pose = sapien.Pose(item["p"], item["q_wxyz"])
        said = PHYSICS["objects"].get(name)  # None for a robot with its own URDF, which keeps the default surfaces
        surfaces = {} if said is None else said["links"]
        if parsed["actor_builders"]:
            (builder,) = parsed["actor_builders"]
            set_surfaces(builder, next(iter(surfaces.values())))
            builder.initial_pose = pose
            return builder.build_static(name) if item["fixed"] else builder.build(name)
        (builder,) = parsed["articulation_builders"]
        for link in builder.link_builders if said is not None else ():
            set_surfaces(link, surfaces[link.name])
        builder.initial_pose = pose
        articulation = builder.build(name, fix_root_link=item["fixed"])
        for joint in articulation.active_joints:
            if said is not None:
                joint.set_friction(said["joints"][joint.name]["friction"])
            if joint.name in (drives := drives_of(name)):
                drive = drives[joint.name]
                damping = drive["damping"] + float(joint.get_damping()[0])  # PhysX has one damping for drive and joint
                joint.set_drive_properties(drive["stiffness"], damping, drive.get("force_limit", FAR))
        return articulation

    def _initialize_episode(self, env_idx: torch.Tensor, options: dict[str, Any]) -> None:
        with torch.device(self.device):
            for name, item in POSES.items():
                thing, joints = self.things[name], item["joints"]
                if joints:
                    order = [joints[joint.name] for joint in thing.active_joints]
                    thing.set_qpos(torch.tensor([order]).repeat(len(env_idx), 1))
                drives = drives_of(name)
                driven = [joint for joint in thing.active_joints if joint.name in drives] if drives else []
                if driven:
                    targets = torch.tensor([[drives[joint.name]["target"] for joint in driven]])
                    thing.set_joint_drive_targets(targets.repeat(len(env_idx), 1), joints=driven)
                if not item["fixed"]:
                    thing.set_pose(sapien.Pose(item["p"], item["q_wxyz"]))

    def evaluate(self) -> dict[str, Any]:
        """Return no results, because a scene has no goal."""
        return {}


def drives_of(name: str) -> dict[str, dict[str, float]]:
    """Return the motors of an object or a robot, keyed by joint name."""
    if name in PHYSICS.get("robots", {}):
        motors: dict[str, dict[str, float]] = PHYSICS["robots"][name]["motors"]
        return motors
    return {joint: said["drive"] for joint, said in PHYSICS["objects"][name]["joints"].items() if "drive" in said}


def set_surfaces(builder: Any, surfaces: dict[str, dict[str, float]]) -> None:
    """Set the material of each collision shape in a builder, in URDF order."""
    for record, surface in zip(builder.collision_records, surfaces.values(), strict=True):
        mu = surface["friction"]
        record.material = sapien.physx.PhysxMaterial(mu, mu, surface["restitution"])


def load(num_envs: int = 1, **settings: Any) -> Any:
    """Create and reset the environment. The ``settings`` are passed to ``gymnasium.make``."""
    env = gymnasium.make("SimFoundryScene-v1", num_envs=num_envs, **settings)
    env.reset(seed=0)
    return env


def main() -> None:
    """Load the world and print a summary."""
    env = load()
    print(f"loaded {HERE / 'poses.json'}: {', '.join(env.unwrapped.things)}")
    env.close()


if __name__ == "__main__":
    main()
