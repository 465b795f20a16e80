"""Exact solving against the same algorithms over `fractions.Fraction`, in one run on the same data.

`make bench` prints the times; each test also asserts the least ratio that the exact solver is for.
"""

import random
from fractions import Fraction as F
from time import perf_counter
from typing import Any

import pytest
from cases.reference import solve_exact
from strategies import model_of

from exact_mdp.mdp import MDP, Scenario
from exact_mdp.mdp.exact import bellman_rows
from exact_mdp.solvers import certify
from exact_mdp.solvers.proof.exact import solve_exactly

pytestmark = pytest.mark.bench


def backward_induction(mdp: MDP) -> list[F]:
    """V by fractions, states in falling order: the care model's transitions lead upward."""
    value = [F(0)] * mdp.n_states
    rows = [mdp.table.row(pair) for pair in range(mdp.n_pairs)]
    for s in range(mdp.n_states - 2, -1, -1):
        value[s] = max(
            sum((p * (r + value[t]) for p, t, r in rows[pair]), F(0)) for pair in mdp.pairs_of(s)
        )
    return value


def seconds(function: Any, *arguments: Any) -> tuple[float, Any]:
    started = perf_counter()
    result = function(*arguments)
    return perf_counter() - started, result


@pytest.mark.parametrize("subtasks, least", [(3, 5), (30, 20)])
def test_backward_induction(benchmark: Any, subtasks: int, least: float) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[subtasks]).compile()
    certify(mdp)  # what is imported when first needed
    slow, value = seconds(backward_induction, mdp)
    found = benchmark.pedantic(solve_exactly, (bellman_rows(mdp),), rounds=3)
    fast = min(seconds(lambda: solve_exactly(bellman_rows(mdp)))[0] for _ in range(3))
    below = [found.denominator[group] for group in found.group]
    assert [F(a, b) for a, b in zip(found.numerator, below, strict=True)] == value
    benchmark.extra_info["times as fast as fractions"] = round(slow / fast, 1)
    assert slow / fast > least


@pytest.mark.parametrize("states, least", [(30, 5), (100, 50)])
def test_policy_iteration(benchmark: Any, states: int, least: float) -> None:
    draw, rows = random.Random(1), []
    for s in range(states):
        for a in range(3):
            weights = {draw.randrange(states): draw.randrange(1, 50) for _ in range(4)}
            total = sum(weights.values())
            shares = {t: F(weight, total) for t, weight in weights.items()}
            rows.append((s, a, F(draw.randrange(-50, 50), 7), shares))
    mdp = model_of(states, rows, F(99, 100))
    certify(mdp)
    slow, (value, _) = seconds(solve_exact, states, rows, F(99, 100))
    found = benchmark.pedantic(solve_exactly, (bellman_rows(mdp),), rounds=3)
    fast = min(seconds(lambda: solve_exactly(bellman_rows(mdp)))[0] for _ in range(3))
    below = [found.denominator[group] for group in found.group]
    assert [F(a, b) for a, b in zip(found.numerator, below, strict=True)] == value
    benchmark.extra_info["times as fast as fractions"] = round(slow / fast, 1)
    assert slow / fast > least


@pytest.mark.parametrize("subtasks", [3, 30, 100])
def test_certify(benchmark: Any, subtasks: int) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[subtasks]).compile()
    certify(mdp)
    assert benchmark.pedantic(certify, (mdp,), rounds=3).unique


@pytest.mark.parametrize("subtasks", [3, 30, 100])
def test_check(benchmark: Any, subtasks: int) -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[subtasks]).compile()
    assert benchmark.pedantic(certify(mdp).violations, rounds=3) == []
