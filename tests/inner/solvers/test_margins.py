"""Pairs that floats leave out before exact solving, and that the checker stands alone."""

import ast
import sys
from fractions import Fraction as F
from pathlib import Path

import pytest
from hypothesis import given, settings
from strategies import Rows, model_of, models

from exact_mdp import certify
from exact_mdp.solvers.exact import checker


@settings(max_examples=60, deadline=None)
@given(models())
def test_pairs_that_floats_decide_are_left_out(rows: Rows) -> None:
    """The same is found with and without them."""
    mdp = rows.model(floats=False)
    wanted = certify(mdp)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exact_mdp.solvers.exact.certify.MANY", 0)
        found = certify(mdp)
    assert found.violations() == []
    assert list(found.value) == list(wanted.value)
    assert found.unique == wanted.unique
    assert found.policy.tolist() == wanted.policy.tolist()


@pytest.mark.parametrize("gap", [F(0), F(1, 10**15), F(1, 10**16), F(1, 10**40)])
def test_near_ties_are_decided_exactly(gap: F) -> None:
    """Three actions nearly alike, and two that are far off, in many states."""
    size = 60
    moves = [{(s + k) % size: F(1, 3) for k in (1, 2, 5)} for s in range(size)]
    rows = [
        (s, a, F(1, 3) - worse * gap - off, moves[s])
        for s in range(size)
        for a, (worse, off) in enumerate([(0, 0), (1, 0), (2, 0), (0, 1), (0, 2)])
    ]
    mdp = model_of(size, rows, F(9, 10))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exact_mdp.solvers.exact.certify.MANY", 0)
        found = certify(mdp)
    assert found.violations() == []
    assert set(found.value) == {F(10, 3)}
    assert set(found.gaps) == {gap or 1}


def test_the_checker_can_be_read_in_one_sitting_and_imports_nothing() -> None:
    text = Path(checker.__file__).read_text("utf-8")
    tree = ast.parse(text)
    imported = {
        str(node.module if isinstance(node, ast.ImportFrom) else node.names[0].name)
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
    }
    assert {name.partition(".")[0] for name in imported} <= sys.stdlib_module_names
    assert len(text.splitlines()) <= 350
