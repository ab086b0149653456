"""The steps of the GitHub Action, run here as GitHub runs them, on cases of the demo with a planted regression."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
import threading
from collections.abc import Iterator
from dataclasses import dataclass, field
from http.server import BaseHTTPRequestHandler, HTTPServer
from pathlib import Path
from typing import Any

import pytest
import yaml

from pipeline.datasets.demo import demo_run
from spatialviz.cli import main

FOLDER = Path(__file__).resolve().parents[2] / ".github" / "actions" / "replay"
ACTION = yaml.safe_load((FOLDER / "action.yml").read_text())
KEPT = {
    "shelf": ("000001/000002", "shelf above the laptop"),
    "teapot": ("000002/000000", "locate a teapot that is above the cabinet"),
    "mug": ("0", "mug left of the laptop"),
}
HOSTILE = "a|b <script> @all *x* [y](http://z)"


@dataclass
class Job:
    """A job on a runner: a workspace with cases, and what GitHub gives the steps."""

    workspace: Path
    temp: Path
    environment: dict[str, str] = field(default_factory=dict)
    uploaded: str = ""

    @property
    def out(self) -> Path:
        return self.temp / "spatialviz-replay"

    @property
    def outputs(self) -> dict[str, str]:
        return dict(line.split("=", 1) for line in (self.temp / "output").read_text().splitlines())

    @property
    def comment(self) -> str:
        return (self.out / "comment.md").read_text()

    def step(self, name: str, **inputs: str) -> subprocess.CompletedProcess[str]:
        """Run the text of a step as it stands in action.yml, with its inputs filled in."""
        step = next(step for step in ACTION["runs"]["steps"] if step.get("name") == name)
        values = {**{key: str(one.get("default", "")) for key, one in ACTION["inputs"].items()}, **inputs}

        def filled(text: str) -> str:
            text = re.sub(r"\$\{\{ inputs\.([\w-]+) \}\}", lambda found: values[found[1]], text)
            text = text.replace("${{ steps.upload.outputs.artifact-url }}", self.uploaded)
            return re.sub(r"\$\{\{ steps\.replay\.outputs\.(\w+) \}\}", lambda found: self.outputs[found[1]], text)

        files = {"GITHUB_OUTPUT": self.temp / "output", "GITHUB_STEP_SUMMARY": self.temp / "summary"}
        given = {
            "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
            "GITHUB_ACTION_PATH": str(FOLDER),
            "GITHUB_WORKSPACE": str(self.workspace),
            "GITHUB_SHA": "c0ffee",
            "GITHUB_REPOSITORY": "lab/rooms",
            "GITHUB_RUN_ID": "77",
            "RUNNER_TEMP": str(self.temp),
            **{key: str(path) for key, path in files.items()},
            **self.environment,
            **{key: filled(value) for key, value in step.get("env", {}).items()},
        }
        return subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", filled(step["run"])],
            cwd=self.workspace,
            env={**os.environ, **given},
            capture_output=True,
            text=True,
            check=False,
        )


@pytest.fixture(scope="module")
def kept(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("workspace")
    seen = ["--detector", "simulated", "--model", str(demo_run().with_name("simulated.toml"))]
    for name, (frame, text) in KEPT.items():
        words = ["save-case", "demo", frame, text, *seen, "--out", str(folder / "cases" / name)]
        assert main([*words, "--name", HOSTILE] if name == "teapot" else words) == 0
    return folder


@pytest.fixture
def job(kept: Path, tmp_path: Path) -> Job:
    shutil.copytree(kept, tmp_path / "workspace")
    (tmp_path / "temp").mkdir()
    return Job(tmp_path / "workspace", tmp_path / "temp")


@pytest.fixture(scope="module")
def regressed(kept: Path, tmp_path_factory: pytest.TempPathFactory) -> Job:
    """The relation network is replaced by the rule."""
    job = Job(kept, tmp_path_factory.mktemp("temp"))
    assert job.step("Replay", srm="rule").returncode == 0
    return job


def test_other_actions_are_pinned_to_commits() -> None:
    used = [step["uses"] for step in ACTION["runs"]["steps"] if "uses" in step]
    assert len(used) == 2
    assert [one for one in used if not re.fullmatch(r"actions/[\w-]+@[0-9a-f]{40}", one)] == []
    # What is installed by default is the checkout that the action came with.
    assert (FOLDER / "../../.." / "pyproject.toml").is_file()
    text = (FOLDER / "action.yml").read_text()
    assert re.findall(r"@[0-9a-f]{40} # v\d+\.\d+\.\d+\n", text)
    # What a caller writes reaches the shell as a variable alone, never as its text.
    assert [step for step in ACTION["runs"]["steps"] if "${{" in step.get("run", "")] == []


def test_the_document_gives_inputs_that_there_are() -> None:
    text = (FOLDER.parents[2] / "docs" / "agents.md").read_text()
    (block,) = re.findall(r"```yaml\n(.*?)```", text, re.DOTALL)
    (step,) = (step for step in yaml.safe_load(block)["jobs"]["replay"]["steps"] if "replay@" in step["uses"])
    assert step["uses"].split("/", 2)[2].startswith(".github/actions/replay@")
    (listed,) = re.findall(r"Inputs are (.*?); outputs (.*?)\.", text, re.DOTALL)
    assert (
        set(step["with"])
        <= set(ACTION["inputs"])
        == {word for word in re.findall(r"`([\w-]+)`", listed[0]) if word not in ("replay", "--detector live")}
    )
    assert set(re.findall(r"`(\w+)`", listed[1])) == set(ACTION["outputs"])


def test_the_comment_names_the_module_that_regressed(regressed: Job, capsys: pytest.CaptureFixture[str]) -> None:
    capsys.readouterr()
    assert main(["replay", str(regressed.workspace / "cases"), "--srm", "rule", "--json"]) == 1
    *results, totals = [json.loads(line) for line in capsys.readouterr().out.splitlines()]
    changed = [one for one in results if one["status"] == "changed"]
    verdicts = {one["case"]: [one[when]["judgement"]["verdict"] for when in ("before", "after")] for one in changed}
    assert len(changed) == 2 == sum(before == "CORRECT" != after for before, after in verdicts.values())
    comment = regressed.comment
    assert comment.startswith("<!-- spatialviz-replay -->\n### spatialviz replay: 2 of 3 cases changed\n")
    assert "**Regressed: SRM (2)**" in comment
    assert regressed.outputs == {"status": "1", "regressed": "SRM"}
    for case, (before, after) in verdicts.items():
        name = Path(case).name
        (row,) = (line for line in comment.splitlines() if line.startswith(f"| [cases/{name}]"))
        assert f"(https://github.com/lab/rooms/tree/c0ffee/cases/{name})" in row
        assert f"| SRM | {before} → {after} |" in row
        assert f"| SRM | {before} → {after} | 1 |" in comment
    assert f"{totals['same']} unchanged." in comment
    assert "https://github.com/lab/rooms/actions/runs/77#artifacts" in comment
    assert (regressed.temp / "summary").read_text() == comment


def test_words_of_a_case_are_only_words_in_the_comment(regressed: Job) -> None:
    (row,) = (line for line in regressed.comment.splitlines() if "cases/teapot" in line)
    assert row.count("|") == 6
    assert not re.search(r"<script|@all|\*x\*|\]\(http://z", row)
    assert "<script" not in (regressed.out / "index.html").read_text()


def test_each_changed_case_has_its_page(regressed: Job) -> None:
    pages = re.findall(r'href="([^"]+)"', (regressed.out / "index.html").read_text())
    assert len(pages) == 2
    for page in pages:
        assert "CORRECT" not in page
        assert "<img" in (regressed.out / page).read_text()
    assert {p.name for p in regressed.out.iterdir()} == {*pages, "index.html", "comment.md"}


def test_the_last_step_fails_as_the_replay_did(regressed: Job) -> None:
    assert regressed.step("Status").returncode == 1


def test_another_detection_is_the_detectors_regression(job: Job) -> None:
    """The same network, and a detector that sees otherwise."""
    (job.temp / "other.toml").write_text(
        re.sub(r"recall = [\d.]+", "recall = 0.2", (demo_run().parent / "simulated.toml").read_text())
    )
    options = f"--detector simulated --model '{job.temp / 'other.toml'}'"
    assert job.step("Replay", cases="cases/shelf cases/mug", options=options).returncode == 0
    assert job.outputs["regressed"] == "OPM"
    assert "**Regressed: OPM (" in job.comment


def test_unchanged_cases_pass(job: Job) -> None:
    assert job.step("Replay").returncode == 0
    assert job.outputs == {"status": "0", "regressed": ""}
    assert "### spatialviz replay: nothing changed\n" in job.comment
    assert "3 unchanged." in job.comment
    assert job.step("Status").returncode == 0


@pytest.mark.parametrize("damage", ["missing", "broken"])
def test_what_cannot_be_run_fails_and_is_said(job: Job, damage: str) -> None:
    if damage == "missing":
        shutil.rmtree(job.workspace / "cases")
    else:
        (job.workspace / "cases" / "mug" / "rgb.png").write_bytes(b"")
    assert job.step("Replay").returncode == 0
    assert job.outputs["status"] == "2"
    assert ("there is no such case" if damage == "missing" else "damaged: [cases/mug]") in job.comment
    assert job.step("Status").returncode == 2


class Api(HTTPServer):
    """The part of GitHub's API that comments need, with 101 comments of others on the pull request."""

    def __init__(self) -> None:
        super().__init__(("127.0.0.1", 0), Handler)
        self.comments = [f"comment {n}" for n in range(101)]
        self.refused = False
        self.tokens: set[str | None] = set()

    @property
    def address(self) -> str:
        return f"http://127.0.0.1:{self.server_port}"


