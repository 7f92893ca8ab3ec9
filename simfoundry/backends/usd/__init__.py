"""USD backend: UsdPhysics, UsdPreviewSurface, UsdLux and UsdSemantics, with one file per kind of element."""

from simfoundry.backends.backend import Backend
from simfoundry.backends.usd.features import FEATURES
from simfoundry.backends.usd.stage import compile_usd

__all__ = ["BACKEND", "compile_usd"]

BACKEND = Backend(compile_usd, FEATURES)
