"""The workflow and the pre-commit hook of docs/gate.md, run as far as a shell can."""

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

from exact_mdp import Scenario

ROOT = Path(__file__).resolve().parents[2]
ACTION = yaml.safe_load((ROOT / "action.yml").read_text("utf-8"))
GUIDE = (ROOT / "docs" / "gate.md").read_text("utf-8")
BLOCKS = [
    yaml.safe_load(block) for block in re.findall(r"^```yaml\n(.*?)^```$", GUIDE, re.M | re.S)
]
STEPS = next(block for block in BLOCKS if "jobs" in block)["jobs"]["policy"]["steps"]
HOOKS = next(block for block in BLOCKS if "repos" in block)
(GATE,) = (step["with"] for step in STEPS if step["uses"].startswith("OWNER/exact-mdp@"))
PROGRAM = Path(sys.executable).with_name("exact-mdp")

# A stand-in for Python that makes an "environment" of the program that is installed here.
PYTHON = """#!/bin/bash -e
[ "$1 $2" = "-m venv" ]
mkdir -p "$3/bin"
ln -sf {program} "$3/bin/exact-mdp"
ln -sf {python} "$3/bin/python"
printf '#!/bin/bash\\nprintf "%%s\\\\n" "$@" > {log}\\n' > "$3/bin/pip"
chmod +x "$3/bin/pip"
"""


@pytest.fixture
def project(tmp_path: Path) -> Path:
    """A repository with a model and a Q-table, as the guide names them."""
    folder = tmp_path / "project"
    folder.mkdir()
    Scenario.load("tea").compile().save(folder / "model.npz")
    np.save(folder / "q_table.npy", np.eye(3)[[1] * 8])
    return folder


def act(project: Path, program: Path = PROGRAM, **given: str) -> tuple[int, str, str]:
    """Run the action's steps as a runner does; return status, output and what pip was told."""
    inputs = {name: about.get("default") for name, about in ACTION["inputs"].items()} | given
    assert None not in inputs.values(), "an input that is required is missing"
    assert set(inputs) == set(ACTION["inputs"]), "an input that the action does not have"
    bin, temp, log = (project.parent / name for name in ("bin", "temp", "pip.txt"))
    for folder in (bin, temp):
        folder.mkdir(exist_ok=True)
    program_, log_, python = (shlex.quote(str(path)) for path in (program, log, sys.executable))
    (bin / "python3").write_text(PYTHON.format(program=program_, log=log_, python=python))
    (bin / "python3").chmod(0o755)
    environment = os.environ | {
        "PATH": f"{bin}:{os.environ['PATH']}",
        "RUNNER_TEMP": str(temp),
        "GITHUB_ACTIONS": "true",
        "GITHUB_OUTPUT": str(project.parent / "output.txt"),
        "GITHUB_STEP_SUMMARY": str(project.parent / "summary.md"),
    }
    printed = ""
    for step in ACTION["runs"]["steps"]:
        if "uses" in step:  # the cache, which is the host's
            continue
        assert "${{" not in step["run"], "a script with an input in it runs what the input says"
        env = {name: filled(text, inputs, temp) for name, text in step["env"].items()}
        done = subprocess.run(
            ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", step["run"]],
            cwd=project, env=environment | env, capture_output=True, text=True,
        )  # fmt: skip
        printed += done.stdout + done.stderr
        if done.returncode:
            break
    return done.returncode, printed, log.read_text()


def filled(text: str, inputs: dict[str, Any], temp: Path) -> str:
    text = text.replace("${{ runner.temp }}", str(temp))
    if "${{" not in text:
        return text
    match = re.fullmatch(r"\$\{\{ (?:inputs\.([\w-]+)|(github\.action_path)) \}\}", text)
    assert match, text
    return str(ROOT) if match[2] else inputs[match[1]]


def test_the_workflow_of_the_guide_reports_a_policy_that_loses_too_much(project: Path) -> None:
    status, said, installed = act(project, **GATE)
    assert status == 1, said
    assert installed.splitlines()[-1] == str(ROOT)
    (annotation,) = (line for line in said.splitlines() if line.startswith("::"))
    assert annotation.startswith("::error title=q_table.npy in tea%3A failed::")
    assert "%0Afailed: the regret is not at most 0.5: it is " in annotation
    assert "| state | yours | optimal |" in (project.parent / "summary.md").read_text("utf-8")
    root = ElementTree.parse(project / "policy-report.xml").getroot()
    assert (root.get("failures"), root.get("errors")) == ("1", "0")
    assert "<!DOCTYPE html>" in (project / "policy-report.html").read_text("utf-8")
    (upload,) = (s for s in STEPS if "upload" in s["uses"])
    assert len(list(project.glob(upload["with"]["path"]))) == 2


def test_the_certificate_of_a_verdict_is_kept_also_of_a_policy_that_fails(project: Path) -> None:
    status, said, _ = act(project, **GATE, certificate="policy.json")
    assert status == 1, said
    check = [PROGRAM, "verify", "policy.json", "model.npz", "--proven"]
    done = subprocess.run(check, cwd=project, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    upload = ACTION["runs"]["steps"][-1]
    assert upload["uses"].startswith("actions/upload-artifact@")
    assert upload["if"] == "${{ !cancelled() && inputs.certificate != '' }}"
    assert upload["with"]["path"] == "${{ inputs.certificate }}"
    assert ACTION["inputs"]["certificate"]["default"] == ""


@pytest.mark.parametrize("name", ["$(touch owned)", "`touch owned`", '"; touch owned; "', "--x y"])
def test_an_input_is_no_command(project: Path, name: str) -> None:
    """Whatever an input says is one word of the command, and model and policy are no options."""
    echo = project / "echo"
    echo.write_text('#!/bin/bash\nprintf "%s\\n" "$@"\n')
    echo.chmod(0o755)
    inputs = ("model", "policy", "max-regret", "options", "junit", "html", "certificate")
    _, said, _ = act(project, echo, **dict.fromkeys(inputs, name))
    named = [f"--{option}={name}" for option in ("max-regret", "junit", "html", "certificate")]
    options = [name, *named]
    assert said.splitlines() == ["check", *options, "--", name, name]
    assert not list(project.parent.rglob("owned"))


def test_the_hook_of_the_guide(project: Path) -> None:
    (hook,) = yaml.safe_load((ROOT / ".pre-commit-hooks.yaml").read_text("utf-8"))
    (used,) = HOOKS["repos"][0]["hooks"]
    assert used["id"] == hook["id"]
    assert hook["pass_filenames"] is False
    assert re.search(hook["files"], "model.npz")
    assert re.search(hook["files"], "q_table.npy")
    program, *words = [*shlex.split(hook["entry"]), *used["args"]]
    assert program == PROGRAM.name
    done = subprocess.run(
        [PROGRAM, *words], cwd=project, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1, done.stderr
    assert "FAILED" in done.stdout
