"""docs/predicates.md says what the predicates do."""

from simfoundry.predicates.judging.docs_table import MEANING, PAGE, table
from simfoundry.predicates.rules import RULES
from simfoundry.spec.aliases import ALIASES
from simfoundry.spec.expressions import PREDICATES, parse_call
from simfoundry.spec.spelling import call
from tests.conftest import REPOSITORY


def test_the_page_has_the_table() -> None:
    page = REPOSITORY / "docs" / PAGE.name
    assert table() in page.read_text(encoding="utf-8"), "python -m simfoundry.predicates.judging.docs_table"


def test_every_predicate_has_a_rule_and_a_meaning() -> None:
    assert set(RULES) == set(MEANING) == set(PREDICATES)
    assert set(ALIASES.values()) <= set(PREDICATES)


def test_names_of_others_mean_ours() -> None:
    assert str(parse_call("ontop( cup , desk)")) == "OnTop(cup, desk)"
    assert str(parse_call("InsideAABB(cup, bowl)")) == "Inside(cup, bowl)"
    assert str(parse_call("IsGrasping(arm, cup)")) == "Grasped(cup, arm)"
    assert call("IsGrasping(arm, cup)") == "Grasped(cup, arm)"
    assert call("On(cup, desk)") == "OnTop(cup, desk)"
    assert call("Tidy(cup,desk)") == "Tidy(cup, desk)"
