"""Entry point of the command line interface. To keep startup fast, a command is imported only when it is called."""

from __future__ import annotations

import gc
import importlib
import os
import sys
from itertools import pairwise

import click

from simfoundry import __version__

# Pydantic's plugin search imports a slow module, which would take a tenth of the run time of `check`.
os.environ.setdefault("PYDANTIC_DISABLE_PLUGINS", "__all__")
# NumPy starts a pool of BLAS threads on import, which takes a tenth of the run time of `compile`. While they wait, they
# keep cores busy, which slows `capture` down by a twentieth. No command multiplies matrices large enough to need them.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
gc.set_threshold(100_000)  # there are tens of thousands of long-lived objects, so collecting more often is useless

# The module that defines each command, and a summary of the command.
COMMANDS = {
    "articulate": (
        "articulate",
        "Find the joints of drawers, doors and lids in two captures or a mesh.",
    ),
    "augment": ("data", "Generate demonstrations from recorded ones, in other states, scenes and tasks."),
    "background": ("background", "Convert splats, and align the background of a scene."),
    "capture": ("capture", "Turn a capture folder into a scene."),
    "check": ("documents", "Check documents and show every finding with its location."),
    "compile": ("compile", "Compile a scene for simulators."),
    "configure": ("train", "Write a training configuration for LeRobot, openpi or GR00T."),
    "cousins": ("cousins", "Make variants of a scene or task that preserve its affordances."),
    "correlate": ("evaluate", "Compare simulated success rates with real ones."),
    "dataset": ("dataset", "Build, show and check datasets of demonstrations for training libraries."),
    "demo": ("capture", "Reconstruct, compile and run a scene from an included image or your own."),
    "diff": ("changes", "Show the changes between two documents or revisions."),
    "doctor": ("verify", "Show installed and missing components, and how to install them."),
    "eval": ("evaluate", "Evaluate policies on tasks."),
    "explain": ("language", "Explain a diagnostic code, or list all codes."),
    "export": ("convert", "Write a task as BDDL or in the format of the paper's release."),
    "flatten": ("language", "Write a document in full, with everything it extends and every default."),
    "fmt": ("documents", "Rewrite documents in their canonical form, keeping comments and layout."),
    "git": ("git", "Set up semantic diffs and merges of documents in git."),
    "import": ("convert", "Convert URDF, MJCF, USD, BDDL or files from the paper's release to documents."),
    "judge": ("scenes", "Evaluate predicates in a scene, with margins and explanations."),
    "log": ("changes", "Show what each commit changed in a document."),
    "lsp": ("lsp", "Run the language server for editors."),
    "merge": ("changes", "Merge two edited versions of a document semantically, or resolve conflicts."),
    "migrate": ("documents", "Update documents that were written for older versions."),
    "models": ("models", "Show the foundation models that are configured, and their licences."),
    "new": ("language", "Create a document of any kind, with comments that explain its keys."),
    "propose": ("cousins", "Propose tasks for a scene, each verified to be feasible."),
    "record": ("data", "Record demonstrations of a task."),
    "rename": ("rename", "Rename an object, joint, material or other name in all documents of a project."),
    "render": ("scenes", "Render an image from a camera in a scene."),
    "schema": ("language", "Print the JSON Schemas for documents."),
    "settle": ("scenes", "Simulate a scene until it is at rest, and report how objects moved."),
    "show": ("scenes", "Show a scene as a tree with sizes and masses."),
    "studio": ("studio", "Open a scene or task in the browser, and edit it there."),
    "synthesize": ("scenes", "Render a scene as a synthetic capture with sensor noise."),
    "teleop": ("teleop", "Record demonstrations of a task that a person gives with a device."),
    "train": ("train", "Record demonstrations, train a small policy on them, and evaluate it."),
    "verify": ("verify", "Load builds in real simulators and compare them with the scene."),
}


class _Lazy(click.Group):
    """A command group that imports ``<name>_command`` from the right module in ``simfoundry.cli`` on demand."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in COMMANDS:
            return None
        module = importlib.import_module(f"simfoundry.cli.{COMMANDS[cmd_name][0]}")
        command: click.Command = getattr(module, f"{cmd_name}_command")
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in COMMANDS.items()])

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        if args and args[0] not in COMMANDS and not args[0].startswith("-"):
            from simfoundry.spec.diagnostics import nearest

            ctx.fail(f"unknown command `{args[0]}`; {nearest(args[0], COMMANDS)}")
        return super().resolve_command(ctx, args)


@click.command(cls=_Lazy, context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100})
@click.version_option(__version__, prog_name="simfoundry")
def app() -> None:
    """Turn a captured tabletop into simulator worlds: one typed scene spec, many simulators.

    Exit codes: 0 on success, 1 if there are findings, 2 if the command could not run.
    """


def main() -> None:
    """Run the command line interface."""
    from simfoundry.cli.output import allow_any_text

    allow_any_text()
    try:
        sys.exit(app(prog_name="simfoundry", standalone_mode=False) or 0)
    except click.exceptions.Abort:
        click.echo("stopped", err=True)
        sys.exit(130)
    except click.ClickException as error:
        args = sys.argv[1:]
        if "--json" in args or "--format=json" in args or ("--format", "json") in pairwise(args):
            from simfoundry.cli.output import print_json

            print_json({"error": error.format_message()})
        else:
            error.show()
        sys.exit(2)


if __name__ == "__main__":
    main()