class Handler(BaseHTTPRequestHandler):
    server: Api

    def do_GET(self) -> None:
        page = int(re.findall(r"page=(\d+)$", self.path)[0])
        found = list(enumerate(self.server.comments))[100 * (page - 1) : 100 * page]
        self._answer([{"url": f"{self.server.address}/comments/{n}", "body": body} for n, body in found])

    def do_POST(self) -> None:
        assert self.path == "/repos/lab/rooms/issues/5/comments"
        self.server.comments.append(self._body())
        self._answer({})

    def do_PATCH(self) -> None:
        self.server.comments[int(self.path.rsplit("/", 1)[1])] = self._body()
        self._answer({})

    def _body(self) -> str:
        text = json.loads(self.rfile.read(int(self.headers["Content-Length"])))["body"]
        return self.server.comments[-1] if self.server.refused else text

    def _answer(self, content: Any) -> None:
        self.server.tokens.add(self.headers["Authorization"])
        writes = self.command != "GET"
        self.send_response(403 if writes and self.server.refused else 200)
        self.end_headers()
        self.wfile.write(json.dumps(content).encode())

    def log_message(self, format: str, *args: Any) -> None:
        pass


@pytest.fixture
def api() -> Iterator[Api]:
    server = Api()
    thread = threading.Thread(target=server.serve_forever)
    thread.start()
    yield server
    server.shutdown()
    thread.join()
    server.server_close()


