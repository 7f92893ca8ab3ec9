"""Arithmetic with the parameters of a document: ``$gap * 2`` wherever a number is expected."""

from __future__ import annotations

import ast
import math
import operator
import re
from collections.abc import Callable, Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import lru_cache
from graphlib import CycleError, TopologicalSorter

from simfoundry.spec.diagnostics import Diagnostic, Fix, Severity, nearest, similar_fixes
from simfoundry.spec.yaml.nodes import Node

# Reference to a parameter.
PARAMETER = re.compile(r"\$([a-z][a-z0-9_]*)")

# Text that can only be an expression: parameters, numbers, operators, and parentheses.
_EXPRESSION = re.compile(r"(?:\$[A-Za-z0-9_]*|[0-9.]+(?:[eE][-+]?[0-9]+)?|[-+*/() ])+\Z")

# Keys below which every value is a text.
_TEXTS = frozenset(("name", "description", "allow", "conflicts", "origin", "source"))

# Maximum length of an expression [characters], which bounds the nesting depth.
MAX_LENGTH = 200

# Number of significant digits of a result, chosen to hide binary rounding: 3 * 0.1 is 0.3.
DIGITS = 12

_OPERATORS: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
}


class ParameterError(Exception):
    """Raised if an expression cannot be evaluated.

    ``hint`` suggests a fix, and ``name`` is the parameter without a value, if that is the reason. ``fixes`` contains
    the names that can be written instead.
    """

    def __init__(self, code: str, message: str, hint: str = "", name: str = "", fixes: tuple[Fix, ...] = ()) -> None:
        super().__init__(message)
        self.code, self.message, self.hint, self.name, self.fixes = code, message, hint, name, fixes


def holds_text(path: tuple[str | int, ...]) -> bool:
    """Return True if a value in a scene is a text. A member can be called like a key, such as an object `source`."""
    from simfoundry.spec.models.types import NAMES  # reads a file, which only documents with parameters need

    mappings = {pattern.rpartition(".")[2] for pattern in NAMES["scene"]} if _TEXTS.intersection(path) else ()
    return any(part in _TEXTS and not (k and path[k - 1] in mappings) for k, part in enumerate(path))


def is_expression(text: str) -> bool:
    """Return True if a text is an expression with parameters rather than a word or sentence."""
    return "$" in text and _EXPRESSION.match(text) is not None


@lru_cache(maxsize=4096)
def _parsed(text: str) -> ast.expr:
    """Return the syntax tree of an expression.

    Raises:
        ParameterError: If the text is not an expression.
    """
    wrong = ParameterError(
        "SF109",
        f"`{text[:60]}` is not an expression",
        "combine numbers and parameters such as `$gap` with +, -, *, / and parentheses",
    )
    if len(text) > MAX_LENGTH or "**" in text or "//" in text:
        raise wrong
    try:
        # The text consists of digits, operators and parameters only, and it is never compiled or run.
        return ast.parse(PARAMETER.sub(r" \1 ", text).strip(), mode="eval").body
    except (SyntaxError, ValueError, RecursionError, MemoryError):
        raise wrong from None


def evaluate(text: str, values: Mapping[str, float]) -> float:
    """Return the value of an expression.

    A whole number is returned as an integer, because numbers of copies are integers.

    Raises:
        ParameterError: If the text is not an expression, a parameter is undefined, or the result is not finite.
    """
    try:
        value = _value(_parsed(text), values)
        finite = math.isfinite(value)
    except ZeroDivisionError:
        raise ParameterError("SF109", f"`{text}` divides by zero", "change a parameter") from None
    except OverflowError:
        finite = False
    if not finite:
        raise ParameterError("SF109", f"the value of `{text}` is not finite", "change a parameter")
    return whole(value if isinstance(value, int) else float(f"{value:.{DIGITS}g}"))


def whole(value: float) -> float:
    """Return a number as an integer if it is whole and has no more than :data:`DIGITS` digits."""
    return int(value) if isinstance(value, float) and value.is_integer() and abs(value) < 10**DIGITS else value


def _value(tree: ast.expr, values: Mapping[str, float]) -> float:
    match tree:
        case ast.Constant(value=int() | float() as number) if not isinstance(number, bool):
            return number
        case ast.Name(id=name):
            if name not in values:
                hint = nearest(name, values) if values else "define it under `parameters`"
                message, fixes = f"no parameter is called `{name}`", similar_fixes(name, values)
                raise ParameterError("SF201", message, hint, name, fixes)
            return values[name]
        case ast.UnaryOp(op=ast.USub() | ast.UAdd() as prefix, operand=operand):
            inner = _value(operand, values)
            return -inner if isinstance(prefix, ast.USub) else inner
        case ast.BinOp(left=left, op=ast.Div(), right=right):
            a, b = _value(left, values), _value(right, values)
            return a // b if isinstance(a, int) and isinstance(b, int) and b and a % b == 0 else a / b
        case ast.BinOp(left=left, op=sign, right=right) if type(sign) in _OPERATORS:
            return _checked(_OPERATORS[type(sign)](_value(left, values), _value(right, values)))
    message = "only +, -, *, / and parentheses are available"
    raise ParameterError("SF109", "the expression uses another operator", message)


