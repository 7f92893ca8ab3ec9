"""``simfoundry judge``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from simfoundry.cli.options import scene_argument
from simfoundry.cli.output import lower_scene, print_json, subcommand
from simfoundry.errors import SimfoundryError


@subcommand()
@scene_argument
@click.argument("conditions", nargs=-1)
def command(scene: Path, conditions: tuple[str, ...], as_json: bool) -> int:
    """Judge predicates in a scene, such as 'Inside(cup, bowl)': value, margin and explanation.

    Without predicates, the scene's own relations are judged. The exit code is 1 if one does not hold.
    """
    from simfoundry.predicates import Judge, PredicateError
    from simfoundry.scene.state import SceneState
    from simfoundry.spec.models.predicate import ExpressionError, parse_call

    lowered = lower_scene(scene, as_json)[2]
    judge, state = Judge(lowered), SceneState.initial(lowered)
    rows: list[dict[str, Any]] = []
    for text in conditions or tuple(str(relation) for relation in lowered.relations):
        try:
            name, verdict = str(parse_call(text)), judge(text, state)
        except (ExpressionError, PredicateError) as error:
            raise SimfoundryError(f"{text}: {error}") from None
        rows.append({"condition": name, "value": verdict.value, "margin": verdict.margin, "why": verdict.why})
    if as_json:
        print_json({"verdicts": rows})
    for row in () if as_json else rows:
        click.echo(f"{'true ' if row['value'] else 'false'}  {row['margin']:+.4f}  {row['condition']}: {row['why']}")
    return int(not all(row["value"] for row in rows))