def test_the_comment_leads_to_the_artifact_itself(regressed: Job, job: Job, api: Api) -> None:
    with_comment(job, api, "")
    shutil.copy(regressed.out / "comment.md", job.out)
    job.uploaded = "https://github.com/lab/rooms/actions/runs/77/artifacts/3"
    assert job.step("Comment", token="t0ken").returncode == 0
    assert f"[spatialviz-replay]({job.uploaded})" in api.comments[-1]
    assert "#artifacts" not in api.comments[-1]
    assert api.comments[-1] == regressed.comment.replace(
        f"{job.uploaded.removesuffix('/artifacts/3')}#artifacts", job.uploaded
    )


def with_comment(job: Job, api: Api, title: str, number: int | None = 5) -> Job:
    """A job whose replay said something, on a pull request or not."""
    job.out.mkdir(exist_ok=True)
    (job.out / "comment.md").write_text(f"<!-- spatialviz-replay -->\n### spatialviz replay: {title}\n")
    (job.temp / "event").write_text(json.dumps({} if number is None else {"pull_request": {"number": number}}))
    job.environment = {"GITHUB_EVENT_PATH": str(job.temp / "event"), "GITHUB_API_URL": api.address}
    return job


def test_a_pull_request_has_one_comment_which_follows(job: Job, api: Api) -> None:
    assert with_comment(job, api, "nothing changed").step("Comment", token="t0ken").returncode == 0
    assert len(api.comments) == 101, "nothing is said where there is nothing to say"
    for title in ("2 of 3 cases changed", "1 of 3 cases changed", "nothing changed"):
        assert with_comment(job, api, title).step("Comment", token="t0ken").returncode == 0
        assert len(api.comments) == 102
        assert title in api.comments[-1]
    assert api.comments[:101] == [f"comment {n}" for n in range(101)]
    assert api.tokens == {"Bearer t0ken"}


def test_without_leave_to_write_the_comment_is_skipped(job: Job, api: Api) -> None:
    api.refused = True
    done = with_comment(job, api, "2 of 3 cases changed").step("Comment", token="t0ken")
    assert done.returncode == 0
    assert done.stdout.startswith("::notice::no comment was written: HTTP Error 403")
    assert "t0ken" not in done.stdout + done.stderr


def test_a_push_has_no_pull_request_to_comment_on(job: Job, api: Api) -> None:
    done = with_comment(job, api, "2 of 3 cases changed", None).step("Comment", token="t0ken")
    assert done.returncode == 0
    assert len(api.comments) == 101
    assert not api.tokens
