"""What the notebooks show when they are run now, and where that is not what they hold.

    python tests/support/notebook_outputs.py

runs each notebook in an empty folder and writes its outputs into it: the same bytes, unless they
are others. A cell whose text may change from run to run has the tag `volatile`.
"""

import os
import re
from collections.abc import Iterator
from decimal import Decimal
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import nbformat
from nbclient import NotebookClient

ROOT = Path(__file__).resolve().parents[2]
NOTEBOOKS = sorted((ROOT / "notebooks").glob("*.ipynb"))
NEEDS = {"7_an_icu": "icu_sepsis"}  # not a part of the package, and asks for an archive
OTHERS = ["httpx", "pyarrow", "stormpy", "umbi"]  # what only other extras than `notebooks` bring
METADATA = {
    "kernelspec": {"display_name": "Python 3", "language": "python", "name": "python3"},
    "language_info": {"name": "python"},
}
# With its error, where that is stated.
NUMBER = re.compile(r"(?<![\w.])-?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?(?: ± [\d.]+(?:e[-+]?\d+)?)?")


def missing(path: Path) -> str:
    """Return the package that a notebook asks for and that is not installed, or nothing."""
    needed = NEEDS.get(path.stem, "")
    return needed if needed and not find_spec(needed) else ""


def executed(path: Path) -> Any:
    """Return a notebook as it is after a run from top to bottom; an error in a cell is raised."""
    notebook: Any = nbformat.read(path, as_version=4)
    hidden = f"import sys; sys.modules.update(dict.fromkeys({OTHERS}))"
    notebook.cells.insert(0, nbformat.v4.new_code_cell(hidden))
    paths = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
    inline = {"MPLBACKEND": "module://matplotlib_inline.backend_inline", "PYTHONPATH": paths}
    with TemporaryDirectory() as folder:
        NotebookClient(
            notebook,
            timeout=300,  # seconds of a cell, against endless ones
            kernel_name="python3",
            record_timing=False,
            coalesce_streams=True,
        ).execute(cwd=folder, env=os.environ | inline)
        assert not list(Path(folder).iterdir()), "files are left behind"
    del notebook.cells[0]
    code = [cell for cell in notebook.cells if cell.cell_type == "code"]
    for number, cell in enumerate(code, 1):
        cell.execution_count = number
        for output in cell.outputs:
            if "execution_count" in output:
                output.execution_count = number
    notebook.metadata = METADATA
    return notebook


def text_of(notebook: Any) -> str:
    text: str = nbformat.writes(notebook)
    return text + "\n"


def differences(stored: Any, now: Any) -> Iterator[str]:
    """Yield where stored outputs are not those of now; a picture only has to be there."""
    for number, (old, new) in enumerate(zip(stored.cells, now.cells, strict=True)):
        if old.cell_type == "code" and "volatile" not in old.metadata.get("tags", []):
            before, after = list(shown(old)), list(shown(new))
            if [kind for kind, _ in before] != [kind for kind, _ in after]:
                yield f"cell {number}: other outputs"
                continue
            for (kind, text), (_, other) in zip(before, after, strict=True):
                if kind != "image/png" and not alike(text, other):
                    yield f"cell {number}, {kind}: {text!r}, now {other!r}"


def shown(cell: Any) -> Iterator[tuple[str, str]]:
    """Yield the outputs of a cell, each with its kind."""
    for output in cell.outputs:
        if output.output_type == "stream":
            yield output.name, output.text
        else:
            yield from sorted(output.data.items())


def alike(text: str, other: str) -> bool:
    """Say whether texts differ in numbers alone, and in those by no more than their errors."""
    return NUMBER.sub("#", text) == NUMBER.sub("#", other) and all(
        abs(a - b) <= max(far, further)
        for (a, far), (b, further) in zip(numbers(text), numbers(other), strict=True)
    )


def numbers(text: str) -> Iterator[tuple[Decimal, Decimal]]:
    """Yield each number and how far it may be off: its error, or a unit of its last decimal place.

    A whole number is exact.
    """
    for token in NUMBER.findall(text):
        number, _, error = token.replace(",", "").partition(" ± ")
        value = Decimal(number)
        exact = not set(".e") & set(number)
        unit = Decimal(0) if exact else Decimal(1).scaleb(int(value.as_tuple().exponent))
        yield value, Decimal(error) if error else unit


if __name__ == "__main__":
    for path in NOTEBOOKS:
        if package := missing(path):
            print(f"{path.name}: left as it is, since the package {package} is not installed")
        else:
            path.write_text(text_of(executed(path)), "utf-8")
