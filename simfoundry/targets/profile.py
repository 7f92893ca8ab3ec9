"""``target/1``: one simulator in one document: its backend, what it keeps and what not, how builds are read back."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import Model, Name, Positive

Words = Annotated[str, StringConstraints(min_length=3, max_length=240)]
Combine = Literal["average", "harmonic", "maximum", "minimum", "multiply"]
EngineName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_-]*$", max_length=64)]
PythonName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_.]*$", max_length=128)]

READ_BACK = "read_back"
"""The tolerance of every quantity that has none of its own."""

QUANTITIES = (
    *("mass", "com", "inertia", "position", "rotation", "bounds", "gravity"),
    *("friction", "restitution", "torsional_friction", "rolling_friction"),
    *("axis", "limits", "damping", "joint_friction", "armature", "joint_position", "law", "drive", "effort"),
)
"""The quantities that `simfoundry verify` reads back."""

BEHAVIOURS = (
    *("free_fall", "slip_angle", "period", "decay", "restitution", "limit", "friction_holds", "friction_slips"),
    *("damped_friction", "drive", "mimic", "no_contact", "settled_mm", "settled_deg"),
)
"""The behaviours that `simfoundry verify` measures."""


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
    """The greatest error that `simfoundry verify` accepts, with its reason."""

    value: Positive = Field(
        description="Relative for what is read back; in the unit of the behaviour for what is measured."
    )
    reason: Words = Field(description="Why not less.")


class Tested(Model):
    """The test that a profile has been put to."""

    how: Literal["run", "checked"] = Field(
        description="`run`: loaded in the simulator by its loader; `checked`: read as code, nothing was run."
    )
    versions: tuple[str, ...] = Field((), description="Releases of the simulator that it was run with.")
    note: Words | None = Field(None, description="What was seen on the way.")


class Combines(Model):
    """The rule by which the simulator combines the coefficients of two surfaces, where it is not the geometric mean."""

    friction: Combine | None = Field(None, description="Of two frictions.")
    restitution: Combine | None = Field(None, description="Of two restitutions.")


class EngineSpec(Model):
    """The simulator as `simfoundry verify` runs it, through the `readback.py` beside the profile."""

    name: EngineName | None = Field(None, description="What `-e` and the tables call it; default: as the target.")
    family: EngineName | None = Field(
        None, description="What `--python FAMILY=PATH` may say for all engines of one package; default: its name."
    )
    modules: dict[PythonName, str] = Field(
        min_length=1, description="Modules that it needs, each with the distribution that has it; itself first."
    )
    install: Words = Field(description="The line that installs them.")
    note: Words = Field(description="Which of its solvers steps the build.")
    steps: bool = Field(True, description="Whether it can step a build, or only read it.")


class TargetSpec(Model):
    """A simulator as a target."""

    simfoundry: Literal["target/1"] = Field(description="The kind and version of this document.")
    name: Name = Field(description="What it is called after `-t`, and its folder in the build; the name of its folder.")
    description: Words = Field(description="One line for people.")
    backend: Name = Field(description="Which backend writes the files: `mjcf`, `pybullet`, `urdf` or `usd`.")
    options: dict[Name, float | bool | str] = Field({}, description="Settings of the backend, as `timestep`.")
    tested: Tested = Field(description="With which releases it was run, or that it was not.")
    loader: str | None = Field(
        None,
        max_length=200,
        description="The `load.py` of the build; default: the one in the folder of the profile, else the backend's.",
    )
    writes: tuple[Literal["objects", "environment", "omnigibson"], ...] = Field(
        (), description="Files beside those of the backend that its loader reads."
    )
    restores: dict[Name, Words] = Field(
        {}, description="Features that the backend's files cannot hold and the loader gives back: how."
    )
    combines: Combines = Field(Combines(), description="How it combines the surfaces of a contact.")
    gaps: dict[Name, Gap] = Field({}, description="Features that it does not keep, with the reason.")
    engine: EngineSpec | None = Field(None, description="How `simfoundry verify` runs it; needs a `readback.py`.")
    behaviours: dict[Name, Band] = Field(
        {}, description="What it is known to do otherwise than the laws of physics, by behaviour."
    )
    tolerances: dict[Name, Tolerance] = Field(
        {}, description="By quantity or behaviour, or `read_back` for the rest: what `simfoundry verify` lets pass."
    )
    world: Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)] | None = Field(
        None, description="The class of its `World`, as `module:Class`, where rollouts and settling can run in it."
    )
