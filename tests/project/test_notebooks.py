"""The notebooks: short lessons with their outputs, which are what they show when run now."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from copy import deepcopy
from importlib.metadata import packages_distributions
from pathlib import Path
from typing import Any

import nbformat
import pytest
from notebook_outputs import (
    METADATA,
    NOTEBOOKS,
    ROOT,
    alike,
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


def test_they_are_numbered_in_the_order_of_the_lessons() -> None:
    assert [path.name.partition("_")[0] for path in NOTEBOOKS] == list("1234567")
    assert {path.suffix for path in (ROOT / "notebooks").iterdir() if path.is_file()} == {".ipynb"}


@each_notebook
def test_is_a_short_lesson(path: Path) -> None:
    """It opens with a question; cells of code stand between words, and one draws a picture."""
    first, cells = read(path).cells[0], read(path).cells
    assert first.cell_type == "markdown"
    assert first.source.startswith(f"# {path.stem[0]}. ")
    assert re.search(r"\*\*[^*]+\?[^*]*\*\*", first.source)
    assert len(cells) >= 1.5 * len(code(path))
    assert all("def test" not in cell.source for cell in code(path))
    assert any(kind == "image/png" for cell in code(path) for kind, _ in shown(cell))


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


@pytest.mark.parametrize(
    ("text", "other", "expected"),
    [
        ("value 0.123", "value 0.124", True),
        ("value 0.123", "value 0.125", False),
        ("3.9e-05", "4.0e-05", True),
        ("3.9e-05", "4.1e-05", False),
        ("241 states, 19/25", "241 states, 19/25", True),
        ("241 states, 19/25", "242 states, 19/25", False),
        ("146.2358 ± 2e-3 (bounded)", "146.2371 ± 1e-9 (bounded)", True),
        ("146.2358 ± 2e-3 (bounded)", "146.2391 ± 1e-9 (bounded)", False),
        ("1,528,528 transitions", "1,528,529 transitions", False),
        ("passed: True", "passed: False", False),
        ("one 1.0", "one 1.0 2.0", False),
    ],
)
def test_numbers_are_alike_within_their_errors(text: str, other: str, expected: bool) -> None:
    assert alike(text, other) is alike(other, text) is expected


def test_an_output_that_changed_is_seen() -> None:
    stored = read(NOTEBOOKS[0])
    assert list(differences(stored, stored)) == []
    now = deepcopy(stored)
    changed = [cell for cell in now.cells if cell.cell_type == "code"]
    streams = [output for cell in changed for output in cell.outputs if "text" in output]
    streams[0].text = streams[0].text.replace("failed", "passed")
    changed[-1].outputs = []
    assert len(list(differences(stored, now))) == 2
    for cell in stored.cells:
        cell.metadata.tags = ["volatile"]
    assert list(differences(stored, now)) == []
