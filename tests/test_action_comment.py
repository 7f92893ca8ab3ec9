"""The comment of the GitHub action on a pull request: its steps are run, with git over a real remote.

Only the network is not real: `gh` is a small program that keeps comments in a file as GitHub would, and lets the token
do what the test allows.
"""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from tests.cli.repository import BASE, EDITED, Repository
from tests.test_hooks import ACTION, SIMFOUNDRY, program, run_step

pytestmark = pytest.mark.skipif(not shutil.which("jq"), reason="the filter of the action needs jq, which gh contains")

FAKE_GH = f"""\
#!{sys.executable}
import json, os, subprocess, sys
from pathlib import Path

state = Path(os.environ["COMMENTS"])
known = json.loads(state.read_text())
words = sys.argv[1:]
assert words.pop(0) == "api" and os.environ["GH_TOKEN"] == "the token"
options, flags = {{}}, []
while words:
    word = words.pop(0)
    if word in ("--jq", "--method", "-F"):
        options[word] = words.pop(0)
    elif word.startswith("--"):
        flags.append(word)
    else:
        path = word
allowed = known["may"]
method = options.get("--method", "GET")


def refuse():
    print(json.dumps({{"message": "Resource not accessible by integration", "status": "403"}}))
    sys.exit("gh: Resource not accessible by integration (HTTP 403)")


if path == "user":
    if "user" not in allowed:
        refuse()
    answer = {{"login": known["login"]}}
elif method not in allowed:
    refuse()
elif method == "GET":
    assert path == "repos/o/r/issues/7/comments" and "--paginate" in flags
    answer = known["comments"]
else:
    name, _, file = options["-F"].partition("=@")
    body = Path(file).read_text()
    assert name == "body" and len(body) <= 65536
    if method == "POST":
        assert path == "repos/o/r/issues/7/comments"
        number = 1 + max((c["id"] for c in known["comments"]), default=0)
        known["comments"].append({{"id": number, "user": {{"login": known["login"]}}, "body": body}})
    else:
        (found,) = [c for c in known["comments"] if path == f"repos/o/r/issues/comments/{{c['id']}}"]
        found["body"] = body
    state.write_text(json.dumps(known))
    assert "--silent" in flags
    sys.exit(0)
if "--jq" in options:
    sys.exit(subprocess.run(["jq", "-r", options["--jq"]], input=json.dumps(answer), text=True).returncode)
print(json.dumps(answer))
"""


class PullRequest:
    """A pull request in a repository, and the job that checks out GitHub's merge of it, without any history."""

    def __init__(self, folder: Path) -> None:
        self.origin = folder / "origin"
        self.origin.mkdir()
        self.repository = Repository(self.origin)
        self.repository.write("old.scene.yaml", BASE)
        self.repository.commit("base")
        self.repository.git("switch", "--quiet", "-c", "feature")
        self.job = folder / "job"
        self.folder = folder / "temp" / "simfoundry-diff"
        self.comments = folder / "comments.json"
        self.allow("GET", "POST", "PATCH")
        self.merge = ""

    def allow(self, *may: str, login: str = "github-actions[bot]", comments: list[Any] | None = None) -> None:
        state = {"may": may, "login": login, "comments": comments or []}
        self.comments.write_text(json.dumps(state))

    @property
    def bodies(self) -> list[str]:
        return [comment["body"] for comment in json.loads(self.comments.read_text())["comments"]]

    def push(self, **texts: str) -> None:
        """Change documents in the request, while its base moves on, and let GitHub merge and the job check it out."""
        for name, text in texts.items():
            self.repository.write(f"{name}.scene.yaml", text)
        self.repository.commit("change")
        self.repository.git("switch", "--quiet", "main")
        self.repository.write("old.scene.yaml", (self.origin / "old.scene.yaml").read_text() + "# more\n")
        self.repository.commit("others")
        self.repository.git("switch", "--quiet", "--detach", "main")
        self.repository.git("merge", "--quiet", "--no-ff", "-m", "merge", "feature")
        self.merge = self.repository.git("rev-parse", "HEAD").strip()
        self.repository.git("update-ref", "refs/pull/7/merge", self.merge)
        self.repository.git("switch", "--quiet", "feature")
        self.check_out("refs/pull/7/merge", self.merge)

    def check_out(self, reference: str, commit: str) -> None:
        """Do as `actions/checkout` does: one commit, detached."""
        shutil.rmtree(self.job, ignore_errors=True)
        self.job.mkdir()
        for command in (
            ["init", "--quiet"],
            ["remote", "add", "origin", self.origin.as_uri()],
            ["fetch", "--quiet", "--no-tags", "--depth=1", "origin", f"+{commit}:refs/remotes/{reference[5:]}"],
            ["checkout", "--quiet", "--detach", commit],
        ):
            subprocess.run(["git", *command], cwd=self.job, check=True, capture_output=True)

    def run(self, **inputs: str) -> str:
        """Run both steps; what they say."""
        said = self.describe(**inputs)
        return said + self.comment() if "report=true" in self.outputs else said

    def describe(self, **inputs: str) -> str:
        """Run the step that writes the reports."""
        context = self.context()
        done = run_step("Describe", self.job, context, **inputs)
        assert done.returncode == 0, done.stderr
        self.outputs = Path(context["GITHUB_OUTPUT"]).read_text().split()
        if "report=true" not in self.outputs:
            return done.stdout + done.stderr
        self.text = (self.folder / "comment.md").read_text()
        return ""

    def comment(self) -> str:
        """Run the step that writes the comment, as often as wanted."""
        context = self.context()
        (self.folder / "comment.md").write_text(self.text)
        done = run_step("Comment", self.job, context, token="the token")
        assert done.returncode == 0, done.stderr
        self.summary = Path(context["GITHUB_STEP_SUMMARY"]).read_text()
        return done.stdout

    def context(self) -> dict[str, str]:
        """What GitHub fills into the expressions of a step and sets in its environment."""
        files = {key: self.folder.parent / key for key in ("GITHUB_OUTPUT", "GITHUB_STEP_SUMMARY")}
        self.folder.parent.mkdir(exist_ok=True)
        for file in files.values():
            file.write_text("")
        images = (self.folder / "pictures").is_dir()
        return {
            "runner.temp": str(self.folder.parent),
            "github.event.pull_request.base.sha": self.repository.git("rev-parse", "main").strip(),
            "github.event.pull_request.number": "7",
            "steps.images.outputs.artifact-url": "https://github.com/o/r/actions/runs/1/artifacts/2" if images else "",
            "GITHUB_SHA": self.merge,
            "GITHUB_REPOSITORY": "o/r",
            "COMMENTS": str(self.comments),
            "GIT_CONFIG_GLOBAL": os.devnull,
            **{key: str(file) for key, file in files.items()},
        }


