"""docs/predicates.md says what the predicates do."""

from simfoundry.predicates.judging.docs_table import PAGE, table
from simfoundry.spec.models.predicate import built_in_predicates, parse_call
from simfoundry.spec.yaml.spelling import call
from tests.conftest import REPOSITORY


def test_the_page_has_the_table() -> None:
    page = REPOSITORY / "docs" / PAGE.name
    assert table() in page.read_text(encoding="utf-8"), "python -m simfoundry.predicates.judging.docs_table"


def test_a_file_declares_the_predicate_that_is_registered() -> None:
    found = built_in_predicates()
    assert [predicate.name for predicate in found.values()] == list(found)
    aliases = [alias for predicate in found.values() for alias in predicate.aliases]
    assert len(set(aliases)) == len(aliases) and not set(aliases) & set(found)


def test_names_of_others_mean_ours() -> None:
    assert str(parse_call("ontop( cup , desk)")) == "OnTop(cup, desk)"
    assert str(parse_call("InsideAABB(cup, bowl)")) == "Inside(cup, bowl)"
    assert str(parse_call("IsGrasping(arm, cup)")) == "Grasped(cup, arm)"
    assert call("IsGrasping(arm, cup)") == "Grasped(cup, arm)"
    assert call("On(cup, desk)") == "OnTop(cup, desk)"
    assert call("Tidy(cup,desk)") == "Tidy(cup, desk)"
