"""Names that others give to our predicates: BDDL's, LIBERO's, OmniGibson's and the paper's."""

from __future__ import annotations

ALIASES = {
    # BDDL, as in BEHAVIOR: lower case
    "ontop": "OnTop", "inside": "Inside", "under": "Under", "nextto": "NextTo", "touching": "Touching", "open": "Open",
    "closed": "Closed", "grasped": "Grasped", "lifted": "Lifted", "upright": "Upright", "above": "Above",
    # LIBERO
    "On": "OnTop", "In": "Inside", "Close": "Closed", "Up": "Lifted",
    # OmniGibson and the authors' release
    "OnTopAABB": "OnTop", "InsideAABB": "Inside", "AboveAABB": "Above", "IsGrasping": "Grasped", "OnTopOf": "OnTop",
    "on_top": "OnTop", "next_to": "NextTo", "left_of": "LeftOf", "right_of": "RightOf", "in_front_of": "InFrontOf",
    "behind": "Behind",
}  # fmt: skip
"""Our name for each of theirs; `simfoundry fmt` writes ours."""

ROBOT_FIRST = ("IsGrasping", "grasped")
"""Names with which the robot comes before the thing, if there are two arguments."""


def ours(name: str, arguments: tuple[str, ...]) -> tuple[str, tuple[str, ...]]:
    """A predicate and its arguments as we write them; what is not among the aliases stays."""
    if name in ROBOT_FIRST and len(arguments) == 2:
        arguments = arguments[::-1]
    return ALIASES.get(name, name), arguments
