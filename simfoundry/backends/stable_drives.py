"""Drive gains for engines with explicit springs. Gains that are too large for the time step are reduced."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import replace
from functools import lru_cache
from itertools import product
from types import MappingProxyType

from simfoundry.backends.artifact import number
from simfoundry.backends.losses import Loss, approximate
from simfoundry.scene.kinematics import effective_inertias, trees
from simfoundry.scene.model import Drive, Scene, SceneObject


@lru_cache(maxsize=256)  # the same object is written to many scenes
def stable_drives(item: SceneObject, timestep: float, implicit_damping: bool) -> Mapping[str, Drive]:
    """Return an object's drives, keyed by joint name, with gains that are stable at a time step of ``timestep`` [s].

    A spring alone diverges at a stiffness of 4 m / dt^2, where m is the driven inertia. Explicit damping alone diverges
    at 2 m / dt. At a quarter of these limits, the combination of both is still stable.
    """
    stable = {joint.name: joint.drive for joint in item.joints if joint.drive is not None}
    if not stable:
        return MappingProxyType({})
    effective = {name: inertia for tree in trees(item) for name, inertia in effective_inertias(tree).items()}
    for name, drive in stable.items():
        stiffest = effective[name] / timestep**2
        dampest = math.inf if implicit_damping else effective[name] / (2 * timestep)
        stable[name] = replace(drive, stiffness=min(drive.stiffness, stiffest), damping=min(drive.damping, dampest))
    return MappingProxyType(stable)


def stiffness_losses(scene: Scene, timestep: float, implicit_damping: bool) -> Iterator[Loss]:
    """Yield one loss for each gain that is reduced."""
    for item in scene.objects:
        stable = stable_drives(item, timestep, implicit_damping)
        for joint, field in product((j for j in item.joints if j.name in stable), ("stiffness", "damping")):
            wanted, written = getattr(joint.drive, field), getattr(stable[joint.name], field)
            if written < wanted:
                reason = f"The drive's {field} is reduced from {wanted:.4g} to {written:.4g}, because a time step of "
                reason += f"{number(1000 * timestep)} ms would diverge."
                yield approximate("drive", f"{item.name}.{joint.name}", reason, 100 * (1 - written / wanted), "%")
