"""``target/1``: one simulator in one document: its backend, its loader, what it keeps and what not."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import Model, Name, Positive

Words = Annotated[str, StringConstraints(min_length=3, max_length=240)]
Combine = Literal["average", "harmonic", "maximum", "minimum", "multiply"]


class Gap(Model):
    """A feature that the simulator does not keep, beyond what its backend leaves out."""

    fidelity: Literal["approximated", "dropped"] = Field(description="Whether something of it arrives.")
    kind: Literal["notimpl", "notyet", "never"] = Field(
        description="`notimpl`: ours to do; `notyet`: the simulator could; `never`: it cannot."
    )
    reason: Words = Field(description="Why, and by how much.")
    size: Positive | None = Field(
        None, description="The greatest error in SI units, where something of it arrives; `simfoundry verify` holds it."
    )


class Band(Model):
    """A behaviour of `simfoundry verify` with another outcome than the known answer."""

    low: float = Field(description="The least that it may measure, in the unit of the behaviour.")
    high: float = Field(description="The most.")
    reason: Words = Field(description="Why it does not do better.")


class Tolerance(Model):
    """How far a quantity read back from the simulator may be from the scene."""

    value: Positive = Field(description="In the unit that its name says.")
    reason: Words = Field(description="Why not less.")


class Tested(Model):
    """How this profile was put to the test."""

    how: Literal["run", "checked"] = Field(
        description="`run`: loaded in the simulator by its loader; `checked`: read as code, nothing was run."
    )
    versions: tuple[str, ...] = Field((), description="Releases of the simulator that it was run with.")
    note: Words | None = Field(None, description="What was seen on the way.")


class Combines(Model):
    """What the simulator makes of the coefficients of the two surfaces of a contact, where it is no geometric mean."""

    friction: Combine | None = Field(None, description="Of two frictions.")
    restitution: Combine | None = Field(None, description="Of two restitutions.")


class TargetSpec(Model):
    """A simulator as a target."""

    simfoundry: Literal["target/1"] = Field(description="The kind and version of this document.")
    name: Name = Field(description="What it is called after `-t`, and its folder in the build; the name of the file.")
    description: Words = Field(description="One line for people.")
    backend: Name = Field(description="Which backend writes the files: `mjcf`, `pybullet`, `urdf` or `usd`.")
    options: dict[Name, float | bool | str] = Field({}, description="Settings of the backend, as `timestep`.")
    tested: Tested = Field(description="With which releases it was run, or that it was not.")
    loader: str | None = Field(
        None,
        max_length=200,
        description="The `load.py` of the build, relative to this document; default: the backend's.",
    )
    writes: tuple[Literal["objects", "environment", "omnigibson"], ...] = Field(
        (), description="Files beside those of the backend that its loader reads."
    )
    restores: dict[Name, Words] = Field(
        {}, description="Features that the backend's files cannot hold and the loader gives back: how."
    )
    combines: Combines = Field(Combines(), description="How it combines the surfaces of a contact.")
    gaps: dict[Name, Gap] = Field({}, description="Features that it does not keep, with the reason.")
    behaviours: dict[Name, Band] = Field(
        {}, description="What it is known to do otherwise than the laws of physics, by behaviour."
    )
    tolerances: dict[Name, Tolerance] = Field({}, description="What may differ when its world is read back, and why.")
