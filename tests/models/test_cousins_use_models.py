"""The models of object cousins: configured ones by bundles, and the doors to other servers beside them."""

from __future__ import annotations

from pathlib import Path

import pytest

from simfoundry.cousins.objects.generation import Generation, image_model, mesh_model
from simfoundry.cousins.objects.procedural import Draft
from simfoundry.models.client import ModelClient
from simfoundry.models.contract import ModelError
from simfoundry.models.generators import HttpImages, HttpMeshes
from simfoundry.models.setup import ModelSetup, load_setup
from simfoundry.models.tasks.images import BundleImages
from simfoundry.models.tasks.meshes import BundleMeshes
from simfoundry.spec.models.cousins import ObjectVariants
from tests.cousins.objects.test_rules import item
from tests.cousins.objects.test_sources import Told, small
from tests.models import truth
from tests.models.test_tasks import Direct

DOORS = {"SIMFOUNDRY_IMAGES_URL": "http://a", "SIMFOUNDRY_IMAGES_MODEL": "painter", "SIMFOUNDRY_MESHES_URL": "http://b"}


def test_a_configured_model_comes_before_a_door(tmp_path: Path) -> None:
    (tmp_path / "simfoundry.yaml").write_text("models: {tasks: {mesh: {url: 'http://c'}}}")
    setup = load_setup(tmp_path / "x.scene.yaml", DOORS)
    assert image_model(setup, "mine") == HttpImages("http://a", "mine")
    assert isinstance(mesh_model(setup), BundleMeshes)
    assert mesh_model(ModelSetup(tmp_path, environment=DOORS)) == HttpMeshes("http://b")
    with pytest.raises(ModelError, match="no mesh model is configured: set SIMFOUNDRY_MESHES_URL"):
        mesh_model(ModelSetup(tmp_path))


def test_doors_obey_commercial_only(tmp_path: Path) -> None:
    setup = ModelSetup(tmp_path, commercial_only=True, environment=DOORS)
    with pytest.raises(ModelError, match=r"painter has no known licence .*--commercial-only"):
        image_model(setup)
    assert image_model(setup, "qwen-image-edit") == HttpImages("http://a", "qwen-image-edit")
    with pytest.raises(ModelError, match="no rights in the European Union"):
        mesh_model(setup)
    accepted = ModelSetup(tmp_path, commercial_only=True, accepted=("hunyuan3d-2",), environment=DOORS)
    assert mesh_model(accepted) == HttpMeshes("http://b")


def test_bundles_make_a_variant_and_its_origin() -> None:
    client = ModelClient(Direct(truth.TRUTH))
    source = Generation(Told(), BundleImages(client), BundleMeshes(client), small(), small())  # type: ignore[arg-type]
    made = source(item("cup"), ObjectVariants(sources=("model",)), 0, 0)
    assert isinstance(made, Draft)
    stated = [(use.task, use.name, use.version, use.licence, use.commercial) for use in made.models]
    proposed = ("propose", "told", "as served", "terms of the provider", "unknown")
    assert stated == [proposed, *((task, "truth", "1.0", "Apache-2.0", "allowed") for task in ("edit", "mesh"))]
    broken = truth.broken("mesh", lambda result: result.members.pop("mesh"))
    failing = Generation(Told(), BundleImages(client), BundleMeshes(ModelClient(Direct(broken))), small(), small())  # type: ignore[arg-type]
    reason = failing(item("cup"), ObjectVariants(sources=("model",)), 0, 0)
    assert getattr(reason, "code", "") == "model" and "contains no `mesh`" in str(reason)
