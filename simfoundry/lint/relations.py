"""Relations that do not hold (SF406)."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.lint.report import warning
from simfoundry.lint.sketch import Sketch
from simfoundry.lint.verdicts import verdict
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.loaded import Loaded
from simfoundry.spec.models.expressions import parse_call


def broken(loaded: Loaded, drawn: Sketch) -> Iterator[Diagnostic]:
    """SF406: relations of a scene that certainly do not hold in it."""
    for k, text in enumerate(drawn.spec.relations):
        call = parse_call(text)
        if call.declaration.before_motion is not None:  # a scene may well start with a thing in a gripper
            continue
        found = verdict(call, drawn)
        if found.value is False:
            names = tuple(arg.partition(".")[0] for arg in call.args)
            message = f"`{call}` does not hold: {found.why}"
            yield warning(loaded, "SF406", ("relations", k), message, "mend the poses, or take the relation out", names)