def _checked(value: float) -> float:
    float(value)  # raises OverflowError for an integer beyond the range of floats
    return value


@dataclass
class Substitution:
    """The replacement of expressions by their values.

    Attributes:
        values: Values of the parameters.
        file: File of the document, for nodes that do not name their own.
        declared: Names of the parameters, including those without a valid value, or None if they are unknown.
        findings: Findings for expressions that cannot be evaluated; these are left as they are.
        unresolved: Files, lines and columns of expressions with parameters whose values have their own findings.
    """

    values: Mapping[str, float]
    file: str
    declared: Collection[str] | None = ()
    findings: list[Diagnostic] = field(default_factory=list)
    unresolved: list[tuple[str, int, int]] = field(default_factory=list)
    _done: dict[int, Node] = field(default_factory=dict)

    def apply(self, node: Node, path: tuple[str | int, ...] = ()) -> Node:
        """Return the node with every expression in it replaced. Nodes without expressions are returned unchanged."""
        if id(node) in self._done:  # an alias
            return self._done[id(node)]
        new = node
        if isinstance(node.children, dict):
            children = {key: self.apply(child, (*path, key)) for key, child in node.children.items()}
            if any(children[key] is not child for key, child in node.children.items()):
                new = node.with_members(children)
        elif isinstance(node.children, list):
            known = len(self.unresolved)
            items = [self.apply(child, (*path, k)) for k, child in enumerate(node.children)]
            if len(self.unresolved) > known:  # the list does not have the type that is expected either
                self.unresolved.append((node.file or self.file, node.line, node.column))
            if any(a is not b for a, b in zip(items, node.children, strict=True)):
                new = node.with_members(items)
        elif isinstance(node.value, str) and is_expression(node.value) and not holds_text(path):
            new = self._evaluated(node, path)
        self._done[id(node)] = new
        return new

    def _evaluated(self, node: Node, path: tuple[str | int, ...]) -> Node:
        try:
            value = evaluate(node.value, self.values)
        except ParameterError as wrong:
            place = (node.file or self.file, node.line, node.column)
            value = None
            if wrong.name and (self.declared is None or wrong.name in self.declared):
                self.unresolved.append(place)
            else:
                dotted = ".".join(map(str, path))
                found = Diagnostic(wrong.code, Severity.ERROR, wrong.message, *place, dotted, wrong.hint)
                self.findings.append(replace(found, word=wrong.name, fixes=wrong.fixes))
        return node if value is None else Node(value, node.line, node.column, file=node.file)


def parameter_values(section: Mapping[str, Node], given: Mapping[str, float], file: str) -> Substitution:
    """Evaluate the parameters of a document, which may refer to each other.

    Values in ``given``, which come from the command line, a recipe or an including scene, replace those of the
    document. Values that are not numbers are omitted, because the type check reports them.

    Returns:
        The values, with the findings.
    """
    values: dict[str, float] = {}
    waiting: dict[str, Node] = {}
    for name, node in section.items():
        if name in given:
            values[name] = whole(given[name])  # a model may have made the number a float
        elif isinstance(node.value, int | float) and not isinstance(node.value, bool):
            values[name] = node.value
        elif isinstance(node.value, str) and is_expression(node.value):
            waiting[name] = node
    solving = Substitution(values, file, section)
    needs = {name: waiting.keys() & PARAMETER.findall(node.value) for name, node in waiting.items()}
    sorter = TopologicalSorter(needs)
    with suppress(CycleError):  # the sorter still yields all parameters that do not depend on a cycle
        sorter.prepare()
    while ready := sorter.get_ready():
        for name in ready:
            found = solving.apply(waiting.pop(name), ("parameters", name)).value
            if isinstance(found, int | float):
                values[name] = found
        sorter.done(*ready)
    for name, node in waiting.items():
        message = f"the value of `{name}` depends on itself: `{node.value}`"
        place = (node.file or file, node.line, node.column, f"parameters.{name}", "write one of them as a number")
        solving.findings.append(Diagnostic("SF109", Severity.ERROR, message, *place))
    return solving
