"""JSON Schemas of the documents, for editors."""

from __future__ import annotations

import json
from typing import Any

from simfoundry.spec.load import KINDS

DIALECT = "https://json-schema.org/draft/2020-12/schema"


def schemas() -> dict[str, str]:
    """File name to text of every schema, as checked in below ``schemas/``."""
    return {f"{kind.split('/')[0]}.schema.json": _text(kind) for kind in KINDS}


def schema(kind: str) -> dict[str, Any]:
    """The JSON Schema of one kind of document, as ``scene/1``."""
    body = _closed(KINDS[kind].model_json_schema())
    return {"$schema": DIALECT, "$id": f"simfoundry/{kind}", **body, "title": f"SimFoundry {kind}"}


def _closed(body: Any) -> Any:
    """The same schema, in which a mapping by name takes nothing but names (pydantic leaves other keys open)."""
    if isinstance(body, list):
        return [_closed(item) for item in body]
    if not isinstance(body, dict):
        return body
    closed = {key: _closed(item) for key, item in body.items()}
    return closed | {"additionalProperties": False} if "patternProperties" in closed else closed


def _text(kind: str) -> str:
    return json.dumps(schema(kind), indent=2, ensure_ascii=False) + "\n"
