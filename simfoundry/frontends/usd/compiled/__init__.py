"""Conversion of compiled stages, including later edits, back to the original document."""

from simfoundry.frontends.usd.compiled.loading import Imported, import_stage, import_usd, load_usd
from simfoundry.frontends.usd.compiled.reading import StageReading, read_spec, read_stage
from simfoundry.frontends.usd.compiled.stage import StageError, carrier

__all__ = [
    "Imported",
    "StageError",
    "StageReading",
    "carrier",
    "import_stage",
    "import_usd",
    "load_usd",
    "read_spec",
    "read_stage",
]
