"""SF406: relations of a scene that do not hold in it."""

from __future__ import annotations

from collections.abc import Iterator

from simfoundry.lint.certainty import StartJudge
from simfoundry.lint.lints import Lint, Subject
from simfoundry.lint.report import warning
from simfoundry.spec.diagnostics import Diagnostic
from simfoundry.spec.models.predicate import parse_call


def broken_relations(subject: Subject) -> Iterator[Diagnostic]:
    """Find relations that certainly do not hold.

    Relations of robots are skipped, because a robot may start while it holds an object.
    """
    judge = StartJudge(subject.scene)
    for k, text in enumerate(subject.scene.spec.relations):
        call = parse_call(text)
        if call.declaration.before_motion is None and judge.value(text) is False:
            names = tuple(arg.partition(".")[0] for arg in call.args)
            message = f"`{call}` does not hold: {judge.explanation(text)}"
            hint = "correct the poses, or remove the relation"
            yield warning(subject.loaded, "SF406", ("relations", k), message, hint, names)


LINT = Lint("SF406", ("scene/1",), broken_relations)
