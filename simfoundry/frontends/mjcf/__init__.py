"""The MJCF importer, which uses MuJoCo itself to parse and compile files."""

from simfoundry.frontends.registry import Importer, deferred

IMPORTER = Importer({".xml": deferred("simfoundry.frontends.mjcf.reader:read_mjcf")}, xml_root="mujoco")
