"""The files around the code agree: pages, workflows, versions, hooks, requirements, locks."""

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest
import yaml

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "exact_mdp"  # which short links at the top lead into
TOML = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))
MAKE = (ROOT / "Makefile").read_text("utf-8")
TARGETS = set(re.findall(r"^([a-z-]+):(?!=)", MAKE, re.M))
WORKFLOWS = {path.stem: yaml.safe_load(path.read_text("utf-8"))
             for path in sorted((ROOT / ".github" / "workflows").glob("*.yml"))}  # fmt: skip
TEXTS = [ROOT / f"{name}.md" for name in ("ARCHITECTURE", "CHANGELOG", "CONTRIBUTING", "SECURITY")]


@pytest.mark.parametrize("page", TEXTS, ids=lambda page: page.stem)
def test_what_a_page_names_is_there(page: Path) -> None:
    text = page.read_text("utf-8")
    files = re.findall(r"`([\w/.]+\.(?:py|toml|lock))`", text)
    folders = ("docs", "tests", "exact_mdp")
    names = {path.name for folder in folders for path in (ROOT / folder).rglob("*.*")}
    lost = [name for name in files if not any((top / name).exists() for top in (ROOT, PACKAGE))]
    assert [name for name in lost if "/" in name or name not in names] == []
    assert set(re.findall(r"`make ([a-z-]+)", text)) - TARGETS == set()


@pytest.mark.parametrize("name", WORKFLOWS)
def test_a_workflow_runs_what_there_is(name: str) -> None:
    """Its make targets exist, its Pythons are allowed, and no script has an input in it."""
    assert WORKFLOWS[name]["permissions"] == {"contents": "read"}
    lowest = TOML["project"]["requires-python"].removeprefix(">=")
    for job in WORKFLOWS[name]["jobs"].values():
        versions = job.get("strategy", {}).get("matrix", {}).get("python", [lowest])
        assert versions[0] == lowest
        for step in job["steps"]:
            script = step.get("run", "")
            assert "${{" not in script
            assert set(re.findall(r"\bmake ([a-z-]+)", script)) - TARGETS == set()
            assert re.fullmatch(r"[\w-]+/[\w-]+@(release/)?v\d+", step.get("uses", "a/b@v1"))


def test_versions_agree() -> None:
    """Of the project, of the Pythons of the workflows, and of the tools of the hooks."""
    version = TOML["project"]["version"]
    assert yaml.safe_load((ROOT / "CITATION.cff").read_text("utf-8"))["version"] == version
    changes = (ROOT / "CHANGELOG.md").read_text("utf-8")
    assert re.findall(r"^## (\d[\d.]*) ", changes, re.M)[:1] in ([], [version])
    assert "\n## Unreleased\n" in changes
    every, newest = (
        WORKFLOWS[name]["jobs"][job]["strategy"]["matrix"]["python"]
        for name, job in (("tests", "matrix"), ("newest", "newest"))
    )
    assert newest[-1] == every[-1]
    usual, local = yaml.safe_load((ROOT / ".pre-commit-config.yaml").read_text("utf-8"))["repos"]
    assert re.fullmatch(r"v\d+\.\d+\.\d+", usual["rev"])
    for hook in local["hooks"]:
        tool = re.match(r"\.venv/bin/python -m (\w+)", hook["entry"])
        assert tool
        assert tool[1] in locked("requirements.lock")


# ---- requirements --------------------------------------------------------------------------------


def name_of(requirement: str) -> str:
    name = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert name
    return re.sub(r"[-_.]+", "-", name[0]).lower()


def declared() -> dict[str, str]:
    """Every requirement by the name of its package."""
    extras, groups = TOML["project"]["optional-dependencies"], TOML["dependency-groups"]
    parts = [TOML["project"]["dependencies"], *extras.values(), *groups.values()]
    named = [each for part in parts for each in part if isinstance(each, str)]
    return {name_of(each): each for each in named if name_of(each) != "exact-mdp"}


def locked(name: str) -> dict[str, str]:
    text = (ROOT / name).read_text()
    return {name_of(match[1]): match[2] for match in re.finditer(r"(?m)^(\S+?)==(\S+)", text)}


def imported(path: Path) -> set[str]:
    nodes = list(ast.walk(ast.parse(path.read_text("utf-8"))))
    names = {alias.name for node in nodes if isinstance(node, ast.Import) for alias in node.names}
    names |= {n.module for n in nodes if isinstance(n, ast.ImportFrom) and n.module and not n.level}
    return {name.partition(".")[0] for name in names}


def test_every_import_is_declared() -> None:
    """Each package that a module or a test imports is named in pyproject.toml."""
    files = [path for folder in ("exact_mdp", "tests") for path in (ROOT / folder).rglob("*.py")]
    own = {"exact_mdp", *(path.stem for path in (ROOT / "tests").rglob("*.py"))}
    own |= {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    names = set().union(*map(imported, files)) - own - set(sys.stdlib_module_names)
    packages = {"flint": ["python-flint"]} | dict(packages_distributions())
    known = {name: {name_of(each) for each in packages.get(name, [name])} for name in names}
    assert {name for name in names if not known[name] & set(declared())} == set()


@pytest.mark.parametrize("name", ["requirements.lock", "requirements-lowest.lock"])
def test_whatever_is_installed_has_a_hash_and_no_host(name: str) -> None:
    text = (ROOT / name).read_text()
    entries = re.split(r"(?m)^(?=\S+==)", text)[1:]
    assert len(entries) >= len(locked(name)) > 0  # one for some versions of Python, one for others
    assert [each.split()[0] for each in entries if "--hash=sha256:" not in each] == []
    assert "://" not in text
    installs = [line for line in MAKE.splitlines() if "$(INSTALL)" in line]
    assert len(installs) >= 4
    for line in installs:  # nothing is downloaded for a build of the project itself
        assert "--require-hashes" in line or line.endswith("--no-build-isolation -e .")


def test_the_locks_hold_what_is_declared() -> None:
    """`make test-lowest` runs at the declared bounds, not at something newer."""
    assert set(declared()) <= set(locked("requirements.lock"))
    lowest, newer = locked("requirements-lowest.lock"), {}
    for name, requirement in declared().items():
        bound = re.search(r">=([0-9.]+)", requirement)
        assert bound, f"{requirement} has no lower bound"
        if re.sub(r"(\.0)+$", "", lowest.get(name, bound[1])) != re.sub(r"(\.0)+$", "", bound[1]):
            newer[name] = (bound[1], lowest[name])
    assert newer == {}
    assert {"numpy", "scipy", "numba", "cvxpy", "gymnasium", "umbi", "dask"} <= set(lowest)
