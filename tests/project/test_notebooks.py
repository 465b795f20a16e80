"""The notebooks: short lessons with their outputs, which are what they show when run now."""

import re
from pathlib import Path
from typing import Any

import nbformat
import pytest
from notebook_outputs import METADATA, NOTEBOOKS, differences, executed, missing, shown, text_of

LIMIT = 300_000  # bytes that a reader may be made to load
PLACES = re.compile(r"/(?:home|root|tmp|work|Users)/|[A-Z]:\\\\|site-packages")
each_notebook = pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)


def read(path: Path) -> Any:
    return nbformat.read(path, as_version=4)


def code(path: Path) -> list[Any]:
    return [cell for cell in read(path).cells if cell.cell_type == "code"]


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
def test_shows_what_it_holds(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """From top to bottom, with nothing but the extra. `make outputs` writes it anew."""
    if package := missing(path):
        pytest.skip(f"the package {package} is not installed")
    for name in ("IPYTHONDIR", "JUPYTER_DATA_DIR", "JUPYTER_RUNTIME_DIR", "JUPYTER_CONFIG_DIR"):
        monkeypatch.setenv(name, str(tmp_path / name))
    assert list(differences(read(path), executed(path))) == []
