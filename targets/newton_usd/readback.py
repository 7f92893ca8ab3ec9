"""Newton, from the usd build through the loader of the target `newton_usd`."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from simfoundry.scene.frames import Pose
from simfoundry.verify.readers import LOADERS, Session, load_module
from simfoundry.verify.readers.newton_session import Names, NewtonSession, quiet
from simfoundry.verify.readers.usd import OWN_DAMPING, links, own_damping


def open_build(folder: Path) -> Session:
    """The model of the stage; the surfaces have their own coefficients, because Newton knows no combine mode."""
    quiet()
    loader, scene = load_module(LOADERS / "newton_usd_load.py"), folder / "scene.usda"
    return NewtonSession(loader.load(scene=scene), _names(loader.open_stage(scene)))


def _names(stage: Usd.Stage) -> Names:
    names = {str(prim.GetPath()): name for name, prim in links(stage).items()}
    cache = UsdGeom.XformCache()
    poses = {name: _pose(prim, cache) for name, prim in links(stage).items()}

    def collider(label: str) -> tuple[str, str] | None:
        link, _, name = label.partition("/Colliders/")
        return (names[link], name) if name and link in names else None

    def joint(label: str) -> str | None:
        parts = label.split("/")
        return f"{parts[3]}.{parts[5]}" if len(parts) == 6 and parts[5] != "Anchor" else None

    def link(path: str) -> str:
        return names.get(path, path)  # a robot that is a file of its own has names of its own

    found = {str(p.GetPath()): joint(str(p.GetPath())) for p in stage.Traverse() if p.HasAttribute(OWN_DAMPING)}
    own = {found[path] or "": own_damping(stage.GetPrimAtPath(path)) for path in found}
    return Names(link, collider, joint, poses, own)


def _pose(prim: Usd.Prim, cache: UsdGeom.XformCache) -> Pose:
    return Pose.from_matrix(np.array(cache.GetLocalToWorldTransform(prim)).T)
