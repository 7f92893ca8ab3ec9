"""USD importer: any stage as a new document, or a compiled stage back into its document (``compiled``)."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer(
    dict.fromkeys((".usd", ".usda", ".usdc", ".usdz"), deferred("simfoundry.frontends.usd.reader:read_usd"))
)
