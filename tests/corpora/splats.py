"""Compare splats with other programs: ``python -m tests.corpora.splats --environments DIR [--create]``.

Files are read by plyfile, pygltflib, GaussForge (Niantic's code) and usd-convert-gsplat (NVIDIA), and theirs by
SimFoundry. Images in which a splat is composited with objects are compared with those of MuJoCo Warp, an exact ray
tracer, on a CPU: with one ray a pixel, and with sixteen, which show the area of a pixel as cameras do. Both get the
objects' image and depth from MuJoCo Warp, so that only the splat differs. DIR contains an environment for each;
``--create`` makes missing ones, which takes 2 GB. Prints a table; exits with 1 if a figure is out of its bar.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np
from scipy import ndimage

from simfoundry.geometry.frames import Pose, look_at
from simfoundry.render.backdrop import SplatBackdrop
from simfoundry.scene.model import Camera
from simfoundry.splats.files import read_splat, splat_bytes
from simfoundry.splats.gaussians import GaussianSplat, gaussian_splat
from simfoundry.splats.harmonics import SH0
from simfoundry.splats.projection import project
from simfoundry.splats.raster import composite
from simfoundry.splats.spz import spz_bytes
from simfoundry.splats.y_up import X_ZY, turned_y_up
from tests.corpora.readers.comparison import Report, psnr
from tests.corpora.readers.environments import Environment, create, python_of
from tests.splats.random_splats import random_splat

ENVIRONMENTS = {
    "warp": Environment("", "warp_splats", "python3.11", ("mujoco-warp==4.0.0", "warp-lang")),
    "splats": Environment(
        "", "foreign_splats", "python3.11",
        ("plyfile", "pygltflib", "gaussforge==0.6.0", "usd-convert-gsplat==0.1.15", "usd-core>=26.3"),
    ),
}  # fmt: skip
BAR_DB = 35.0  # of the issue, outside of edges
EDGE_PX = 2  # outlines of objects are blended differently within this distance

WIDTH, HEIGHT, FOV_DEG = 320, 240, 60.0
MODEL = """\
<mujoco><worldbody><light pos="0 0 1.8"/>
<camera name="c" pos="{p}" quat="{q}" fovy="{fov}"/>
<geom type="box" size=".3 .3 .3" pos="-.4 .1 -1.2" rgba=".2 .7 .3 1"/>
<geom type="sphere" size=".3" pos=".4 -.6 -1.6" rgba=".8 .6 .2 1"/>
<geom type="cylinder" size=".15 .5" pos="-1.8 -.8 -.5" rgba=".3 .3 .8 1"/></worldbody></mujoco>
"""
X_CU = Pose.of(q=(0, 1, 0, 0))  # from the axes of a MuJoCo camera


def room(count: int, size: float, seed: int) -> GaussianSplat:
    """Return the walls of a room of 4 m, a curtain through its objects, and mist, as flat Gaussians of ``size`` [m]."""
    rng = np.random.default_rng(seed)
    face, uv = rng.integers(0, 7, count), rng.uniform(-2, 2, (count, 2))
    p, scales = np.zeros((count, 3)), np.exp(rng.normal(np.log(size), 0.3, (count, 3)))
    for k in range(3):
        on = (face % 3 == k) & (face < 6)
        p[on, k] = np.where(face[on] < 3, -2.0, 2.0)
        p[on, (k + 1) % 3], p[on, (k + 2) % 3] = uv[on].T
        scales[on, k] *= 0.1
    curtain = face == 6
    p[curtain] = np.stack([np.full(curtain.sum(), -0.25), uv[curtain, 0] * 0.4, uv[curtain, 1] * 0.3 - 1.2], axis=1)
    scales[curtain, 0] *= 0.1
    rgb = 0.5 + 0.4 * np.sin(np.stack([2 * p[:, 0] + p[:, 1], 3 * p[:, 1] - p[:, 2], 2 * p[:, 2] + p[:, 0]], axis=1))
    turns = np.tile([1.0, 0, 0, 0], (count, 1)) + rng.normal(0, 0.05, (count, 4))
    opacities = 1 / (1 + np.exp(-rng.normal(1, 1.5, count)))
    return gaussian_splat("room", p, scales, turns, opacities, ((rgb - 0.5) / SH0)[:, None])


def check_images(python: Path, report: Report, count: int, size: float) -> dict[str, Any]:
    """Compare images of one room, and return figures for the table."""
    splat = room(count, size, seed=count)
    X_WC = look_at(np.array([1.5, 1.1, 0.6]), np.array([-0.6, -0.2, -1.0]))
    X_WU = X_WC @ X_CU
    text = MODEL.format(p=" ".join(map(str, X_WU.p)), q=" ".join(map(str, X_WU.q)), fov=FOV_DEG)
    rgba = np.concatenate([splat.harmonics[:, 0] * SH0 + 0.5, splat.opacities[:, None]], axis=1).astype(np.float32)
    with tempfile.TemporaryDirectory() as folder:
        request, answer = Path(folder) / "request.npz", Path(folder) / "answer.npz"
        values: dict[str, Any] = {
            "position": splat.positions,
            "rotation": splat.rotations,
            "scale": splat.scales,
            "rgba": rgba,
        }
        np.savez(request, xml=text, size=(WIDTH, HEIGHT), **values)
        script = Path(__file__).with_name("readers") / "warp_splats.py"
        subprocess.run([str(python), str(script), str(request), str(answer)], check=True, capture_output=True)
        wanted = dict(np.load(answer))
    focal = HEIGHT / 2 / np.tan(np.radians(FOV_DEG / 2))
    camera = Camera("c", WIDTH, HEIGHT, focal, focal, (WIDTH - 1) / 2, (HEIGHT - 1) / 2, X_WC)
    start = time.process_time()
    ellipses = project(splat, X_WC.inverse(), camera)
    backdrop = SplatBackdrop(ellipses, camera, composite(ellipses, camera))
    seconds = time.process_time() - start
    # Without a splat, the depth of a pixel without objects is 0.
    alone = wanted["objects_depth"].astype(np.float64)
    depth = np.where(alone > 0, alone, np.inf)
    on_object = np.isfinite(depth)
    edge = ndimage.binary_dilation(on_object, iterations=EDGE_PX) ^ ndimage.binary_erosion(
        on_object, iterations=EDGE_PX
    )
    crossed = on_object & (depth > backdrop.image.nearest) & ~edge
    row: dict[str, Any] = {"Gaussians": count, "size [m]": size, "CPU [s]": round(seconds, 2)}
    row["cut objects [px]"] = int(crossed.sum())
    for rays in (1, 4):
        found = backdrop.over(wanted[f"objects_{rays}"], depth)
        for name, where in (("all", ~edge), ("cut", crossed)):
            figure = psnr(found[where], wanted[f"composite_{rays}"][where])
            report.at_least(f"image, {rays * rays} rays, {name}", figure, BAR_DB)
            row[f"{name} {rays * rays} rays [dB]"] = round(figure, 1)
    return row


def check_files(python: Path, report: Report) -> None:
    """Compare files with those of other programs."""
    splat = random_splat(500, 3, 7, extremes=False)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        for suffix in (".ply", ".glb"):
            (folder / f"a{suffix}").write_bytes(splat_bytes(splat, f"a{suffix}"))
        for version in (2, 3):
            (folder / f"a{version}.spz").write_bytes(spz_bytes(splat, version))
        script = Path(__file__).with_name("readers") / "foreign_splats.py"
        subprocess.run([str(python), str(script), name], check=True, capture_output=True)
        found = dict(np.load(folder / "values.npz"))
        _check_ply(splat, found, report)
        _check_glb(splat, found, report)
        for version in (2, 3):
            ours = turned_y_up(read_splat(folder / f"a{version}.spz"))
            _check_spz(ours, found, f"a{version}.spz", report)
            # GaussForge takes the axes of the PLY file as they are.
            theirs, ply = turned_y_up(read_splat(folder / f"forge{version}.spz")), read_splat(folder / "a.ply")
            report.close(f"SPZ {version} by GaussForge: positions [m]", theirs.positions, ply.positions, 2**-12)
            report.close(f"SPZ {version} by GaussForge: opacities", theirs.opacities, ply.opacities, 0.51 / 255)
        report.close("USD by NVIDIA", *_columns(read_splat(folder / "nvidia.usda"), splat), 2e-6)


def _check_ply(splat: GaussianSplat, found: dict[str, Any], report: Report) -> None:
    columns = np.stack([found[f"plyfile {n}"] for n in ("x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2")], axis=1)
    report.equal("PLY in plyfile", columns, np.concatenate([splat.positions, splat.harmonics[:, 0]], axis=1))
    rest = np.stack([found[f"plyfile f_rest_{k}"] for k in range(45)], axis=1).reshape(-1, 3, 15).transpose(0, 2, 1)
    report.equal("PLY in plyfile: harmonics", rest, splat.harmonics[:, 1:])
    scales = np.stack([found[f"plyfile scale_{k}"] for k in range(3)], axis=1)
    report.close("PLY in plyfile: scales [log]", scales, np.log(splat.scales), 1e-6)


def _check_glb(splat: GaussianSplat, found: dict[str, Any], report: Report) -> None:
    report.equal("GLB in pygltflib: positions", found["glb POSITION"], splat.positions)
    report.equal("GLB in pygltflib: scales", found["glb KHR_gaussian_splatting:SCALE"], splat.scales)
    xyzw = found["glb KHR_gaussian_splatting:ROTATION"]
    report.equal("GLB in pygltflib: rotations", xyzw[:, [3, 0, 1, 2]], splat.rotations)
    report.close("GLB in pygltflib: node", found["glb rotation"][[3, 0, 1, 2]], X_ZY.inverse().q, 1e-12)
    last = found["glb KHR_gaussian_splatting:SH_DEGREE_3_COEF_6"]
    report.equal("GLB in pygltflib: harmonics", last, splat.harmonics[:, 15])


def _check_spz(ours: GaussianSplat, found: dict[str, Any], name: str, report: Report) -> None:
    """Compare our reading of our file with two other readings of it, along the axes of the file."""
    n = len(ours)
    logit = np.log(np.maximum(ours.opacities, 1e-6) / np.maximum(1 - ours.opacities, 1e-6))
    middle = (ours.opacities > 0.01) & (ours.opacities < 0.99)
    nvidia = {key.split()[-1]: found[key] for key in found if key.startswith(f"nvidia {name}")}
    forge = {key.split()[-1]: found[key].reshape(n, -1) for key in found if key.startswith(f"forge {name}")}
    for who, values, opacity, first, rest in (
        ("NVIDIA", nvidia, nvidia["opacities"], nvidia["f_dc"], nvidia["f_rest"].reshape(n, 15, 3)),
        ("GaussForge", forge, forge["alphas"][:, 0], forge["colors"], forge["sh"].reshape(n, 15, 3)),
    ):
        flips = np.array([1, 1, 1]) if who == "NVIDIA" else _flips(values["positions"], ours.positions)
        report.close(f"{name} in {who}: positions [m]", values["positions"], ours.positions * flips, 1e-6)
        report.close(f"{name} in {who}: scales [log]", values["scales"], np.log(ours.scales), 1e-5)
        report.close(f"{name} in {who}: opacities [logit]", opacity[middle], logit[middle], 1e-4)
        report.close(f"{name} in {who}: colors", first, ours.harmonics[:, 0], 1e-5)
        if (flips == 1).all():
            theirs = values["rotations"] / np.linalg.norm(values["rotations"], axis=1, keepdims=True)
            turns = np.abs((theirs * ours.rotations).sum(axis=1))
            report.close(f"{name} in {who}: rotations (1 - |q . q'|)", turns, np.ones(n), 1e-5)
            report.close(f"{name} in {who}: harmonics", rest, ours.harmonics[:, 1:], 1e-5)


def _flips(theirs: np.ndarray, ours: np.ndarray) -> np.ndarray:
    return np.asarray(np.sign((theirs * ours).sum(axis=0)))


def _columns(one: GaussianSplat, two: GaussianSplat) -> tuple[np.ndarray, np.ndarray]:
    sign = np.sign((one.rotations * two.rotations).sum(axis=1, keepdims=True))
    parts = [
        (s.positions, s.scales, s.rotations * turn, s.opacities[:, None], s.harmonics.reshape(len(s), -1))
        for s, turn in ((one, sign), (two, 1.0))
    ]
    return np.concatenate(parts[0], axis=1), np.concatenate(parts[1], axis=1)


def main() -> int:
    """Run the checks and print tables."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--environments", type=Path, required=True)
    parser.add_argument("--create", action="store_true")
    options = parser.parse_args()
    report = Report()
    if options.create:
        for name, environment in ENVIRONMENTS.items():
            create(options.environments / name, environment)
    check_files(python_of(options.environments, "splats"), report)
    rooms = ((20_000, 0.04), (20_000, 0.08), (100_000, 0.02))
    rows = [check_images(python_of(options.environments, "warp"), report, *case) for case in rooms]
    print(" | ".join(rows[0]))
    for row in rows:
        print(" | ".join(map(str, row.values())))
    for name, check in report.checks.items():
        print(f"{'ok  ' if check['ok'] else 'FAIL'} {name}: {check['measure']} {check['figure']}")
    return 0 if all(check["ok"] for check in report.checks.values()) else 1


if __name__ == "__main__":
    sys.exit(main())
