"""``target/1``: a simulator in one document, with its backend, its known gaps, and the settings to read builds back."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import Model, Name, Positive

Words = Annotated[str, StringConstraints(min_length=3, max_length=240)]
Combine = Literal["average", "harmonic", "maximum", "minimum", "multiply"]
EngineName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_-]*$", max_length=64)]
PythonName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_.]*$", max_length=128)]

READ_BACK = "read_back"
"""The key of the tolerance for quantities without their own."""

QUANTITIES = (
    *("mass", "com", "inertia", "position", "rotation", "bounds", "gravity"),
    *("friction", "restitution", "torsional_friction", "rolling_friction"),
    *("axis", "limits", "damping", "joint_friction", "armature", "joint_position", "law", "drive", "effort"),
)
"""The quantities that `simfoundry verify` reads back."""

BEHAVIORS = (
    *("free_fall", "slip_angle", "period", "decay", "restitution", "limit", "friction_holds", "friction_slips"),
    *("damped_friction", "drive", "mimic", "no_contact", "settled_mm", "settled_deg"),
)
"""The behaviors that `simfoundry verify` measures."""


class Gap(Model):
    """A feature that the simulator does not preserve, in addition to the losses of its backend."""

    fidelity: Literal["approximated", "dropped"] = Field(
        description="`approximated` if it is partly preserved, `dropped` if it is not."
    )
    kind: Literal["notimpl", "notyet", "never"] = Field(
        description="`notimpl`: not implemented here; `notyet`: the simulator could support it; `never`: it cannot."
    )
    reason: Words = Field(description="The reason, and the size of the error.")
    size: Positive | None = Field(
        None, description="The largest error in SI units of an approximated feature; `simfoundry verify` checks it."
    )


class Band(Model):
    """A behavior of `simfoundry verify` whose outcome in this simulator differs from the known answer."""

    low: float = Field(description="The smallest accepted value, in the unit of the behavior.")
    high: float = Field(description="The largest accepted value.")
    reason: Words = Field(description="The reason why the simulator is not more accurate.")


class Tolerance(Model):
    """The largest error that `simfoundry verify` accepts, with its reason."""

    value: Positive = Field(
        description="Relative for quantities that are read back; in the unit of the behavior for measurements."
    )
    reason: Words = Field(description="The reason why the tolerance is not smaller.")


class Tested(Model):
    """The extent to which a profile has been tested."""

    how: Literal["run", "checked"] = Field(
        description="`run`: loaded in the simulator by its loader; `checked`: only the code was reviewed."
    )
    versions: tuple[str, ...] = Field((), description="Releases of the simulator with which it was run.")
    note: Words | None = Field(None, description="Observations from the test.")


class Combines(Model):
    """The simulator's rules for combining the coefficients of two surfaces, if they are not the geometric mean."""

    friction: Combine | None = Field(None, description="Rule for two friction coefficients.")
    restitution: Combine | None = Field(None, description="Rule for two restitution coefficients.")


class EngineSpec(Model):
    """The simulator as `simfoundry verify` runs it, through the `readback.py` beside the profile."""

    name: EngineName | None = Field(
        None, description="Its name for `-e` and in tables; default: the name of the target."
    )
    family: EngineName | None = Field(
        None, description="The name in `--python FAMILY=PATH` for all engines of one package; default: its name."
    )
    modules: dict[PythonName, str] = Field(
        min_length=1, description="Required modules, each with the distribution that provides it; its own module first."
    )
    install: Words = Field(description="The command that installs them.")
    note: Words = Field(description="The solver that steps the build.")
    steps: bool = Field(True, description="False if it can only read a build, not step it.")


class TargetSpec(Model):
    """A simulator for which scenes can be compiled."""

    simfoundry: Literal["target/1"] = Field(description="The kind and version of this document.")
    name: Name = Field(
        description="Its name for `-t` and its folder in a build; must be the name of the profile's folder."
    )
    description: Words = Field(description="A one-line description.")
    backend: Name = Field(description="The backend that writes the files: `mjcf`, `pybullet`, `urdf` or `usd`.")
    options: dict[Name, float | bool | str] = Field({}, description="Options of the backend, such as `timestep`.")
    tested: Tested = Field(description="The releases with which it was run, or a statement that it was not.")
    loader: str | None = Field(
        None,
        max_length=200,
        description="The `load.py` of the build; default: the one beside the profile, or else the backend's.",
    )
    writes: tuple[Literal["objects", "environment", "omnigibson"], ...] = Field(
        (), description="Additional files that its loader reads."
    )
    restores: dict[Name, Words] = Field(
        {}, description="Features that the backend's files cannot hold but the loader restores, with an explanation."
    )
    combines: Combines = Field(Combines(), description="The rules for combining the surfaces in a contact.")
    gaps: dict[Name, Gap] = Field({}, description="Features that it does not preserve, with the reason.")
    engine: EngineSpec | None = Field(
        None, description="The settings to run it in `simfoundry verify`; requires a `readback.py`."
    )
    behaviors: dict[Name, Band] = Field({}, description="Known deviations from the laws of physics, by behavior.")
    tolerances: dict[Name, Tolerance] = Field(
        {}, description="Tolerances of `simfoundry verify` by quantity or behavior, or `read_back` for all others."
    )
    world: Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)] | None = Field(
        None, description="The class of its `World`, as `module:Class`, if rollouts and settling can run in it."
    )
