"""Convex decomposition by CoACD, in a process of its own: on a hostile mesh it may crash, hang, or fill the memory."""

from __future__ import annotations

from functools import cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from simfoundry.assets.faults import MeshError
from simfoundry.contain import FailedError, Limits, Worker

Array = NDArray[np.float64]
Faces = NDArray[np.int32]

LIMITS = Limits(seconds=600.0, memory=8 * 2**30)
"""A mesh of two million triangles is through in less."""

FUNCTION = "simfoundry.assets.decompose:run"
"""What the process calls."""

SETTINGS: dict[str, float | int] = {
    "threshold": 0.05,
    "max_convex_hull": 32,
    "seed": 0,
    "max_ch_vertex": 60,
    "mcts_iterations": 40,
    "mcts_nodes": 10,
    "mcts_max_depth": 2,
}


def decompose(name: str, vertices: Array, faces: Faces) -> list[Array]:
    """The corners [m] of the convex pieces of a welded, closed mesh, each of shape (n, 3).

    Raises :class:`MeshError` with the ``name`` of the mesh where CoACD fails.
    """
    try:
        pieces: list[Array] = _worker().call(FUNCTION, vertices, faces)
    except FailedError as error:
        hint = "repair or decimate the mesh, or write `collision: hull`"
        raise MeshError("SF301", f"{name} cannot be decomposed: CoACD {error}", hint) from None
    return pieces


@cache
def settings() -> str:
    """All that the pieces of a mesh depend on beside it."""
    from importlib.metadata import version

    return f"coacd {version('coacd')} {sorted(SETTINGS.items())!r}"


@cache
def _worker() -> Worker:
    """The process of this process: it starts with the first mesh that needs it, and serves all."""
    return Worker(LIMITS)


def run(vertices: Array, faces: Faces) -> list[Any]:
    """Decompose in this process."""
    import coacd

    coacd.set_log_level("error")
    pieces = coacd.run_coacd(coacd.Mesh(vertices, faces), decimate=True, **SETTINGS)
    return [np.asarray(corners, dtype=np.float64) for corners, _ in pieces]
