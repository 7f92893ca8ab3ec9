"""Demonstrations by people."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from simfoundry.api.ranges import check_ranges
from simfoundry.errors import SimfoundryError

if TYPE_CHECKING:
    from simfoundry.data.demonstrations import DemonstrationSet


def teleoperate(
    task: str | Path,
    device: str = "keyboard",
    *,
    at: str = "",
    leader: str | Path | None = None,
    out: str | Path = "demos",
    count: int | None = None,
    seed: int = 0,
    record_stream: str | Path | None = None,
    replay_stream: str | Path | None = None,
) -> DemonstrationSet:
    """Record demonstrations of a task that a person gives, until there are enough or the person ends the session.

    Example: ``teleoperate("stack.task.yaml", "spacemouse", count=10)``.

    The address of the page is printed. Demonstrations that are already in ``out`` are kept.

    Args:
        task: A task document.
        device: The device, named as on the command line.
        at: The address of the device, as on the command line.
        leader: The file that lists the servos of leader arms.
        out: Output folder.
        count: Number of demonstrations; by default, the person ends the session.
        seed: Seed for the initial states.
        record_stream: A new file for everything that the device sends.
        replay_stream: A stream to repeat instead of using a device. It contains the device and the seed.

    Raises:
        SpecError: If the task document has errors.
        SimfoundryError: If an option or the stream is invalid, or if the device cannot be used.
    """
    from simfoundry.api.demonstrations import demonstrations
    from simfoundry.teleop.live import DeviceAddress, LivePlan, run_live
    from simfoundry.teleop.run import MAX_COUNT, replay_session

    check_ranges([("count", count), ("seed", seed)])
    wanted = count or MAX_COUNT
    if replay_stream is not None:
        if record_stream is not None:
            raise SimfoundryError(
                "a replayed stream is not recorded again; set either `record_stream` or `replay_stream`"
            )
        replay_session(Path(task), Path(replay_stream), Path(out), wanted)
        return demonstrations(out)
    plan = LivePlan(
        Path(task),
        Path(out),
        device,
        wanted,
        seed,
        at=DeviceAddress.parse(at),
        leader=None if leader is None else Path(leader),
        stream=None if record_stream is None else Path(record_stream),
    )
    run_live(plan, lambda address: print(f"{task} runs at {address}"))
    return demonstrations(out)
