"""An executor on a Ray cluster, whose results survive the loss of nodes.

Each Ray actor runs a local :class:`~simfoundry.runtime.workers.Worker`, so calls have the same limits as in local
worker processes, and a crash has the same message. If an actor is lost with its node, its call is repeated by another
actor, and a new actor starts as soon as the cluster has room for it.

All nodes must have the same version of SimFoundry, and the same files at the same paths, for example on a shared file
system.
"""

from __future__ import annotations

import logging
import os
import socket
import sys
import time
from collections import deque
from contextlib import chdir, suppress
from dataclasses import dataclass
from pathlib import Path
from pkgutil import resolve_name
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from simfoundry.errors import MissingEngineError, SimfoundryError
from simfoundry.runtime.extras import install_line
from simfoundry.runtime.parallel import usable_cores
from simfoundry.runtime.workers import Worker, WorkerError

if TYPE_CHECKING:
    from simfoundry.runtime.executors import JobLimits

# Maximum number of nodes that a call may lose. More losses suggest that the call itself brings nodes down.
MAX_LOSSES = 8

# Maximum number of actors in a row that fail to start, which happens if SimFoundry is not installed on a node.
MAX_FAILED_STARTS = 8

# Maximum time to wait for a node without any working actor [s]; cloud instances take a few minutes to start.
MAX_WAIT_S = 600.0

# Time limit for a connection to the head node [s]; far more than a round trip in any network.
CONNECT_S = 10.0

# Interval at which lost connections and interrupts are noticed [s].
POLL_S = 2.0

# Object store of a cluster that is started on this machine [bytes]; a result takes less than 10 MB.
STORE_BYTES = 256 * 2**20

# Prefixes of the environment variables that workers inherit.
INHERITED = ("SIMFOUNDRY_", "MUJOCO_GL", "PYOPENGL_PLATFORM")


@dataclass
class _Call:
    """A submitted call, and the number of actors that were lost while they executed it."""

    key: Any
    function: str
    arguments: tuple[Any, ...]
    attempts: int
    losses: int = 0


class RayExecutor:
    """An executor that calls functions on the nodes of a Ray cluster.

    Args:
        address: Address of the cluster. If it is empty, ``RAY_ADDRESS`` is used; if that is not set either, a cluster
            is started on this machine.
        size: Number of actors. By default, one per CPU of the cluster.
        limits: The limits of each call.
    """

    def __init__(self, address: str, size: int | None, limits: JobLimits) -> None:
        try:
            import ray as module
        except ModuleNotFoundError:
            raise MissingEngineError(f"`--on ray` requires ray; install it with `{install_line('ray')}`") from None
        ray: Any = module
        self._ray, self._owns = ray, not ray.is_initialized()
        if self._owns:
            _connect(ray, address or os.environ.get("RAY_ADDRESS", ""), size)
        self.size = size or max(1, int(ray.cluster_resources().get("CPU", 1)))
        self._setup = str(Path.cwd()), {k: v for k, v in os.environ.items() if k.startswith(INHERITED)}, limits
        self._actor_class = ray.remote(num_cpus=1, max_restarts=0)(_Actor)
        self._starting: dict[Any, Any] = {}  # actors by the reference to their version
        self._idle: list[Any] = []
        self._waiting: deque[_Call] = deque()
        self._running: dict[Any, tuple[_Call, Any]] = {}  # calls and their actors by the reference to the result
        self._failed_starts = 0
        for _ in range(self.size):
            self._start()

    def submit(self, key: Any, function: str, *arguments: Any, attempts: int = 1) -> None:
        """Queue a call to ``module:function``. If the call fails, it is retried, up to ``attempts`` calls in total."""
        self._waiting.append(_Call(key, function, arguments, attempts))
        self._hand_out()

    def next(self) -> tuple[Any, Any]:
        """Wait for a call to finish, and return its key and either its result or a :class:`WorkerError`.

        Raises:
            SimfoundryError: If no node can execute calls.
        """
        alone_since = time.monotonic()
        while True:
            references = [*self._running, *self._starting]
            for reference in self._ray.wait(references, num_returns=1, timeout=POLL_S)[0]:
                if reference in self._starting:
                    self._started(reference)
                elif (finished := self._finished(reference)) is not None:
                    return finished
            self._hand_out()
            if self._running:
                alone_since = time.monotonic()
            elif time.monotonic() - alone_since > MAX_WAIT_S:
                raise SimfoundryError(
                    f"the Ray cluster has had no free CPU for {MAX_WAIT_S:g} s; add nodes, and repeat the command"
                )

    def close(self, grace_s: float = 0.0) -> None:
        """Stop the actors, and disconnect from the cluster if this executor has connected to it."""
        ended = [actor.close.remote(grace_s) for actor in self._idle] if grace_s else []
        if ended:
            self._ray.wait(ended, num_returns=len(ended), timeout=grace_s)
        for actor in (*self._idle, *self._starting.values(), *(actor for _, actor in self._running.values())):
            with suppress(Exception):  # the actor may be lost
                self._ray.kill(actor)
        self._idle, self._starting, self._running = [], {}, {}
        if self._owns:
            self._ray.shutdown()

    def _start(self) -> None:
        actor = self._actor_class.remote(*self._setup)
        self._starting[actor.version.remote()] = actor

    def _started(self, reference: Any) -> None:
        actor = self._starting.pop(reference)
        try:
            found = self._ray.get(reference)
        except self._ray.exceptions.RayError as error:
            self._failed_starts += 1
            if self._failed_starts >= MAX_FAILED_STARTS:
                raise SimfoundryError(f"workers cannot start on the Ray cluster: {_last_line(error)}") from None
            self._start()
            return
        if found != _version():
            raise SimfoundryError(
                f"a node of the Ray cluster has SimFoundry {found}, not {_version()}; install the same version on all "
                "nodes"
            )
        self._failed_starts = 0
        self._idle.append(actor)

    def _finished(self, reference: Any) -> tuple[Any, Any] | None:
        """Return the key and the result of a call, or None if the actor was lost, and the call starts again."""
        call, actor = self._running.pop(reference)
        try:
            result = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as error:
            result = WorkerError(f"failed ({_last_line(error)})")
        except self._ray.exceptions.RayError:
            with suppress(Exception):  # the actor may be reachable again, but its result is not
                self._ray.kill(actor)
            self._start()
            call.losses += 1
            if call.losses > MAX_LOSSES:
                return call.key, WorkerError(f"was lost with {call.losses} nodes of the Ray cluster")
            self._waiting.appendleft(call)
            return None
        self._idle.append(actor)
        return call.key, result

    def _hand_out(self) -> None:
        while self._idle and self._waiting:
            actor, call = self._idle.pop(), self._waiting.popleft()
            self._running[actor.call.remote(call.function, call.arguments, call.attempts)] = call, actor


