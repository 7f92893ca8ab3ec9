"""Ask the models that are configured for the stages of a reconstruction, and go on without one that fails."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Generic, TypeVar

from simfoundry.capture.findings import MODEL_FAILED, CaptureFinding
from simfoundry.capture.stages.runner import StageRunner, StaleStageError
from simfoundry.errors import PicklableError, SimfoundryError
from simfoundry.models.provenance import ModelIdentity, model_use
from simfoundry.models.setup import ModelSetup
from simfoundry.spec.models.origin import ModelUse

T = TypeVar("T")

# The models that answered, by task.
Makers = Mapping[str, ModelIdentity]

# Failures in a row after which a model is not asked about further objects: one may be due to the object, and a server
# that hangs takes its time limit for each question.
GIVE_UP = 2

# Exceptions that an answer causes if it is well-formed but nothing can be made of it, such as a mesh without volume.
UNUSABLE = (PicklableError, ValueError, ArithmeticError, IndexError)


@dataclass(frozen=True)
class ModelStage:
    """A stage that asks models.

    Attributes:
        tasks: The tasks of the models. The stage runs if a model for the first one is configured; without one for
            another task, the offline method is used.
        otherwise: What becomes of the scene without an answer, as the first half of a hint.
    """

    tasks: tuple[str, ...]
    otherwise: str


# All stages that ask models, by name.
MODEL_STAGES: Mapping[str, ModelStage] = {
    "depth": ModelStage(("complete_depth",), "the holes in the depth are left open"),
    "read": ModelStage(("read_scene",), "the objects are named after color and shape"),
    "masks": ModelStage(("segment",), "the objects are divided by geometry"),
    "inpaint": ModelStage(("inpaint", "complete_depth"), "what is hidden is filled in from the surfaces around it"),
    "mesh": ModelStage(("mesh",), "the solids that were fitted to the depth are used"),
    "refine": ModelStage(("pose",), "the poses are those that were fitted to the depth"),
    "parts": ModelStage(("articulate", "parts"), "the objects have no joints"),
    "background": ModelStage(("splat", "inpaint"), "the scene has no background"),
}


@dataclass(frozen=True, eq=False)
class ModelResult(Generic[T]):
    """The result of a stage that asks models, the digest of its content, and the models, which `origin` states."""

    value: T
    digest: str
    models: tuple[ModelUse, ...]


@dataclass
class StageModels:
    """The models behind the stages of one reconstruction.

    Attributes:
        setup: The configured models, or None to ask none.
        stages: Runs the stages, or reuses their earlier results, so that only questions without an answer are repeated.
        failures: The labels and the reasons of the questions without an answer, by stage.
        in_a_row: Number of questions without an answer since the last answer, by stage.
    """

    setup: ModelSetup | None
    stages: StageRunner
    failures: dict[str, list[tuple[str, str]]] = field(default_factory=dict)
    in_a_row: dict[str, int] = field(default_factory=dict)

    def asks(self, stage: str) -> bool:
        """Return True if a model for the stage is configured."""
        return bool(self.configured(stage))

    def configured(self, stage: str) -> dict[str, str]:
        """Return how the models for a stage are configured, as text on which its results depend, by task.

        The result is empty if the stage is not run.
        """
        if self.setup is None:
            return {}
        found = {task: self.setup.source(task) for task in MODEL_STAGES[stage].tasks}
        used = {task: source.model_dump_json() for task, source in found.items() if source and not source.offline}
        is_run = MODEL_STAGES[stage].tasks[0] in used
        return {**used, "strict": str(self.setup.commercial_only)} if is_run else {}

    def ask(
        self, stage: str, inputs: Mapping[str, str], compute: Callable[[ModelSetup], tuple[T, Makers]], label: str = ""
    ) -> ModelResult[T] | None:
        """Return the result of a stage that asks a model, or None if there is no model or no usable answer.

        Args:
            stage: Name of the stage, of :data:`MODEL_STAGES`.
            inputs: Digests of everything that the result depends on, besides the models.
            compute: Asks the models, makes something of their answers, and returns it with the models.
            label: The object, for a stage that runs once for each object.
        """
        configured, setup = self.configured(stage), self.setup
        if not configured or setup is None:
            return None

        def run() -> tuple[T, tuple[dict[str, object], ...]]:
            if self.in_a_row.get(stage, 0) >= GIVE_UP:
                raise SimfoundryError("the model was not asked again after it failed")
            value, makers = compute(setup)
            return value, tuple(model_use(*maker).model_dump(exclude_none=True) for maker in makers.items())

        try:
            result = self.stages.run(stage, {**inputs, **configured}, run, label)
        except StaleStageError:
            return None
        except UNUSABLE as error:
            self.in_a_row[stage] = self.in_a_row.get(stage, 0) + 1
            self.failures.setdefault(stage, []).append((label, " ".join(str(error).split()) or type(error).__name__))
            return None
        self.in_a_row[stage] = 0
        value, models = result.value
        return ModelResult(value, result.digest, tuple(map(ModelUse.model_validate, models)))

    def findings(self, names: Mapping[str, str]) -> tuple[CaptureFinding, ...]:
        """Return one finding for each stage in which a model failed. ``names`` are those of objects by label."""
        found = []
        for stage, failed in self.failures.items():
            objects = tuple(sorted(names[label] for label, _ in failed if label in names))
            hint = f"{MODEL_STAGES[stage].otherwise}; run again when the model answers"
            found.append(CaptureFinding(MODEL_FAILED, failed[0][1], hint, objects))
        return tuple(found)
