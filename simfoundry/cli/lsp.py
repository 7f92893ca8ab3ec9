"""The command ``lsp``, which editors run."""

from __future__ import annotations

import click

from simfoundry.cli import output


@output.subcommand(as_json=False)
@click.option("--stdio", is_flag=True, expose_value=False, help="Accepted because many editors pass it.")
def lsp_command() -> None:
    """Run the language server, which speaks the Language Server Protocol over standard input and output.

    Editors start it themselves; docs/editors.md contains their settings.
    """
    from simfoundry.runtime.extras import need_extra

    need_extra("editor", "the language server")
    from simfoundry.language_server.server import serve

    serve()
