"""A predicate is true where each of its terms is: numbers with a signed margin and words for them."""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from simfoundry.predicates.judging.view import View
from simfoundry.scene.frames import Array

Words = Callable[[float, bool], str]
"""What a term says of its value, given whether it holds."""


class Term(NamedTuple):
    """One thing that must hold: measured ``value`` and ``margin``, (n,); NaN where another term had decided before."""

    value: Array
    margin: Array
    words: Words

    def say(self, k: int) -> str:
        """In words, of the k-th state."""
        return self.words(float(self.value[k]), bool(self.margin[k] > 0))


class Terms:
    """The terms of one predicate in the states of a view; what is slow is measured only where all before it hold."""

    def __init__(self, view: View) -> None:
        self.view = view
        self.terms: list[Term] = []
        self.margin: Array = np.full(view.n, np.inf)

    def must(self, value: Array, margin: Array, words: Words) -> None:
        """Add a term known in every state."""
        self.terms.append(Term(value, margin, words))
        self.margin = np.minimum(self.margin, margin)

    def must_also(self, measure: Callable[[View], Array], margin: Callable[[Array], Array], words: Words) -> None:
        """Add a term that is measured in the states that are still open: ``margin`` turns values into margins."""
        value, margins = np.full(self.view.n, np.nan), np.full(self.view.n, np.nan)
        left = np.flatnonzero(self.margin > 0)
        if len(left):
            value[left] = measure(self.view if len(left) == self.view.n else self.view.at(left))
            margins[left] = margin(value[left])
            self.margin[left] = np.minimum(self.margin[left], margins[left])
        self.terms.append(Term(value, margins, words))

    def why(self, k: int) -> str:
        """Of one state: what fails, or all that holds."""
        known = [term for term in self.terms if not np.isnan(term.margin[k])]
        failed = [term for term in known if not term.margin[k] > 0]
        return "; ".join(text for term in failed or known if (text := term.say(k)))
