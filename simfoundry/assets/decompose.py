"""Convex decomposition with CoACD in a subprocess, because it may crash, hang, or exhaust memory on bad meshes."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.errors import MeshError
from simfoundry.runtime.workers import Limits, Worker, WorkerError

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

LIMITS = Limits(seconds=300.0, memory=8 * 2**30)
"""Limits of one mesh; those of YCB take up to a minute of one core."""

FUNCTION = "simfoundry.assets.decompose:run"
"""Function that the subprocess calls."""

MAX_PARTS = 32
"""Largest number of colliders of a mesh; the simulation time is proportional to it."""

SETTINGS: dict[str, float | int] = {
    # Of 0.05, 0.1 and 0.2 measured on YCB: with 0.1 the banana is 3 parts within 6.7 mm (2 within 10 with 0.2) and the
    # mug 32 within 8.6 mm (23 within 12); 0.05 takes up to three times as long, for 6.7 mm where 0.1 has 8.2 (drill).
    "threshold": 0.1,
    "max_convex_hull": MAX_PARTS,
    "seed": 0,
    "max_ch_vertex": 60,
    "resolution": 1000,
    "mcts_iterations": 20,
    "mcts_nodes": 10,
    "mcts_max_depth": 2,
}


def decompose(
    name: str, vertices: Array, faces: Faces, report: Callable[[str], object] = lambda message: None
) -> list[Array]:
    """The corners [m] of the convex pieces of a welded, closed mesh, each of shape (n, 3).

    ``report`` hears every other second how long it takes already. Raises :class:`MeshError` with the ``name`` of the
    mesh where CoACD fails.
    """
    try:
        message = f"cutting {name} into convex parts"
        report(message)
        pieces: list[Array] = _worker().call(
            FUNCTION, vertices, faces, wait=lambda seconds: report(f"{message}, {seconds:.0f} s")
        )
    except WorkerError as error:
        hint = "repair or simplify the mesh, or write `collision: hull`"
        raise MeshError("SF301", f"{name} cannot be decomposed: CoACD {error}", hint) from None
    return pieces


@cache
def settings() -> str:
    """Return the settings that determine the pieces of a mesh."""
    from importlib.metadata import version

    return f"coacd {version('coacd')} {sorted(SETTINGS.items())!r}"


@cache
def _worker() -> Worker:
    """Return the subprocess, which is started for the first mesh and reused for all others."""
    return Worker(LIMITS)


def run(vertices: Array, faces: Faces) -> list[Any]:
    """Decompose in this process."""
    import coacd

    coacd.set_log_level("error")
    pieces = coacd.run_coacd(coacd.Mesh(vertices, faces), decimate=True, **SETTINGS)
    return [np.asarray(corners, dtype=np.float64) for corners, _ in pieces]
