"""MJCF importer; MuJoCo itself parses and compiles the files."""

from simfoundry.frontends.mjcf.reader import read_mjcf

__all__ = ["read_mjcf"]
