"""The state of the stages in an output folder: what a new run would reuse, and what it would run again."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from simfoundry.capture.stages.codec import VALUE, decode
from simfoundry.capture.stages.stage import STAGES, Stage, stage_index
from simfoundry.capture.stages.store import ENTRY, stage_folder
from simfoundry.errors import SimfoundryError

# File in the folder of stages that tells what the last run reconstructed.
SOURCE = "source.json"

State = Literal["cached", "stale"]


@dataclass(frozen=True)
class StageStatus:
    """The state of a stage, or of one object in it.

    ``object`` is the name of the object, or its number if it has none yet, and empty for a stage that does not run for
    each object. ``state`` is ``stale`` if a new run would run the stage again, because its inputs or its code changed.
    """

    stage: str
    object: str
    state: State

    def to_json(self) -> dict[str, Any]:
        """Return the state as plain data for JSON."""
        return {"stage": self.stage, "object": self.object, "state": self.state}


def listed_states(states: Mapping[tuple[str, str], str], names: Mapping[str, str]) -> list[StageStatus]:
    """Return the states of all stages in order.

    A stage that was not reached, because an earlier one is stale, is stale.

    Args:
        states: States by stage and label, of a runner that examined.
        names: Names of objects by their labels.
    """
    out = []
    for stage in STAGES:
        labels = [label for name, label in states if name == stage.name]
        if stage.per_object:  # an object that is stale in an earlier stage was not examined in this one
            earlier = {label for (name, label), state in states.items() if state == "stale" and label}
            labels = sorted({*labels, *earlier}, key=lambda label: (not label.isdigit(), len(label), label))
        for label in labels or [""]:
            state: State = "cached" if states.get((stage.name, label)) == "cached" else "stale"
            out.append(StageStatus(stage.name, names.get(label, label), state))
    return out


def write_source(folder: Path, capture: Path, frame: str) -> None:
    """Note in the folder of stages which frame of which capture it belongs to."""
    data = {"capture": str(capture.resolve()), "frame": frame}
    (folder / SOURCE).write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def read_source(folder: Path) -> tuple[Path, str]:
    """Return the capture document and the frame that a folder of stages belongs to.

    Raises:
        SimfoundryError: The folder does not tell.
    """
    try:
        data = json.loads((folder / SOURCE).read_bytes())
        return Path(data["capture"]), str(data["frame"])
    except (OSError, ValueError, KeyError, TypeError):
        raise SimfoundryError(
            f"{folder.parent} is not the output of a capture; specify the folder that `simfoundry capture` wrote"
        ) from None


def last_names(folder: Path) -> dict[int, str]:
    """Return the names that the last run gave to the numbers of objects, or nothing if it gave none."""
    stage: Stage = STAGES[stage_index("name")]
    own = stage_folder(folder, stage)
    try:
        files = json.loads((own / ENTRY).read_bytes())["files"]
        names: dict[int, str] = decode({name: (own / name).read_bytes() for name in files if name == VALUE})
        return {int(k): str(name) for k, name in names.items()}
    except (OSError, ValueError, KeyError, TypeError, AttributeError):
        return {}
