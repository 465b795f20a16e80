"""Each numeric module has a test file beside it: the same path in tests/inner."""

from pathlib import Path

import pytest

import exact_mdp

PACKAGE = Path(exact_mdp.__file__).parent
INNER = Path(__file__).resolve().parents[1] / "inner"
NUMERIC = ["solvers", "analysis/vary", "analysis/gate", "mdp/questions.py", "mdp/forms/rows.py"]


def numeric_modules() -> list[str]:
    """Return the numeric modules that have functions."""
    files = [file for place in NUMERIC for file in sorted((PACKAGE / place).rglob("*.py"))]
    files += [PACKAGE / place for place in NUMERIC if place.endswith(".py")]
    return [
        file.relative_to(PACKAGE).as_posix()
        for file in files
        if "def " in file.read_text("utf-8") and file.name != "__init__.py"
    ]


@pytest.mark.parametrize("module", numeric_modules())
def test_a_numeric_module_has_a_test_file_beside_it(module: str) -> None:
    path = Path(module)
    assert (INNER / path.parent / f"test_{path.stem}.py").is_file()
