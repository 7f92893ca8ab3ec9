"""The ``origin`` of a description: the capture, the recipe or the models it came from."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import DIGEST, Agent, FormerKey, Fraction, Model, Name, NonNegative


class CousinOf(Model):
    """The origin of a cousin, which can be reproduced from the recipe, the seed and the index."""

    recipe: Name = Field(description="Name of the recipe.")
    seed: Annotated[int, Field(ge=0)] = Field(description="Seed of the recipe's random choices.")
    index: Annotated[int, Field(ge=1)] = Field(description="Candidate number, starting at 1.")
    generator: Agent = Field("simfoundry", description="The program that generated the cousin.")


# Permission for commercial use: a condition must be read and accepted first, and an unknown licence permits nothing.
Commercial = Literal["allowed", "forbidden", "conditional", "unknown"]

# Words about a model: its name, version, licence.
ModelWords = Annotated[str, StringConstraints(min_length=1, max_length=200)]


class ModelUse(Model):
    """A foundation model that contributed to a description."""

    task: ModelWords = Field(description="Task that it solved, such as `mesh`.")
    name: ModelWords = Field(description="Name of the model.")
    version: ModelWords = Field(description="Version of the model.")
    licence: ModelWords = Field(description="Licence of its weights.")
    commercial: Commercial = Field(
        description="Permission for commercial use; a condition is stated by `simfoundry models --licences`."
    )
    weights_sha256: Annotated[str, StringConstraints(pattern=DIGEST)] | None = Field(
        None, description="SHA-256 digest of its weights."
    )


class Origin(Model):
    """The source of a description and how well it fits the observations."""

    capture: str | None = Field(None, description="The capture from which the values were estimated.")
    fit_error: Annotated[NonNegative | None, FormerKey("fit")] = Field(
        None, description="Median distance between the observed points and the fitted surface [m]."
    )
    confidence: Fraction | None = Field(None, description="Confidence in the description, 0 to 1.")
    segment: Annotated[int, Field(ge=1, le=65535)] | None = Field(
        None, description="Number of the object's pixels in `segments.png`, beside the reconstructed scene."
    )
    note: str | None = Field(None, max_length=200, description="Assumptions made during the estimation.")
    cousin: CousinOf | None = Field(None, description="Recipe, seed and index of a cousin.")
    models: tuple[ModelUse, ...] = Field((), max_length=32, description="Foundation models that contributed.")
