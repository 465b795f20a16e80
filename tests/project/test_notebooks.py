"""The notebooks: short lessons with their outputs, which are what they show when run now."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import nbformat
import pytest
from notebook_outputs import (
    METADATA,
    NOTEBOOKS,
    ROOT,
    differences,
    executed,
    missing,
    shown,
    text_of,
)

import exact_mdp

LIMIT = 300_000  # bytes that a reader may be made to load
PLACES = re.compile(r"/(?:home|root|tmp|work|Users)/|[A-Z]:\\\\|site-packages")
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code(path: Path) -> list[Any]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


def imports(path: Path) -> Iterator[tuple[str, list[str]]]:
    """Yield each module that a notebook imports, with the names that it takes from there."""
    for cell in code(path):
        for node in ast.walk(ast.parse(cell.source)):
            if isinstance(node, ast.Import):
                yield from ((alias.name, []) for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                yield node.module or "", [alias.name for alias in node.names]


@each_notebook
def test_holds_its_outputs_and_nothing_of_this_machine(path: Path) -> None:
    """The file is what `make outputs` writes: no times, no paths, no scripts, no warnings."""
    notebook, text = read(path), path.read_text("utf-8")
    outputs = [output for cell in code(path) for output in cell.outputs]
    assert text == text_of(notebook)
    assert len(text.encode()) <= LIMIT
    assert notebook.metadata == METADATA
    assert [cell.execution_count for cell in code(path)] == list(range(1, len(code(path)) + 1))
    assert {output.output_type for output in outputs} <= {
        "stream",
        "display_data",
        "execute_result",
    }
    assert {kind for cell in code(path) for kind, _ in shown(cell)} <= {
        "stdout", "text/plain", "text/html", "image/png",
    }  # fmt: skip
    assert not PLACES.search(text)
    assert not re.search("<(script|iframe)", text)


@each_notebook
def test_uses_public_names_and_what_the_extra_brings(path: Path) -> None:
    own = [(module, names) for module, names in imports(path) if module.startswith("exact_mdp")]
    assert own
    assert {module for module, _ in own} == {"exact_mdp"}
    assert {name for _, names in own for name in names} <= set(exact_mdp.__all__)
    extras = PROJECT["optional-dependencies"]
    parts = [PROJECT["dependencies"], *(extras[name] for name in ("notebooks", "lp", "plots"))]
    brought = {re.split(r"[^\w-]", line)[0].lower() for lines in parts for line in lines}
    packages = {module.partition(".")[0] for module, _ in imports(path)} - {"exact_mdp"}
    known = packages_distributions()
    for name in packages - sys.stdlib_module_names:
        assert brought & set(map(str.lower, known.get(name, []))), name


@each_notebook
def test_shows_what_it_holds(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From top to bottom, with nothing but the extra. `make outputs` writes it anew."""
    if package := missing(path):
        pytest.skip(f"the package {package} is not installed")
    for name in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    assert list(differences(read(path), executed(path))) == []
