"""Errors of the checker's own floats, and pairs that they decide."""

import ast
from fractions import Fraction as F
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from strategies import Rows, exact_gains, exact_values, model_of, models

from exact_mdp import certify
from exact_mdp.solvers.proof.margins import gains, undecided

PROOF = Path(__file__).parents[3] / "exact_mdp" / "solvers" / "proof"
MARGINS = "exact_mdp.solvers.proof.margins"
ENDLESS = "exact_mdp.solvers.proof.endless"
EQUATIONS = "exact_mdp.solvers.proof.equations"
LOSSES = "exact_mdp.solvers.proof.losses"


@settings(max_examples=60, deadline=None)
@given(models(), st.booleans())
def test_pairs_that_floats_decide_are_left_out(rows: Rows, floats: bool) -> None:
    """The maker finds the same with and without them; the checker skips none that it needs."""
    mdp = rows.model(floats=floats)
    wanted = certify(mdp)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("exact_mdp.solvers.proof.certify.MANY", 0)
        found = certify(mdp)
    assert found.violations() == []
    assert list(found.value) == list(wanted.value)
    assert list(found.gaps) == list(wanted.gaps)
    assert found.optimal_pairs.tolist() == wanted.optimal_pairs.tolist()
    kept, losses = set(undecided(mdp, found).tolist()), exact_gains(mdp, list(found.value))
    assert set(mdp.pair_state[list(kept)].tolist()) == set(range(mdp.n_states))
    for pair, state in enumerate(mdp.pair_state.tolist()):
        if pair not in kept:
            assert -losses[pair] > found.gaps[state]


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
        patch.setattr("exact_mdp.solvers.proof.certify.MANY", 0)
        found = certify(mdp)
    assert found.violations() == []
    assert set(found.value) == {F(10, 3)}
    assert set(found.gaps) == {gap or 1}
    assert set(undecided(mdp, found)) <= {5 * s + a for s in range(size) for a in range(4)}


@settings(max_examples=100, deadline=None)
@given(models())
def test_rounding_errors_are_bounded(rows: Rows) -> None:
    """The checker's own arithmetic, against rational arithmetic, for rough values."""
    for floats in (False, True):
        mdp = rows.model(floats=floats)
        value = np.where(
            mdp.terminal, 0, np.sin(np.arange(mdp.n_states)) * 10.0 ** (3 * rows.n_states)
        )
        exact = exact_values(value)
        for earning in (True, False):
            gain, error = gains(mdp, value, earning=earning)
            for pair in range(mdp.n_pairs):
                truth = -exact[mdp.pair_state[pair]]
                for p, t, r in mdp.table.row(pair):
                    truth += p * (r * earning + mdp.discount_exact * exact[t])
                assert abs(truth - F(float(gain[pair]))) <= F(float(error[pair]))


@pytest.mark.parametrize(
    "part, borrows",
    [
        ("checker", {MARGINS, ENDLESS, EQUATIONS}),
        ("equations", {MARGINS, LOSSES}),
        ("losses", set()),
        ("margins", set()),
        ("endless", set()),
    ],
)
def test_the_checker_can_be_read_in_one_sitting_and_imports_no_solver(
    part: str, borrows: set[str]
) -> None:
    text = (PROOF / f"{part}.py").read_text("utf-8")
    assert len(text.splitlines()) <= 350
    tree = ast.parse(text)
    typing = [
        statement
        for node in tree.body
        if isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"
        for statement in node.body
    ]
    imported = [
        str(node.module if isinstance(node, ast.ImportFrom) else node.names[0].name)
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom) and node not in typing
    ]
    assert {module for module in imported if "solvers" in module} == borrows
    assert "flint" not in text
