"""USD importer, both for arbitrary stages and for stages compiled by SimFoundry (``compiled``)."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(
    dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), deferred("simfoundry.frontends.usd.reader:read_usd"))
)
