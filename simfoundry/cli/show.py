"""``simfoundry show``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from simfoundry.cli.output import json_option, print_json, progress_bar, reporting


@click.command()
@click.argument("scene", type=click.Path(path_type=Path, exists=True, dir_okay=False))
@json_option
@reporting
def command(scene: Path, as_json: bool) -> None:
    """Show a scene as a tree: sizes, masses, joints, and what stands on what."""
    from simfoundry.assets.cache import Cache
    from simfoundry.scene.lower import lower
    from simfoundry.scene.summary import summary, tree
    from simfoundry.spec.load import load_scene
    from simfoundry.spec.models.scene import SceneSpec

    loaded = load_scene(scene)
    assert isinstance(loaded.spec, SceneSpec)
    with progress_bar(as_json) as progress:
        lowered = lower(loaded, Cache.default(), lambda name, done, total: progress(name, done / total), fetch=False)
    facts: dict[str, Any] = summary(lowered, loaded.spec)
    if as_json:
        print_json(facts)
    else:
        click.echo(tree(facts))
