"""Scene to USD: UsdPhysics, UsdPreviewSurface, UsdLux, UsdSemantics, one file for each kind of element."""

from simfoundry.backends.usd.stage import compile_usd

__all__ = ["compile_usd"]
