"""The prompts A to E of the paper, as templates, and the typed answers to them.

SimFoundry (2026), appendix "Object Cousins Augmentation": the text is the paper's, the variables are between braces.
"""

from __future__ import annotations

from functools import cache
from importlib.resources import files
from typing import Any

from pydantic import BaseModel, Field

from simfoundry.errors import SimfoundryError
from simfoundry.runtime.extras import install_line

PROMPTS = {
    "A": "a_components.j2",
    "B": "b_topology.j2",
    "C": "c_variations.j2",
    "D": "d_edit.j2",
    "E": "e_verify.j2",
}
"""Functional components, whether topology may change, variations, the edit of the picture, the verdict."""


class Answer(BaseModel):
    """What a model answers: read by a schema, never run, and cut to what is used."""


class ComponentNames(Answer):
    """Answer to A."""

    components: list[str] = Field(min_length=1, max_length=16, description="Names of the functional components.")


class Feasible(Answer):
    """Answer to B."""

    yes: bool = Field(description="Whether a variation of topology is reasonable.")


class Variations(Answer):
    """Answer to C."""

    geometry: list[str] = Field(default=[], max_length=16, description="Variations of geometry.")
    topology: list[str] = Field(default=[], max_length=16, description="Variations of topology.")
    visual: list[str] = Field(default=[], max_length=16, description="Variations of the looks.")


class Verdict(Answer):
    """Answer to E."""

    real_world_reasonable: bool = Field(description="Whether such a thing is reasonable in the real world.")
    real_world_reason: str = Field(max_length=300, description="Why, in short.")
    scene_reasonable: bool = Field(description="Whether it is reasonable in this scene.")
    scene_reason: str = Field(max_length=300, description="Why, in short.")


def prompt(letter: str, **variables: Any) -> str:
    """The text of a prompt; a variable that it needs and is not given is an error."""
    return str(_environment().get_template(PROMPTS[letter]).render(**variables)).strip()


@cache
def _environment() -> Any:
    try:
        from jinja2 import DictLoader, Environment, StrictUndefined
    except ImportError:
        raise SimfoundryError(f"prompts need jinja2; install with `{install_line('vlm')}`") from None
    folder = files("simfoundry.cousins.objects") / "prompts"
    texts = {name: (folder / name).read_text(encoding="utf-8") for name in PROMPTS.values()}
    return Environment(loader=DictLoader(texts), undefined=StrictUndefined, autoescape=False)  # plain text, no HTML
