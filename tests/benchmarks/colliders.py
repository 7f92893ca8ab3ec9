"""What meshes collide as, how far that is from them, and how long it takes to find: a line for each mesh of a folder.

    python -m tests.benchmarks.colliders FOLDER [--like banana]

FOLDER holds a folder for each object with an OBJ in it, as the YCB-Video objects come. The thresholds in
:mod:`simfoundry.assets.convex` and :mod:`simfoundry.assets.convex` were chosen by it.
"""

from __future__ import annotations

import argparse
import time
from pathlib import Path

import numpy as np

from simfoundry.assets import mass
from simfoundry.assets.convex import hull, mesh_colliders
from simfoundry.assets.deviation import deviation
from simfoundry.assets.mesh import read_mesh, weld


def main() -> None:
    """Measure every mesh, without a cache."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("--like", default="", help="only meshes with this in their path")
    arguments = parser.parse_args()
    print(
        "fill: volume over that of the hull; hull, error: greatest distance from the mesh, mm and % of the longest side"
    )
    for file in sorted(arguments.folder.glob("*/*.obj")):
        if arguments.like in str(file):
            print(row(file), flush=True)


def row(file: Path) -> str:
    """The measurements of one mesh."""
    pieces = read_mesh(file)
    offsets = np.cumsum([0, *(len(p.vertices) for p in pieces)])
    joined = np.concatenate([p.faces + o for p, o in zip(pieces, offsets, strict=False)]).astype(np.int32)
    vertices, faces = weld(np.concatenate([p.vertices for p in pieces]), joined)
    size = float(np.ptp(vertices, axis=0).max())
    fill = mass.mesh(vertices, faces).volume / mass.mesh(*hull(vertices, limit=len(vertices))).volume
    plain = deviation(vertices, faces, [hull(vertices)])
    start = time.perf_counter()
    found = mesh_colliders(vertices, faces, "auto")
    took = time.perf_counter() - start
    kind = found.primitive.kind if found.primitive is not None else f"{len(found.parts)} convex"
    shown = [f"{1e3 * v:5.1f} mm {100 * v / size:4.1f}%" for v in (plain, found.error)]
    return f"{file.parent.name:28} fill {fill:.2f}  hull {shown[0]}  {kind:10} error {shown[1]}  {took:5.1f} s"


if __name__ == "__main__":
    main()
