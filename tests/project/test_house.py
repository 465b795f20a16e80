"""What stands around the code says what is so: workflows, versions, hooks."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "exact_mdp"  # which short links at the top lead into
TOML = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
TARGETS = set(re.findall(r"^([a-z-]+):(?!=)", (ROOT / "Makefile").read_text("utf-8"), re.M))
WORKFLOWS = sorted((ROOT / ".github" / "workflows").glob("*.yml"))
TEXTS = [ROOT / f"{name}.md" for name in ("ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY")]


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.stem)
def test_what_a_page_names_is_there(page: Path) -> None:
    """Each file in code, each target of make."""
    text = page.read_text("utf-8")
    files = re.findall(r"`([\w/.]+\.(?:py|toml|lock))`", text)
    folders = ("docs", "tests", "exact_mdp")
    names = {path.name for folder in folders for path in (ROOT / folder).rglob("*.*")}
    lost = [name for name in files if not any((top / name).exists() for top in (ROOT, PACKAGE))]
    assert [name for name in lost if "/" in name or name not in names] == []
    assert set(re.findall(r"`make ([a-z-]+)", text)) - TARGETS == set()


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_runs_what_there_is(path: Path) -> None:
    """Its make targets exist, its Pythons are allowed, and no script has an input in it."""
    found = yaml.safe_load(path.read_text("utf-8"))
    assert found["permissions"] == {"contents": "read"}
    lowest = TOML["project"]["requires-python"].removeprefix(">=")
    for job in found["jobs"].values():
        assert job["name"]
        versions = job.get("strategy", {}).get("matrix", {}).get("python", [lowest])
        assert versions[0] == lowest
        for step in job["steps"]:
            script = step.get("run", "")
            assert "${{" not in script
            assert set(re.findall(r"\bmake ([a-z-]+)", script)) - TARGETS == set()
            assert re.fullmatch(r"[\w-]+/[\w-]+@(release/)?v\d+", step.get("uses", "a/b@v1"))


def test_the_weekly_run_tests_the_newest_python_of_the_matrix() -> None:
    matrix, weekly = (
        yaml.safe_load((ROOT / f".github/workflows/{name}.yml").read_text("utf-8"))["jobs"][job]
        for name, job in (("tests", "matrix"), ("newest", "newest"))
    )
    newest = matrix["strategy"]["matrix"]["python"][-1]
    assert weekly["strategy"]["matrix"]["python"][-1] == newest


def test_the_forms_can_be_read() -> None:
    forms = sorted((ROOT / ".github" / "ISSUE_TEMPLATE").glob("*.yml"))
    named = [yaml.safe_load(form.read_text("utf-8")) for form in forms if form.stem != "config"]
    assert len(named) >= 2
    assert all({"name", "description", "body"} <= set(form) for form in named)


def test_ruff_and_mypy_of_the_hooks_are_those_of_the_lock() -> None:
    """The usual hooks have a version; each of the others runs a tool that the lock has."""
    found = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))
    usual, local = found["repos"]
    assert re.fullmatch(r"v\d+\.\d+\.\d+", usual["rev"])
    assert local["repo"] == "local"
    for hook in local["hooks"]:
        assert hook["language"] == "system"
        tool = re.match(r"\.venv/bin/python -m (\w+)", hook["entry"])
        assert tool
        assert f"\n{tool[1]}==" in (ROOT / "requirements.lock").read_text("utf-8")


def test_the_version_is_the_same_everywhere() -> None:
    version = TOML["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["version"] == version
    released = re.findall(r"^## (\d[\d.]*) ", (ROOT / "CHANGELOG.md").read_text("utf-8"), re.M)
    assert not released or released[0] == version
    assert "\n## Unreleased\n" in (ROOT / "CHANGELOG.md").read_text("utf-8")


def test_rules_of_the_review_are_refused_by_name_with_a_reason() -> None:
    lines = (ROOT / "pyproject.toml").read_text("utf-8").partition("[tool.repo-review]")[2]
    refused = TOML["tool"]["repo-review"]["ignore"]
    assert refused
    for rule in refused:
        assert re.search(rf'"{rule}", +# \w+', lines), rule
