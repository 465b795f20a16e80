"""What is declared to work does: SciPy's indices, and a package for every import of the tests."""

from __future__ import annotations

import ast
import re
import sys
import tomllib
from importlib.metadata import packages_distributions
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
TOML = tomllib.loads((ROOT / "pyproject.toml").read_text())
PROJECT, GROUPS = TOML["project"], TOML["dependency-groups"]
LOCKS = ("requirements.lock", "requirements-lowest.lock")


def test_one_module_asks_for_a_triangular_solve() -> None:
    """The cast stands at the only place that needs it."""
    holders = [
        str(path.relative_to(ROOT))
        for path in sorted((ROOT / "exact_mdp").rglob("*.py"))
        if "import spsolve_triangular" in path.read_text()
        or "spsolve_triangular(" in path.read_text()
    ]
    assert holders == [str(Path("exact_mdp") / "solvers" / "bounds" / "elimination.py")]


def name_of(requirement: str) -> str:
    found = re.match(r"[A-Za-z0-9._-]+", requirement)
    assert found
    return re.sub(r"[-_.]+", "-", found[0]).lower()


def declared() -> dict[str, str]:
    """Return every requirement by the name of its package."""
    parts = [*PROJECT["optional-dependencies"].values(), *GROUPS.values()]
    listed = [*PROJECT["dependencies"], *(each for part in parts for each in part)]
    named = [each for each in listed if isinstance(each, str)]  # a group may include another
    return {name_of(each): each for each in named if name_of(each) != "exact-mdp"}


def imported(path: Path) -> set[str]:
    found = set()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[0] for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            found.add(node.module.partition(".")[0])
    return found


def test_every_import_is_declared() -> None:
    """Each package that a module or a test imports is named in pyproject.toml."""
    folders = ("exact_mdp", "tests")
    files = [path for folder in folders for path in (ROOT / folder).rglob("*.py")]
    own = {"exact_mdp", *(path.stem for path in (ROOT / "tests").rglob("*.py"))}
    own |= {path.name for path in (ROOT / "tests").iterdir() if path.is_dir()}
    names = set().union(*map(imported, files)) - own - set(sys.stdlib_module_names)
    # Under another name, and perhaps not installed.
    packages = {"flint": ["python-flint"]} | dict(packages_distributions())
    missing = {
        name
        for name in names
        if not {name_of(each) for each in packages.get(name, [name])} & set(declared())
    }
    assert missing == set()


def test_every_requirement_has_a_lower_bound() -> None:
    """Without one nothing is declared, and nothing can be tested."""
    assert [each for each in declared().values() if ">=" not in each] == []


def locked(name: str) -> dict[str, str]:
    text = (ROOT / name).read_text()
    return {name_of(found[1]): found[2] for found in re.finditer(r"(?m)^(\S+?)==(\S+)", text)}


@pytest.mark.parametrize("name", LOCKS)
def test_whatever_is_installed_has_a_hash_and_no_host(name: str) -> None:
    """Every locked package has hashes, the one that writes the locks too."""
    text = (ROOT / name).read_text()
    entries = re.split(r"(?m)^(?=\S+==)", text)[1:]
    assert len(entries) >= len(locked(name)) > 0  # one for some versions of Python, one for others
    assert [each.split()[0] for each in entries if "--hash=sha256:" not in each] == []
    assert "://" not in text


def test_the_lock_holds_whatever_is_declared() -> None:
    """`make setup` serves the documentation, the benchmarks and `make lock`, too."""
    assert set(declared()) - set(locked("requirements.lock")) == set()


def test_nothing_is_installed_without_a_hash() -> None:
    """But the project itself, and nothing is downloaded for a build of it."""
    text = (ROOT / "Makefile").read_text()
    installs = [line for line in text.splitlines() if "$(INSTALL)" in line]
    assert len(installs) >= 4
    for line in installs:
        assert "--require-hashes" in line or line.endswith("--no-build-isolation -e .")


def test_the_lowest_lock_holds_the_declared_bounds() -> None:
    """`make test-lowest` runs at what pyproject.toml declares, not at something newer."""
    held = locked("requirements-lowest.lock")

    def cut(version: str) -> list[str]:
        parts = version.split(".")
        while parts[-1] == "0":
            parts.pop()
        return parts

    newer = {}
    for name, requirement in declared().items():
        bound = re.search(r">=([0-9.]+)", requirement)
        assert bound
        if name in held and cut(held[name]) != cut(bound[1]):
            newer[name] = (bound[1], held[name])
    assert newer == {}
    assert {"numpy", "scipy", "numba", "cvxpy", "gymnasium", "umbi", "dask"} <= set(held)
