"""The ``target/1`` document type, which describes a simulator: its backend, known gaps, and settings for ``verify``."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, StringConstraints

from simfoundry.spec.models.base import Model, Name, Positive

Words = Annotated[str, StringConstraints(min_length=3, max_length=240)]
Combine = Literal["average", "harmonic", "maximum", "minimum", "multiply"]
EngineName = Annotated[str, StringConstraints(pattern=r"^[a-z][a-z0-9_-]*$", max_length=64)]
ClassPath = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][\w.]*:[A-Za-z_]\w*$", max_length=200)]
Writes = Literal["objects", "environment", "events", "omnigibson"]
PythonName = Annotated[str, StringConstraints(pattern=r"^[A-Za-z_][A-Za-z0-9_.]*$", max_length=128)]

# The key of the tolerance for quantities that do not have their own tolerance.
READ_BACK = "read_back"

# The quantities that `simfoundry verify` reads back.
QUANTITIES = (
    *("mass", "com", "inertia", "position", "rotation", "bounds", "gravity"),
    *("friction", "restitution", "torsional_friction", "rolling_friction"),
    *("axis", "limits", "damping", "joint_friction", "armature", "joint_position", "law", "drive", "effort"),
    *("max_effort", "max_velocity", "gravity_compensation"),
)

# The behaviors that `simfoundry verify` measures.
BEHAVIORS = (
    *("free_fall", "slip_angle", "period", "decay", "restitution", "limit", "friction_holds", "friction_slips"),
    *("damped_friction", "drive", "mimic", "no_contact", "settled_mm", "settled_deg"),
)


class Gap(Model):
    """A feature that the simulator does not preserve, in addition to the backend's losses."""

    fidelity: Literal["approximated", "dropped"] = Field(
        description="`approximated` if the feature is partly preserved, or `dropped` if it is not preserved."
    )
    kind: Literal["notimpl", "notyet", "never"] = Field(
        description="`notimpl`: not implemented here; `notyet`: possible in the simulator; `never`: impossible there."
    )
    reason: Words = Field(description="The reason for the loss, and the size of the error.")
    size: Positive | None = Field(
        None, description="The largest error of an approximated feature, in SI units, which `simfoundry verify` checks."
    )


class Band(Model):
    """The accepted range for a behavior in which the simulator is known to deviate from the analytic value."""

    low: float = Field(description="The smallest accepted value, in the unit of the behavior.")
    high: float = Field(description="The largest accepted value.")
    reason: Words = Field(description="The reason why the simulator is not more accurate.")


class Tolerance(Model):
    """The largest error that `simfoundry verify` accepts, and the reason for it."""

    value: Positive = Field(
        description="The tolerance: relative for quantities that are read back, or in the behavior's unit."
    )
    reason: Words = Field(description="The reason why the tolerance is not smaller.")


class Tested(Model):
    """The extent to which a profile has been tested."""

    how: Literal["run", "checked"] = Field(
        description="`run` if builds were loaded in the simulator, or `checked` if only the code was reviewed."
    )
    versions: tuple[str, ...] = Field((), description="The simulator releases with which the target was run.")
    note: Words | None = Field(None, description="Observations from the test.")


class Combines(Model):
    """The simulator's rules for combining the coefficients of two surfaces, if they differ from the geometric mean."""

    friction: Combine | None = Field(None, description="The rule for combining two friction coefficients.")
    restitution: Combine | None = Field(None, description="The rule for combining two restitution coefficients.")


class EngineSpec(Model):
    """The settings with which `simfoundry verify` runs the simulator, using the `readback.py` next to the profile."""

    name: EngineName | None = Field(None, description="The name for `-e` and in tables; defaults to the target's name.")
    family: EngineName | None = Field(
        None, description="The name in `--python FAMILY=PATH` for all engines in a package; defaults to `name`."
    )
    modules: dict[PythonName, str] = Field(
        min_length=1, description="The required modules and the distributions that provide them, with the engine first."
    )
    install: Words = Field(description="The command that installs the required modules.")
    note: Words = Field(description="The solver that steps the build.")
    steps: bool = Field(True, description="False if the engine can load builds but cannot simulate them.")


class TargetSpec(Model):
    """A simulator for which scenes can be compiled."""

    simfoundry: Literal["target/1"] = Field(description="The kind and version of this document.")
    name: Name = Field(description="The name for `-t` and for the folder in a build; must match the profile's folder.")
    description: Words = Field(description="A one-line description.")
    backend: Name = Field(description="The backend that writes the files: `mjcf`, `pybullet`, `urdf` or `usd`.")
    options: dict[Name, float | bool | str] = Field({}, description="Options of the backend, such as `timestep`.")
    tested: Tested = Field(description="The extent to which the profile has been tested.")
    loader: str | None = Field(
        None,
        max_length=200,
        description="The `load.py` of the build; defaults to the file next to the profile, or else the backend's.",
    )
    writes: tuple[Writes, ...] = Field((), description="Additional files that the loader requires.")
    restores: dict[Name, Words] = Field(
        {}, description="Features that the loader restores but the files cannot represent, with an explanation."
    )
    combines: Combines = Field(Combines(), description="The rules for combining the two surfaces in a contact.")
    gaps: dict[Name, Gap] = Field({}, description="Features that the simulator does not preserve, with the reasons.")
    engine: EngineSpec | None = Field(
        None, description="The settings for `simfoundry verify`; requires a `readback.py`."
    )
    behaviors: dict[Name, Band] = Field({}, description="Known deviations from the analytic values, by behavior.")
    tolerances: dict[Name, Tolerance] = Field(
        {}, description="Tolerances by quantity or behavior, and `read_back` for all other quantities."
    )
    world: ClassPath | None = Field(
        None, description="The `World` class as `module:Class`, if the simulator can run rollouts and settling."
    )

    @property
    def restored(self) -> frozenset[str]:
        """The features that the loader restores, and features for which the simulator uses its own combination rule."""
        return frozenset(self.restores.keys() | self.combines.model_dump(exclude_none=True).keys())
