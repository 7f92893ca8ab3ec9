"""The URDF importer, which reads both single files and folders compiled by SimFoundry."""

from simfoundry.frontends.registry import Importer, deferred

READ_URDF = deferred("simfoundry.frontends.urdf.reader:read_urdf")

IMPORTER = Importer(
    {".urdf": READ_URDF, ".xml": READ_URDF, ".json": deferred("simfoundry.frontends.urdf.folder:read_poses")},
    xml_root="robot",
    accepts=deferred("simfoundry.frontends.urdf.folder:is_poses"),
)
