"""The command ``studio``."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from simfoundry.cli import output
from simfoundry.cli.options import ANY, FILE, option


@output.subcommand()
@click.argument("document", type=FILE)
@option("--host", default="localhost", help="Address to listen on; others than this machine's need a token.")
@option("--port", type=click.IntRange(0, 65535), default=8080, help="Port; if it is taken, the next free one is used.")
@click.option("--token", default="", help="Token that browsers must know. Default: random if it is required.")
@option("--capture", type=ANY, help="The capture of the scene. Default: the one in the project that it names.")
@click.option("-p", "--policy", "policies", multiple=True, metavar="POLICY",
              help="Policy that can be tried, as in `simfoundry eval`; may be repeated.")  # fmt: skip
def studio_command(
    document: Path, host: str, port: int, token: str, capture: Path | None, policies: tuple[str, ...], as_json: bool
) -> None:
    """Open a scene or task in the browser, and turn each act there into an edit of the text.

    Nothing is written before you save. The page follows changes of the file, and several windows show the same. No
    display is needed on the machine that runs the command.
    """
    serve_studio(document, as_json, host, port, token, capture=capture, policies=policies)


def serve_studio(
    document: Path,
    as_json: bool,
    host: str = "localhost",
    port: int = 8080,
    token: str = "",
    is_editable: bool = True,
    capture: Path | None = None,
    policies: tuple[str, ...] = (),
) -> None:
    """Serve a document until the user interrupts the program."""
    from simfoundry.runtime.extras import need_extra
    from simfoundry.studio.server import StudioServer, spare_collections

    need_extra("studio", "the studio")
    if capture is not None and capture.is_dir():
        capture = capture / "capture.yaml"
    with StudioServer(document, host, port, token, is_editable, capture, policies) as server:
        spare_collections()
        facts = {"address": server.address, "document": str(server.session.path), "host": host, "port": server.port}
        output.print_result(as_json, facts, f"{document} is open at {server.address}; stop with Ctrl+C")
        sys.stdout.flush()
        try:
            server.wait()
        except KeyboardInterrupt:
            if server.session.is_modified:
                click.echo(
                    "stopped; the next studio of this document offers the edits that have not been saved", err=True
                )
