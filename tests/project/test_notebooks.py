"""The notebooks run from top to bottom, say first what they are for, and are plain text."""

from __future__ import annotations

import ast
import os
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from importlib.util import find_spec
from pathlib import Path

import jupytext
import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
SOURCES = sorted((ROOT / "notebooks").glob("*.py"))
NEEDS = {"09_an_icu_in_exact_numbers": "icu_sepsis"}  # not a part of the package
LIMIT = 1_000_000  # characters of output that a reader may be made to load
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]


def extras(name: str) -> Iterator[str]:
    """An extra, and those that it brings."""
    yield name
    for requirement in PROJECT["optional-dependencies"][name]:
        if brought := re.match(r"exact-mdp\[(.+)]", requirement):
            for other in brought[1].split(","):
                yield from extras(other)


HELD = set(extras("notebooks"))
ABSENT = ["certifi", "httpcore", "httpx", "pyarrow", "stormpy", "umbi"]  # of other extras


def test_they_are_numbered() -> None:
    numbers = [int(source.name[:2]) for source in SOURCES]
    assert len(set(numbers)) == len(numbers) >= 7


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_says_first_what_the_reader_will_be_able_to_do(source: Path) -> None:
    first = jupytext.read(source).cells[0]
    assert first.cell_type == "markdown"
    assert f"# {int(source.name[:2])}. " in first.source
    assert "**After this notebook you can**" in first.source


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_is_prose_and_short_cells(source: Path) -> None:
    cells = jupytext.read(source).cells
    code = [cell.source for cell in cells if cell.cell_type == "code"]
    assert len(cells) >= 1.5 * len(code)  # every cell of code has something said of it
    assert all("def test" not in text and "sys.path" not in text for text in code)


def test_the_extra_brings_what_notebooks_import() -> None:
    lists = [PROJECT["dependencies"], *(PROJECT["optional-dependencies"][name] for name in HELD)]
    brought = {re.split(r"[^\w-]", each)[0].lower() for some in lists for each in some}
    known, missing = packages_distributions(), set()
    for source in SOURCES:
        for node in ast.walk(ast.parse(source.read_text())):
            names = [each.name for each in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            for name in {name.partition(".")[0] for name in names} - sys.stdlib_module_names:
                if name != "exact_mdp" and brought.isdisjoint(map(str.lower, known.get(name, []))):
                    missing.add(name)
    assert missing == set()
    assert "gymnasium" in brought


@pytest.mark.parametrize("source", SOURCES, ids=lambda path: path.stem)
def test_runs_from_top_to_bottom(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if (package := NEEDS.get(source.stem)) and not find_spec(package):
        pytest.skip(f"the package {package} is not installed")
    monkeypatch.setenv("MPLBACKEND", "module://matplotlib_inline.backend_inline")
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")]))
    for name in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    notebook = jupytext.read(source)
    # As where nothing but the extra is installed.
    hidden = f"import sys; sys.modules.update(dict.fromkeys({ABSENT}))"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(hidden))
    NotebookClient(
        notebook,
        timeout=300,  # of a cell, against endless ones: no speed is asserted
        kernel_name="python3",
        resources={"metadata": {"path": str(tmp_path)}},
    ).execute()
    outputs = [o for cell in notebook.cells for o in cell.get("outputs", [])]
    assert not [o for o in outputs if o.output_type == "error"]
    assert not [o for o in outputs if o.get("name") == "stderr"], "a warning is shown to readers"
    assert any("image/png" in str(o.get("data", {})) for o in outputs)
    assert len(nbformat.writes(notebook)) < LIMIT
    assert not [p for p in tmp_path.iterdir() if p.suffix], "files are left behind"
