"""Arithmetic with parameters."""

from __future__ import annotations

import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from simfoundry.spec.compose.parameters import ParameterError, evaluate, is_expression
from simfoundry.spec.models.shapes import SphereShape
from tests.spec.compose.documents import messages, spec_of

VALUES = {"gap": 0.1, "n": 3, "zero": 0, "big": 1e200}


@pytest.mark.parametrize(
    ("text", "value"),
    [
        ("$gap", 0.1),
        ("-$gap", -0.1),
        ("$gap * 3", 0.3),
        ("2*($gap+$n)-$n/2", 4.7),
        ("$n * 2", 6),
        ("$n / 3", 1),
        ("$n / 2", 1.5),
        ("1e-3 * $n", 0.003),
        ("-(-$n)", 3),
    ],
)
def test_expressions_have_the_value_of_arithmetic(text: str, value: float) -> None:
    found = evaluate(text, VALUES)
    assert is_expression(text) and found == value and type(found) is type(value)


@pytest.mark.parametrize(
    ("text", "code", "said"),
    [
        ("$gpa", "SF201", "no parameter is called `gpa`"),
        ("$gap +", "SF109", "is not an expression"),
        ("$gap ** 2", "SF109", "is not an expression"),
        ("$gap // 2", "SF109", "is not an expression"),
        ("$gap $n", "SF109", "is not an expression"),
        ("$", "SF109", "is not an expression"),
        ("$Gap", "SF109", "is not an expression"),
        ("(" * 150 + "$gap" + ")" * 150, "SF109", "is not an expression"),
        ("$gap / $zero", "SF109", "divides by zero"),
        ("$big * $big", "SF109", "is not finite"),
        ("9" * 90 + " * " + "9" * 90 + " * $n", "SF109", "is not finite"),
    ],
)
def test_what_is_no_expression_is_said(text: str, code: str, said: str) -> None:
    values = VALUES | {"n": 10**300} if "9" in text else VALUES
    with pytest.raises(ParameterError) as error:
        evaluate(text, values)
    assert error.value.code == code and said in error.value.message


@pytest.mark.parametrize("text", ["costs $5 or $gap each", "gap", "$(rm)", "a $gap", "$gap; 1", "exit() $gap"])
def test_sentences_and_code_are_no_expressions(text: str) -> None:
    assert not is_expression(text)


@given(a=st.floats(-1e6, 1e6), b=st.floats(0.01, 1e6))
def test_results_agree_with_python_to_twelve_digits(a: float, b: float) -> None:
    found = evaluate("($a + $b) * 2 - $a / $b", {"a": a, "b": b})
    assert math.isclose(found, (a + b) * 2 - a / b, rel_tol=1e-9, abs_tol=1e-9)


CUP = "objects:\n  cup: {shape: {sphere: $r}, mass: 0.2, pose: {xyz: [2 * $gap, 0, $r]}}\n"


def test_parameters_refer_to_each_other_and_are_set_from_outside(tmp_path: Path) -> None:
    body = f"parameters: {{gap: 0.1, r: $gap / 2}}\n{CUP}"
    cup = spec_of(tmp_path, body).objects["cup"]
    assert cup.pose.xyz == (0.2, 0.0, 0.05)
    assert spec_of(tmp_path, body, parameters={"gap": 0.3}).objects["cup"].pose.xyz == (0.6, 0.0, 0.15)
    assert spec_of(tmp_path, body).parameters == {}  # everything is written out


def test_errors_stand_at_the_expression(tmp_path: Path) -> None:
    assert messages(tmp_path, f"parameters: {{gap: 0.1, r: 0.05}}\n{CUP.replace('2 * $gap', '2 * $gpa')}") == [
        "5:59 SF201 no parameter is called `gpa`"
    ]
    assert messages(tmp_path, f"parameters: {{gap: 0.1, r: 0.05}}\n{CUP}", parameters={"gpa": 1.0}) == [
        "3:13 SF201 no parameter is called `gpa`"
    ]
    assert messages(tmp_path, f"parameters: {{gap: x, r: 0.05}}\n{CUP}")[0].startswith("3:19 SF103")


def test_a_text_with_a_dollar_stays_a_text(tmp_path: Path) -> None:
    body = "description: $gap\nparameters: {gap: 0.1, r: 0.04}\n" + CUP
    assert spec_of(tmp_path, body).description == "$gap"


@pytest.mark.parametrize("name", ["name", "source", "origin", "conflicts"])
def test_an_object_can_be_called_like_a_key_with_a_text(tmp_path: Path, name: str) -> None:
    spec = spec_of(tmp_path, "parameters: {gap: 0.1, r: 0.04}\n" + CUP.replace("cup", name))
    assert isinstance(shape := spec.objects[name].shape, SphereShape) and shape.sphere == 0.04
