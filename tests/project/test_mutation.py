"""Each numeric module has a test file beside it, and what no test notices of it has a reason."""

import ast
import tomllib
from collections.abc import Iterator

import pytest
from changes import DEFINITIONS, changes
from mutants import LIST, PACKAGE, beside

NUMERIC = ["solvers", "analysis/vary", "analysis/gate", "mdp/questions", "mdp/forms/rows.py"]


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
    assert beside(PACKAGE / module).is_file()


FOUND = tomllib.loads(LIST.read_text("utf-8"))
SAME = "the same"


def names_in(parent: ast.AST, *inside: str) -> Iterator[str]:
    """Yield the names of all functions and classes, with those around them."""
    for node in ast.iter_child_nodes(parent):
        names = (*inside, node.name) if isinstance(node, DEFINITIONS) else inside
        yield ".".join(names)
        yield from names_in(node, *names)


@pytest.mark.parametrize("module", FOUND)
def test_few_changes_are_left_and_each_has_a_reason(module: str) -> None:
    """The file beside notices 85 % of all changes, and tests 95 % of those that make a difference.

    A change makes none if its reason begins with "the same", and is then left out of the second
    share. All other changes that no test notices count as missed.
    """
    path, found = PACKAGE / module, FOUND[module]
    assert path.is_file()
    assert beside(path).is_file()
    left, noticed = found["left"], found["beside"] + found["room"]
    assert {where for where, *_ in left} <= {"", *names_in(ast.parse(path.read_text("utf-8")))}
    assert [each for each in left if not each[3]] == []
    same = sum(each[3].startswith(SAME) for each in left)
    assert noticed + len(left) <= found["changes"]
    assert found["beside"] >= 0.85 * found["changes"]
    assert noticed >= 0.95 * (found["changes"] - same)


SOURCE = """
LIMIT = 3
def share(row: list[int], at: int, scale: float = 2.0) -> float:
    if not row:
        raise ValueError(f"{1 + 1}")
    return sum(row[at], round(-scale, ndigits=1)) / max(1, len(row)) if at < LIMIT else True
"""
CHANGES = {
    ("", "3", "4"),
    ("share", "2.0", "3.0"),
    ("share", "not row", "row"),
    ("share", "at < LIMIT", "at <= LIMIT"),
    ("share", "sum(row[at], round(-scale, ndigits=1)) / max(1, len(row))",
     "sum(row[at], round(-scale, ndigits=1)) * max(1, len(row))"),
    ("share", "sum(row[at], round(-scale, ndigits=1))", "sum(round(-scale, ndigits=1), row[at])"),
    ("share", "row[at]", "row[at - 1]"),
    ("share", "round(-scale, ndigits=1)", "round(-scale)"),
    ("share", "-scale", "scale"),
    ("share", "1", "2"),
    ("share", "True", "False"),
}  # fmt: skip


def test_each_change_is_made_alone_and_taken_back() -> None:
    """Types and what is raised are left out; of a maximum the order does not count."""
    module = ast.parse(SOURCE)
    before, seen, texts = ast.unparse(module), set(), set()
    for change in changes(module):
        seen.add(change.key)
        texts.add(ast.unparse(module))
        compile(module, "share.py", "exec")
    assert seen == CHANGES
    assert len(texts) == len(CHANGES) + 1  # "1 → 2" stands for two places
    assert before not in texts
    assert ast.unparse(module) == before
