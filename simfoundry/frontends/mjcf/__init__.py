"""MJCF importer; MuJoCo itself parses and compiles the files."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer({".xml": deferred("simfoundry.frontends.mjcf.reader:read_mjcf")}, xml_root="mujoco")
