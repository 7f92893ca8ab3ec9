"""The pages that `explain` prints, in a pipe and on a terminal."""

from __future__ import annotations

import re

import pytest

from simfoundry.spec.check.pages import page, titles
from tests.cli.command import Done, run, terminal


def test_explain_prints_the_page() -> None:
    done = run("explain", "sf201")
    assert done == Done(0, page("SF201").markdown, "")
    assert run("explain", "201").out == run("explain", "error[SF201]").out == done.out
    assert run("explain", "SF201", "--json").json == {
        "code": "SF201",
        "title": titles()["SF201"],
        "markdown": page("SF201").markdown,
    }


def test_explain_lists_all_codes() -> None:
    done = run("explain")
    lines = done.out.splitlines()
    assert done.code == 0 and [ln.split()[0] for ln in lines if ln.startswith("  ")] == sorted(titles())
    groups = run("explain", "--json").json["groups"]
    assert {code: title for codes in groups.values() for code, title in codes.items()} == titles()
    assert [ln for ln in lines if ln and not ln.startswith(" ")] == list(groups)


@pytest.mark.parametrize(("code", "words"), [("SF21", "did you mean"), ("SF4022", "did you mean `SF402`?")])
def test_explain_suggests_the_nearest_code(code: str, words: str) -> None:
    done = run("explain", code)
    if code == "SF21":  # a short number is a number: there is no SF021
        assert "there is no code `SF21`" in done.err
    assert done.code == 2 and done.out == "" and words in done.err
    assert words in run("explain", code, "--json").json["error"]


def test_explain_says_how_to_list_codes_where_none_is_near() -> None:
    assert "`simfoundry explain` lists all" in run("explain", "help").err


def test_explain_is_laid_out_on_a_terminal() -> None:
    shown = terminal("explain", "SF402")
    plain = re.sub(r"\x1b\[[0-9;]*m", "", shown)
    assert "\x1b[" in shown and "**" not in plain and "```" not in plain
    assert "SF402 an implausible density" in plain and "mass: 200" in plain
    assert max(map(len, plain.splitlines())) <= 80
    assert terminal("explain", "SF402", NO_COLOR="1") == page("SF402").markdown
