"""MJCF in, read and compiled by MuJoCo itself."""

from simfoundry.frontends.mjcf.reader import read_mjcf

__all__ = ["read_mjcf"]
