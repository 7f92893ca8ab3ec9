"""Dataset profiles: the conventions of a training library, one YAML file for each."""

from __future__ import annotations

import json
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Literal

import yaml
from pydantic import AfterValidator, Field, StringConstraints, ValidationError

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.plugins import plugins
from simfoundry.spec.diagnostics import nearest
from simfoundry.spec.models.base import Model, Pixels, Positive
from simfoundry.spec.models.dataset import FormatName, StateEntries
from simfoundry.spec.models.policy import CameraView, GripperConvention, WireKey
from simfoundry.spec.models.signals import ActionSpace

# Entry point group of packages that contain profiles.
GROUP = "simfoundry.dataset_profiles"

# Folder of the built-in profiles.
BUILT_IN = Path(__file__).parents[2] / "data" / "dataset" / "profiles"

# Maximum size of a profile to read [bytes]; real ones take less than 2 kB.
MAX_BYTES = 2**20


def _space(text: str) -> str:
    return str(ActionSpace.parse(text))


SpaceText = Annotated[str, AfterValidator(_space)]


def _pattern(text: str) -> str:
    if text.count("{camera}") != 1 or set(text.replace("{camera}", "")) & set("{}"):
        raise ValueError("it must contain {camera} once, and no other braces")
    return text


class ActionFeature(Model):
    """The actions under one key: the values of the arms, of the grippers, or both in the order of an action."""

    space: SpaceText | None = Field(None, description="Action space; default: that of the dataset.")
    part: Literal["all", "arm", "gripper"] = Field("all", description="The values to include.")


class ProfileSpec(Model):
    """The conventions of a training library."""

    about: str = Field(description="One sentence for users.")
    formats: tuple[FormatName, ...] = Field(min_length=1, description="File formats to write by default.")
    fps: Positive | None = Field(None, description="Frames per second [Hz]; default: as recorded.")
    action_space: SpaceText | None = Field(None, description="Action space; default: as recorded.")
    actions: dict[WireKey, ActionFeature] = Field(
        min_length=1, description="Actions by key; the first is that of policies."
    )
    state: dict[WireKey, StateEntries] = Field(description="Observed values by key.")
    cameras: dict[WireKey, CameraView] = Field(
        {},
        description="Camera views by key. Those whose camera a scene lacks are omitted.",
    )
    image_key: Annotated[str, StringConstraints(max_length=128), AfterValidator(_pattern)] = Field(
        description="Key of the cameras that are not listed, in which {camera} stands for the name of the camera."
    )
    images: Literal["video", "image"] = Field(description="How color images are stored if the format offers a choice.")
    width: Pixels = Field(description="Width of the images of other cameras [px].")
    height: Pixels | None = Field(None, description="Height of these images [px]; default: as the camera.")
    gripper: GripperConvention = Field(GripperConvention(), description="Gripper values in actions and observations.")
    parts: dict[str, str] = Field({}, description="Names of the parts of states and actions; default: the entries.")


def profile_names() -> list[str]:
    """Return the names of all profiles: built-in, and from installed packages."""
    return [*(path.stem for path in sorted(BUILT_IN.glob("*.yaml"))), *plugins(GROUP)]


def find_profile(name: str, folder: Path) -> ProfileSpec:
    """Return the profile called ``name``, or the one in a file whose path is relative to ``folder``.

    Raises:
        SimfoundryError: If there is no such profile, or if it is invalid.
    """
    if name.endswith((".yaml", ".yml")):
        return _read(folder / name)
    built_in = BUILT_IN / f"{name}.yaml"
    if name in profile_names() and built_in.is_file():
        return _read(built_in)
    plugin = plugins(GROUP).get(name)
    if plugin is not None:
        return _read(plugin.folder() / f"{name}.yaml")
    hint = nearest(name, profile_names())
    raise SimfoundryError(f"no dataset profile is called `{name[:60]}`; {hint}, or give a path that ends with .yaml")


def _read(path: Path) -> ProfileSpec:
    try:
        return _read_once(path, path.stat().st_mtime_ns)
    except OSError as error:
        raise SimfoundryError(f"the dataset profile {path} cannot be read: {error.strerror}") from None


@lru_cache(maxsize=64)
def _read_once(path: Path, changed: int) -> ProfileSpec:  # noqa: ARG001 - used only as a cache key
    if path.stat().st_size > MAX_BYTES:
        raise SimfoundryError(f"{path} is larger than {MAX_BYTES // 2**20} MiB, so it is not a dataset profile")
    try:
        data = yaml.load(path.read_text(encoding="utf-8"), Loader=getattr(yaml, "CSafeLoader", yaml.SafeLoader))
        return ProfileSpec.model_validate_json(json.dumps(data))
    except ValidationError as error:
        first = error.errors()[0]
        where = ".".join(str(part) for part in first["loc"]) or "the file"
        reason = first["msg"].removeprefix("Value error, ")
        raise SimfoundryError(f"{path} is not a valid dataset profile: {where}: {reason}") from None
    except (yaml.YAMLError, TypeError, ValueError, RecursionError) as error:
        raise SimfoundryError(f"{path} is not a valid dataset profile: {str(error).splitlines()[0]}") from None
