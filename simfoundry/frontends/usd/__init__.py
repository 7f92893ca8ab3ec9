"""The USD importer, which reads both arbitrary stages and stages compiled by SimFoundry (``compiled``)."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(
    dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), deferred("simfoundry.frontends.usd.reader:read_usd"))
)