@pytest.fixture
def request_(tmp_path: Path) -> PullRequest:
    program(tmp_path / "bin", "simfoundry", SIMFOUNDRY)
    program(tmp_path / "bin", "gh", FAKE_GH)
    return PullRequest(tmp_path)


@pytest.mark.slow  # 4 s: several commands
def test_one_comment_says_what_the_request_changes_and_is_updated(request_: PullRequest) -> None:
    request_.push(table=EDITED)
    assert request_.run() == ""
    (body,) = request_.bodies
    assert "`cup` moved 3.0 cm (+x 3.0)" in body and "`bowl` renamed to dish" in body
    assert "old.scene.yaml" not in body, "what others did to the base is not of this request"
    assert "[Images before and after](https://github.com/o/r/actions/runs/1/artifacts/2)" in body
    assert "![" not in body, "a comment cannot show files of the job"
    assert request_.summary == body
    assert {path.name for path in request_.folder.rglob("*.png")} == {
        "01-table-scene-before.png",
        "01-table-scene-after.png",
    }
    assert "![before](pictures/01-table-scene-before.png)" in (request_.folder / "report.md").read_text()
    request_.push(table=BASE)
    assert request_.run() == ""
    assert len(request_.bodies) == 1 and "**No document differs.**" in request_.bodies[0]


@pytest.mark.slow  # 3 s: each runs the steps of the action on a clone
def test_a_token_that_may_not_write_leaves_the_summary(request_: PullRequest) -> None:
    """As for pull requests from forks."""
    request_.push(table=EDITED)
    request_.describe()
    for may in (["GET"], []):
        request_.allow(*may)
        assert request_.comment().startswith(
            "::notice::the token cannot write a comment, as for pull requests from forks;"
        )
        assert request_.bodies == [] and "`cup` moved 3.0 cm" in request_.summary


@pytest.mark.slow  # 3 s: each runs the steps of the action on a clone
def test_only_a_comment_of_our_own_is_updated(request_: PullRequest) -> None:
    request_.push(table=EDITED)
    request_.describe()
    request_.comment()
    (body,) = request_.bodies
    theirs = {"id": 3, "user": {"login": "mallory"}, "body": body}
    others = {"id": 4, "user": {"login": "github-actions[bot]"}, "body": f"quoted: {body}"}
    request_.allow("GET", "POST", "PATCH", comments=[theirs, others])
    request_.comment()
    assert request_.bodies == [theirs["body"], others["body"], body]
    robots = {**theirs, "id": 9, "user": {"login": "robot"}, "body": f"{body.splitlines()[0]}\n\nof yesterday"}
    request_.allow("user", "GET", "POST", "PATCH", login="robot", comments=[theirs, robots])
    request_.comment()
    assert request_.bodies == [theirs["body"], body]


def test_no_comment_begins_where_nothing_changes(request_: PullRequest) -> None:
    (request_.origin / "notes.txt").write_text("one")
    request_.push()
    assert request_.run() == "" and request_.bodies == []
    assert "**No document differs.**" in request_.summary and "pictures=true" not in request_.outputs


@pytest.mark.slow  # 3 s: each runs the steps of the action on a clone
def test_the_head_of_the_request_may_be_checked_out_instead(request_: PullRequest) -> None:
    request_.push(table=EDITED)
    head = request_.repository.git("rev-parse", "feature").strip()
    request_.check_out("refs/heads/feature", head)
    assert request_.run() == ""
    (body,) = request_.bodies
    assert "`cup` moved 3.0 cm" in body and "old.scene.yaml" not in body


@pytest.mark.slow  # 3 s: each runs the steps of the action on a clone
def test_paths_and_documents_that_are_broken(request_: PullRequest) -> None:
    request_.push(table="objects: [\n", new=BASE)
    assert request_.run(paths="table.scene.yaml\n") == ""
    (body,) = request_.bodies
    assert "cannot be compared" in body and "new.scene.yaml" not in body
    sly = request_.run(paths='$(touch sly); "; touch sly #')
    assert "::warning::the changes of this pull request cannot be described" in sly
    assert not (request_.job / "sly").exists()


def test_the_steps_run_for_pull_requests_that_ask_for_them() -> None:
    steps = {step["name"]: step for step in ACTION["runs"]["steps"] if "name" in step}
    assert steps["Describe"]["if"] == "inputs.diff == 'true' && github.event_name == 'pull_request'"
    assert ACTION["inputs"]["diff"]["default"] == "false"
    assert steps["Keep the images"]["continue-on-error"] is True
    order = list(steps)
    assert order.index("Comment") < order.index("Check"), "findings fail the job, and the comment should stand"
