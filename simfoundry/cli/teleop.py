"""The command ``teleop``."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from simfoundry.api.ranges import RANGES
from simfoundry.cli import output
from simfoundry.cli.options import FILE, NEW_FOLDER, option

if TYPE_CHECKING:
    from simfoundry.teleop.run import TeleopReport

DEVICES = ("keyboard", "gizmo", "spacemouse", "joints", "vr")


@output.subcommand("teleop")
@click.argument("task", type=FILE)
@option("-d", "--device", type=click.Choice(DEVICES), default="keyboard", help="What the person moves.")
@click.option("--at", metavar="ADDRESS", default="",
              help="Place of the device: a file such as /dev/ttyUSB0, tcp://HOST:PORT or udp://HOST:PORT.")  # fmt: skip
@click.option("--leader", type=FILE, metavar="FILE", help="YAML file that lists the Dynamixel servos of leader arms.")
@option("-o", "--out", type=NEW_FOLDER, default=Path("demos"))
@click.option("-n", "--count", type=click.IntRange(*RANGES["count"]),
              help="Number of demonstrations in OUT. Default: until the person ends the session.")  # fmt: skip
@option("--seed", type=click.IntRange(*RANGES["seed"]), default=0, help="Seed for the initial states.")
@click.option("--hz", type=click.FloatRange(1, 200), metavar="HZ",
              help="Actions per second. Default: the least multiple of the task's rate from 30 on.")  # fmt: skip
@option("--speed", type=click.FloatRange(0, 1, min_open=True), default=0.2,
        help="Speed of the hand [m/s] with keys, or at full deflection.")  # fmt: skip
@option("--turn-speed", type=click.FloatRange(0, 5, min_open=True), default=0.8, help="The same for turning [rad/s].")
@option("--scale", type=click.FloatRange(0, 10, min_open=True), default=1.0,
        help="Motion of the hand for each meter of a VR controller.")  # fmt: skip
@click.option("--yaw", "yaw_deg", type=click.FloatRange(-360, 360), metavar="DEG",
              help="Direction in the world that is forward for the person. Default: the robot's x axis.")  # fmt: skip
@click.option("--record-stream", type=click.Path(path_type=Path, dir_okay=False), metavar="FILE",
              help="Write everything that the device sends to a new file.")  # fmt: skip
@click.option("--replay-stream", type=FILE, metavar="FILE",
              help="Repeat a recorded session from its file, without the device and as fast as possible.")  # fmt: skip
@option("--host", default="localhost", help="Address of the page; others than this machine's need a token.")
@option("--port", type=click.IntRange(0, 65535), default=8080, help="Port; if it is taken, the next free one is used.")
@click.option("--token", default="", help="Token that browsers must know. Default: random if it is required.")
@click.pass_context
def teleop_command(
    context: click.Context, /, task: Path, out: Path, count: int | None, replay_stream: Path | None,
    record_stream: Path | None, as_json: bool, **options: Any,
) -> int:  # fmt: skip
    """Record demonstrations of TASK that a person gives with a device.

    A page in the browser shows the running world, the goal and the sub-tasks. The session runs in real time: reach the
    goal, and save the rollout (Enter) or discard it (Backspace); T tries again from the same initial state, P pauses,
    and M marks the end of a sub-task. Saved rollouts are replayed in another process and kept if the trajectory is
    identical to the last bit, as in `simfoundry record`. Existing demonstrations in OUT are kept.

    \b
    keyboard    keys of the page (W S A D R F move, Q E I K J L turn, Space grips)
    gizmo       arrows and rings at the hand, dragged on the page
    spacemouse  a SpaceMouse at this machine
    joints      a leader arm such as GELLO or JoyLo, at a serial line (--leader) or a socket
    vr          VR controllers, by WebXR on the page or over a socket

    If the device is unplugged or silent, the session pauses until it is back. docs/teleoperation.md describes units,
    frames and packets.

    The exit code is 1 if a replay was not identical, or if COUNT was not reached.
    """
    from simfoundry.teleop.run import MAX_COUNT, replay_session

    wanted = count or MAX_COUNT
    if replay_stream is not None:
        _refuse_live_options(context)
        report = replay_session(task, replay_stream, out, wanted)
    else:
        report = _run_live(task, out, wanted, record_stream, as_json, options)
    output.print_result(as_json, _facts(report, out), _text(report, out))
    is_short = count is not None and report.summary.kept < count
    return output.FINDINGS if is_short or NOT_IDENTICAL in report.summary.failures else output.DONE


NOT_IDENTICAL = "not reproduced"


def _refuse_live_options(context: click.Context) -> None:
    """Refuse options that only a device in real time needs; a stream contains all of them."""
    allowed = ("task", "out", "count", "replay_stream", "as_json")
    given = [
        parameter for parameter in context.command.params
        if parameter.name not in allowed and parameter.name is not None
        and context.get_parameter_source(parameter.name) is click.core.ParameterSource.COMMANDLINE
    ]  # fmt: skip
    if given:
        raise click.UsageError(
            f"{given[0].opts[-1]} has no effect with --replay-stream; the stream contains its settings"
        )


def _run_live(
    task: Path, out: Path, count: int, record_stream: Path | None, as_json: bool, options: dict[str, Any]
) -> TeleopReport:
    from simfoundry.teleop.live import DeviceAddress, LivePlan, run_live
    from simfoundry.teleop.settings import DeviceOptions

    names = ("speed", "turn_speed", "scale", "yaw_deg")
    plan = LivePlan(
        task, out, options["device"], count, options["seed"], options["hz"],
        DeviceOptions(**{name: options[name] for name in names}), DeviceAddress.parse(options["at"]),
        options["leader"], record_stream, options["host"], options["port"], options["token"],
    )  # fmt: skip

    def ready(address: str) -> None:
        click.echo(f"{task} runs at {address}; end the session there, or with Ctrl+C", err=as_json)
        sys.stdout.flush()

    return run_live(plan, ready)


def _facts(report: TeleopReport, out: Path) -> dict[str, Any]:
    summary = report.summary
    return {
        "folder": str(out),
        "device": report.device,
        "control_hz": report.action_hz,
        "demonstrations": summary.kept,
        "attempts": summary.attempts,
        "saved": summary.saved,
        "retries": summary.retries,
        "failures": dict(summary.failures),
        "trajectories": list(summary.digests),
        "steps": report.steps,
        "late_steps": report.late,
        "reaction_ms": dict(report.reaction_ms),
        "refused": dict(report.refused),
        "dropped": report.dropped,
    }


def _text(report: TeleopReport, out: Path) -> str:
    summary = report.summary
    lines = [f"{out}: {output.plural(summary.kept, 'demonstration')}, {summary.saved} of them saved now"]
    ends = [f"{count} {end}" for end, count in summary.failures.items()]
    ends += [f"{summary.retries} repeated"] if summary.retries else []
    lines += [f"other attempts: {', '.join(ends)}"] if ends else []
    if report.reaction_ms:
        pace = f"{report.late} of {report.steps} actions began late"
        times = "{median:g} ms (95 % within {p95:g} ms, longest {max:g} ms)".format_map(report.reaction_ms)
        lines.append(f"{pace}; the robot reacted after {times}")
    lines += [f"{count} packets were refused because {reason}" for reason, count in report.refused.items()]
    lines += [f"{report.dropped} packets were dropped, because too many arrived at once"] if report.dropped else []
    return "\n".join(lines)
