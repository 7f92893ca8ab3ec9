"""The identity of the model that made a result, its licence, and whether it may be used commercially."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from simfoundry.models.contract import ModelError
from simfoundry.spec.models.origin import Commercial, ModelUse

# Words that are shown in a terminal and written to documents.
Words = Annotated[str, Field(min_length=1, max_length=200, pattern=r"^[^\x00-\x1f\x7f-\x9f\u2028\u2029]+$")]


class ModelIdentity(BaseModel):
    """The model that answered, as it describes itself.

    Servers state ``commercial`` as true or false; :func:`judged` compares it with the table of licences.
    """

    model_config = ConfigDict(frozen=True, extra="ignore")

    name: Words
    version: Words
    licence: Words
    commercial: bool | None = None
    weights_sha256: str | None = Field(None, pattern="^[0-9a-f]{64}$")

    def to_json(self) -> dict[str, Any]:
        """Return the identity as plain data for a document's `origin`."""
        return self.model_dump(exclude_none=True)


def provider_identity(name: str) -> ModelIdentity:
    """Return the identity of a provider's model.

    Providers do not state versions of weights, and their terms of use are not in the table of licences.
    """
    entry = find_licence(name)
    licence = "terms of the provider" if entry is None else entry.weights
    return ModelIdentity(name=name, version="as served", licence=licence)


def model_use(task: str, identity: ModelIdentity) -> ModelUse:
    """Return the entry of a document's `origin` that states which model solved a task."""
    return ModelUse(
        task=task,
        name=identity.name,
        version=identity.version,
        licence=identity.licence,
        commercial=judged(identity)[0],
        weights_sha256=identity.weights_sha256,
    )


def used_identity(use: ModelUse) -> ModelIdentity:
    """Return the identity of a model from an entry of a document's `origin`."""
    stated = {"allowed": True, "forbidden": False}.get(use.commercial)
    return ModelIdentity(name=use.name, version=use.version, licence=use.licence, commercial=stated)


@dataclass(frozen=True)
class LicenceEntry:
    """The licence of a model, as far as it is known, from the table ``licences.yaml``.

    Attributes:
        name: Name of the model.
        task: Tasks that the model solves.
        code: Licence of its code.
        weights: Licence of its weights.
        commercial: Permission for commercial use.
        condition: Condition of the permission, or the reason against it; empty if there is none.
        source: Address where weights and licence are found.
    """

    name: str
    task: tuple[str, ...]
    code: str
    weights: str
    commercial: Commercial
    condition: str
    source: str


@lru_cache(maxsize=1)
def licences() -> Mapping[str, LicenceEntry]:
    """Return the table of licences by name of the model."""
    import yaml

    table = yaml.safe_load(Path(__file__).with_name("licences.yaml").read_text(encoding="utf-8"))
    return {name: LicenceEntry(name, tuple(row.pop("task")), **row) for name, row in table.items()}


def find_licence(name: str) -> LicenceEntry | None:
    """Return the entry of a model, or of the model of which it is a version or size.

    Upper case, the owner before a slash and the version after an at sign are ignored. ``DA3NESTED-GIANT-LARGE-1.1`` is
    found as `da3nested-giant-large`, and ``sam3.1`` as `sam3`.
    """
    wanted = _key(name.rpartition("/")[2].partition("@")[0])
    fitting = [k for k in licences() if wanted == k or wanted.startswith((f"{k}-", f"{k}."))]
    return licences()[max(fitting, key=len)] if fitting else None


def _key(name: str) -> str:
    return name.lower().replace("_", "-").replace(" ", "-")


def read_identity(data: Any) -> ModelIdentity:
    """Return the identity that a server states.

    Raises:
        ModelError: If the name, version or licence is missing. The message continues a sentence about the answer.
    """
    try:
        return ModelIdentity.model_validate(data)
    except ValidationError as error:
        first = error.errors()[0]
        place = ".".join(("model", *map(str, first["loc"])))
        raise ModelError(f"does not state which model made it ({place}: {first['msg']})") from None


def judged(identity: ModelIdentity) -> tuple[Commercial, str]:
    """Return the permission for commercial use and its reason.

    The table of licences decides for the models in it, but a server may forbid more. For others, its word counts.
    """
    entry = find_licence(identity.name)
    if entry is not None and not (entry.commercial == "allowed" and identity.commercial is False):
        return entry.commercial, entry.condition or f"licence {entry.weights}"
    if identity.commercial is None:
        return "unknown", f"its server does not state whether {identity.licence} permits commercial use"
    return ("allowed" if identity.commercial else "forbidden"), f"its server states so ({identity.licence})"


def require_commercial(identity: ModelIdentity, accepted: tuple[str, ...] = ()) -> None:
    """Ensure that a model may be used commercially.

    Args:
        identity: The model.
        accepted: Names of models whose condition the user has accepted.

    Raises:
        ModelError: If the model may not be used, or only under a condition that was not accepted.
    """
    permission, reason = judged(identity)
    if permission == "allowed" or (permission == "conditional" and _key(identity.name) in map(_key, accepted)):
        return
    if permission == "conditional":
        raise ModelError(
            f"{identity.name} may be used commercially only under a condition: {reason}; if you meet it, add "
            f"`{identity.name}` to `accepted` under `models` in simfoundry.yaml"
        )
    what = "may not be used commercially" if permission == "forbidden" else "has no known licence for commercial use"
    raise ModelError(f"{identity.name} {what}: {reason}; configure another model, or omit --commercial-only")
