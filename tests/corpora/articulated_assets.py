"""Joints of real articulated assets from two noisy captures: ``python -m tests.corpora.articulated_assets``.

Cabinets of robot benchmarks, which are not part of the project (``--data`` says where they are), are imported, and each
of their joints is captured shut and opened, from two places. Nothing was tuned on them. A joint counts as in
``tests.corpora.articulation``.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

import simfoundry as sf
from simfoundry.capture.articulation.run import articulate
from simfoundry.capture.synthesize import synthesize
from simfoundry.errors import SimfoundryError
from simfoundry.geometry.frames import Array, Pose, look_at
from simfoundry.scene.kinematics import link_poses
from simfoundry.scene.model import Camera, Joint, JointType, Scene
from tests.cli.command import run
from tests.corpora.articulation import AXIS_DEG, HINGE
from tests.corpora.captures import DATA

# The files, and the direction from which the front is seen in their frame [deg], counterclockwise from x.
SEKTION = "sektion_cabinet_model"
ASSETS = {
    f"{SEKTION}/urdf/sektion_cabinet.urdf": 0.0,
    "libero/articulated_objects/white_cabinet.xml": -90.0,
    "libero/articulated_objects/wooden_cabinet.xml": -90.0,
    "libero/articulated_objects/short_cabinet.xml": -90.0,
}

# Share of the range to which a joint is opened, angles of the camera around the front and above it [deg], and distance
# in sizes of the cabinet.
OPENED, AROUND, ABOVE, AWAY = 0.6, (-25.0, 20.0), 30.0, 2.0


@dataclass(frozen=True, eq=False)
class Case:
    """A joint of an imported cabinet, opened in front of a camera."""

    name: str
    joint: Joint
    axis: Array
    pivot: Array
    X_WC: Pose
    shut: Path
    opened: Path


def cases(data: Path, folder: Path, seed: int) -> Iterator[Case]:
    """Yield two captures of each joint from each place."""
    for relative, facing in ASSETS.items():
        name = Path(relative).stem
        asset = folder / name / f"{name}.asset.yaml"
        package = ["--package", f"{SEKTION}={data / SEKTION}"] if relative.startswith(SEKTION) else []
        done = run("import", data / relative, "-o", asset, *package)
        assert done.code in (0, 1), done.err
        shut = _scene(folder / name, asset, {})
        thing = shut.object("it")
        moving = [joint for joint in thing.joints if joint.has_axis and joint.limits is not None]
        low = _lowest(shut)
        for joint in moving:
            end = max(joint.limits or (0.0, 0.0), key=abs)
            for k, around in enumerate(AROUND):
                where = folder / name / f"{joint.name}_{k}"
                camera = _camera(shut, facing + around)
                opened = _scene(folder / name, asset, {joint.name: OPENED * end}, low)
                still = _scene(folder / name, asset, {}, low)
                pair = [synthesize(s, camera, where / s.name, seed + k).parent for s in (still, opened)]
                X_WL = still.object("it").X_WO @ link_poses(still.object("it"), {})[joint.child]
                sign = 1.0 if end > 0 else -1.0
                yield Case(f"{name} {joint.name}", joint, sign * X_WL.rotation @ joint.axis, X_WL.p, camera.X_WC, *pair)


def _scene(folder: Path, asset: Path, joints: dict[str, float], low: float = 0.0) -> Scene:
    """Return a cabinet on a floor, with its lowest point at ``low`` [m] before it is moved."""
    name = "opened" if joints else "shut"
    path = folder / f"{name}.scene.yaml"
    values = ", ".join(f"{joint}: {value:.6f}" for joint, value in joints.items())
    path.write_text(
        f"simfoundry: scene/1\nname: {name}\nobjects:\n"
        "  floor: {fixed: true, mass: 20, shape: {box: [6, 6, 0.04]}, pose: {xyz: [0, 0, -0.02]}}\n"
        f"  it: {{asset: {asset.name}, fixed: true, joints: {{{values}}}, pose: {{xyz: [0, 0, {-low:.5f}]}}}}\n"
    )
    return sf.load(path).lower()


def _lowest(scene: Scene) -> float:
    from simfoundry.render.surface import scene_surface

    surface = scene_surface(scene)
    return float(surface.corners[surface.object == 1][..., 2].min())


def _camera(scene: Scene, azimuth_deg: float) -> Camera:
    from simfoundry.render.surface import scene_surface

    surface = scene_surface(scene)
    corners = surface.corners[surface.object == 1].reshape(-1, 3)
    low, high = corners.min(axis=0), corners.max(axis=0)
    size = float(np.linalg.norm(high - low))
    center = np.array([*((low + high) / 2)[:2], (high - low)[2] / 2])
    azimuth, above = np.radians(azimuth_deg), np.radians(ABOVE)
    away = np.array([np.cos(azimuth) * np.cos(above), np.sin(azimuth) * np.cos(above), np.sin(above)])
    distance = max(0.5, AWAY * size)
    return Camera("front", 640, 480, 600.0, 600.0, 319.5, 239.5, look_at(center + distance * away, center))


def main() -> int:
    """Print each joint and the totals."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--data", type=Path, default=DATA / "articulated", metavar="DIR", help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    if not options.data.is_dir():
        print(f"not run: it needs assets that are not in {options.data}; name their folder with --data")
        return 0
    count = types = good = silent = 0
    with tempfile.TemporaryDirectory() as temporary:
        for k, case in enumerate(cases(options.data, Path(temporary), options.seed)):
            count += 1
            try:
                found = articulate(case.shut, [case.opened], Path(temporary) / f"{k}.asset.yaml")
            except SimfoundryError as error:
                print(f"{case.name:<40} refused: {error}", flush=True)
                continue
            motion, X_VC = found.estimate.motion, found.X_WC
            is_type = motion.kind is case.joint.type
            inverse = case.X_WC.inverse()
            axis, pivot = case.X_WC.rotation.T @ case.axis, inverse.apply(case.pivot[None])[0]
            cosine = float((X_VC.rotation.T @ motion.axis) @ axis)
            angle = float(np.degrees(np.arccos(np.clip(cosine, -1, 1))))
            off = X_VC.inverse().apply(motion.pivot[None])[0] - pivot
            aside = 0.0 if motion.kind is JointType.PRISMATIC else float(np.linalg.norm(np.cross(off, axis)))
            is_good = is_type and angle < AXIS_DEG and aside < HINGE
            types, good, silent = types + is_type, good + is_good, silent + (not is_good and not found.doubt)
            print(
                f"{case.name:<40} {motion.kind.value:<10} axis {angle:5.1f} deg  hinge {100 * aside:4.1f} cm  "
                f"{'ok' if is_good else 'WRONG'} {found.doubt}",
                flush=True,
            )
    print(f"type {types} of {count}, joint {good} of {count}, wrong without a doubt {silent}")
    return int(good < 0.8 * count)


if __name__ == "__main__":
    sys.exit(main())
