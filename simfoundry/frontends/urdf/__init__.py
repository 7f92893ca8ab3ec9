"""URDF in: single files, and folders of them that SimFoundry compiled."""

from simfoundry.frontends.urdf.reader import read_urdf

__all__ = ["read_urdf"]