class _Actor:
    """A worker process on a node, in the folder and with the variables of the calling process."""

    def __init__(self, folder: str, environment: dict[str, str], limits: JobLimits) -> None:
        os.environ.update(environment)
        try:
            os.chdir(folder)
        except OSError as error:
            reason = f"the folder does not exist on a node: {error}; use a file system that all nodes share"
            raise SimfoundryError(reason) from None
        self._worker = Worker(limits.on_machine(usable_cores()))

    def version(self) -> str:
        """Return the version of SimFoundry on this node."""
        return _version()

    def call(self, function: str, arguments: tuple[Any, ...], attempts: int) -> Any:
        """Call a function, and return its result or a :class:`WorkerError`."""
        for attempt in range(attempts):
            try:
                return self._worker.call(function, *arguments)
            except WorkerError as error:
                if attempt == attempts - 1:
                    return error
        raise AssertionError("there is at least one attempt")

    def close(self, grace_s: float) -> None:
        """Stop the worker process."""
        self._worker.close(grace_s)


def _version() -> str:
    # The package imports higher layers, so this module does not import it.
    return str(resolve_name("simfoundry:__version__"))


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1].strip()


def _connect(ray: Any, address: str, size: int | None) -> None:
    """Connect to a cluster, or start one on this machine with this process's import path.

    Ray puts the driver's working directory first on the import path. In a checkout, this directory would shadow the
    installed package, so Ray is started from an empty folder.
    """
    options: dict[str, Any] = {"address": address}
    if address:
        _require_reachable(address)
    else:
        paths = os.pathsep.join(str(Path(p).absolute()) for p in sys.path if p)
        options = {"num_cpus": size or usable_cores(), "include_dashboard": False, "object_store_memory": STORE_BYTES}
        options["runtime_env"] = {"env_vars": {"PYTHONPATH": paths}}
    with TemporaryDirectory(prefix="simfoundry-ray-") as empty, chdir(empty):
        try:
            ray.init(log_to_driver=False, logging_level=logging.ERROR, **options)
        except Exception as error:  # Ray has no common class for these errors
            what = f"connect to the Ray cluster at `{address}`" if address else "start a Ray cluster on this machine"
            raise SimfoundryError(f"cannot {what}: {_last_line(error)}") from None


def _require_reachable(address: str) -> None:
    """Check that a server listens at the address of a cluster, because Ray tries for minutes and ends the process."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if not port.isdecimal():  # `auto`, or an address that Ray rejects
        return
    try:
        socket.create_connection((host, int(port)), CONNECT_S).close()
    except (OSError, OverflowError) as error:
        raise SimfoundryError(f"cannot connect to the Ray cluster at `{address}`: {error}") from None
