"""URDF importer for single files and for compiled folders."""

from simfoundry.frontends.urdf.reader import read_urdf

__all__ = ["read_urdf"]
