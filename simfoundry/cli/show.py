"""``simfoundry show``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from simfoundry.cli.options import scene_argument
from simfoundry.cli.output import lower_scene, print_json, subcommand


@subcommand()
@scene_argument
def command(scene: Path, as_json: bool) -> None:
    """Show a scene as a tree: sizes, masses, joints, and support relations."""
    from simfoundry.scene.summary import summary, tree

    _, spec, lowered = lower_scene(scene, as_json, fetch=False)
    facts: dict[str, Any] = summary(lowered, spec)
    if as_json:
        print_json(facts)
    else:
        click.echo(tree(facts))
