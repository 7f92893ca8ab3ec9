"""The generator of the support matrix in the documentation: ``python -m simfoundry.targets.generated [--check]``."""

from __future__ import annotations

import sys
from pathlib import Path

from simfoundry.backends import BACKENDS, features_of
from simfoundry.backends.features import FEATURES, Fidelity, SupportCell
from simfoundry.runtime.files import write_atomically
from simfoundry.targets.compile import RULES
from simfoundry.targets.find import Target, find_target, target_names

PAGE = "docs/support.md"
MARKS = {None: "✓", Fidelity.APPROXIMATED: "≈", Fidelity.DROPPED: "–", Fidelity.REJECTED: "✗"}
_GROUPS = {"scene": "Scenes", "object": "Objects", "body": "Bodies", "joint": "Joints"}


def cells_of(target: Target) -> dict[str, SupportCell]:
    """Return the fidelity of each feature in a target, based on its backend's table and the changes in its profile."""
    cells = dict(features_of(target.backend))
    profile = target.profile
    for name, how in profile.restores.items():
        cells[name] = SupportCell(None, how)
    for name, rule in profile.combines.model_dump(exclude_none=True).items():
        reason = f"uses {RULES[rule][0]} of the two values; exact if the values are equal"
        cells[name] = SupportCell(Fidelity.APPROXIMATED, reason)
    for name, gap in profile.gaps.items():
        cells[name] = SupportCell(Fidelity(gap.fidelity), f"{gap.reason} ({gap.kind})")
    return cells


def support_page() -> str:
    """Return the page with the matrix and all reasons, generated from the ``support.md.jinja`` template."""
    from jinja2 import Environment, StrictUndefined

    columns = []
    for target in map(find_target, target_names()):
        cells, is_simulator = cells_of(target), target.name not in BACKENDS
        inherited = features_of(target.backend) if is_simulator else {}
        own = {n: cells[n] for n in FEATURES if cells[n].reason and cells[n] != inherited.get(n)}
        columns.append({"profile": target.profile, "cells": cells, "own": own, "is_simulator": is_simulator})
    text = Path(__file__).with_name("support.md.jinja").read_text(encoding="utf-8")
    template = Environment(undefined=StrictUndefined, trim_blocks=True, keep_trailing_newline=True).from_string(text)
    return template.render(columns=columns, features=FEATURES, groups=_GROUPS, marks=MARKS)


def main(arguments: list[str]) -> int:
    """Update the page if it is out of date.

    If ``--check`` is given, only report whether the page is out of date.

    Returns:
        The exit status.
    """
    path, text = Path.cwd() / PAGE, support_page().encode()
    if not path.parent.is_dir():
        print("could not find the `docs` folder; run this command in the root of the repository", file=sys.stderr)
        return 2
    if path.is_file() and path.read_bytes() == text:
        return 0
    if "--check" in arguments:
        print(f"{PAGE} is out of date; run `make schemas`", file=sys.stderr)
        return 1
    write_atomically(path, text)
    print(f"wrote {PAGE}")
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
