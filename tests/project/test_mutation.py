"""Numeric modules have a test file beside them, and the list of changes that no test notices."""

import ast
import tomllib
from pathlib import Path
from typing import Any

import pytest
from changes import changes

import exact_mdp

PACKAGE = Path(exact_mdp.__file__).parent
TESTS = Path(__file__).resolve().parents[1]
NUMERIC = ["solvers", "analysis/vary", "analysis/gate", "mdp/questions.py", "mdp/forms/rows.py"]
MEASURED = ["solvers/exact", "solvers/bounds", "solvers/values", "analysis/gate", "analysis/vary"]
NO_NUMBERS = {"solvers/__init__.py"}
LIST: dict[str, dict[str, Any]] = tomllib.loads(
    (TESTS / "mutation" / "left.toml").read_text("utf-8")
)


def modules(places: list[str]) -> list[str]:
    """Return the modules of some folders that have functions."""
    files = [file for place in places for file in sorted((PACKAGE / place).rglob("*.py"))]
    files += [PACKAGE / place for place in places if place.endswith(".py")]
    return [file.relative_to(PACKAGE).as_posix() for file in files
            if "def " in file.read_text("utf-8") and file.name != "__init__.py"]  # fmt: skip


@pytest.mark.parametrize("module", modules(NUMERIC))
def test_a_numeric_module_has_a_test_file_beside_it(module: str) -> None:
    path = Path(module)
    assert (TESTS / "inner" / path.parent / f"test_{path.stem}.py").is_file()


def test_the_list_has_all_modules_that_are_measured() -> None:
    assert sorted(LIST) == sorted(modules(MEASURED))


@pytest.mark.parametrize("module", LIST)
def test_changes_are_noticed_beside_or_in_the_room_or_have_a_reason(module: str) -> None:
    """At least 85 % beside and 95 % in all, of the changes that change anything."""
    known, left = LIST[module], LIST[module]["left"]
    there = {each.key for each in changes(ast.parse((PACKAGE / module).read_text("utf-8")))}
    for function, before, after, why in left:
        assert (function, before, after) in there, f"{before} → {after} is no change any more"
        assert why
    assert known["changes"] == known["beside"] + known["room"] + len(left)
    assert known["beside"] >= 0.85 * known["changes"]
