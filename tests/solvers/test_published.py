"""Published answers: optima by every solver, values of policies, questions, averages and mazes."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction as F
from math import isinf
from typing import Any

import numpy as np
import pytest
from answers import SWEEPING, holds, near, quietly, within
from cases import BY_NAME, CASES, Case
from cases.prism_rewards import MODELS, PUBLISHED, Asked
from made_models import forest
from model_contents import is_acyclic
from oracle import every_policy_ends
from strategies import of_case

from exact_mdp import (
    MDP,
    SOLVERS,
    ModelError,
    SolverError,
    Status,
    certify,
    check,
    evaluate,
    solve,
)

HARD = [case for case in CASES if case.name.startswith("reset-chain")]
# Sweeps alone would take their million on chains that mix slowly: these may stop before the end.
QUICK: dict[str, Any] = {
    name: kind(max_iterations=6_000) if name in SWEEPING else name for name, kind in SOLVERS.items()
}


def published(case: Case, numbers: Any, value: Any, error: Any) -> None:
    """Numbers were published exactly, or to few digits."""
    states = list(numbers)
    digits = [0 if isinstance(x, F) else case.tolerance for x in numbers.values()]
    room = [F(float(error[s])) + F(more) for s, more in zip(states, digits, strict=True)]
    near([value[s] for s in states], room, [F(x) for x in numbers.values()])


@pytest.mark.parametrize("name", SOLVERS)
@pytest.mark.parametrize("case", CASES, ids=str)
def test_optima(case: Case, name: str) -> None:
    mdp = of_case(case)
    try:
        solution = quietly(solve, mdp, QUICK[name])
    except ModelError:
        if (name == "backward-induction" and not is_acyclic(mdp)) or not case.proper:
            return
        raise
    except SolverError as error:
        if case not in HARD:
            raise
        if error.solution is None:
            return
        solution = error.solution
    published(case, case.values, solution.value, solution.state_error)
    if solution.status is Status.ITERATION_LIMIT:
        return
    size = max(1.0, float(np.abs(solution.value).max()))
    assert solution.error_bound <= (1e-8 if case in HARD else 1e-9) * size
    for state, actions in case.optimal.items():
        assert solution.policy[state] in actions
    assert solution.method == name


@pytest.mark.parametrize("case", CASES, ids=str)
def test_optima_are_proven(case: Case) -> None:
    mdp = of_case(case)
    optimum = certify(mdp)
    assert case.source
    assert case.values
    assert optimum.violations() == []
    published(case, case.values, optimum.value, [0.0] * case.n_states)
    assert case.proper == (case.discount < 1 or every_policy_ends(case.n_states, case.pairs))
    if not case.proper:
        with pytest.raises(ModelError, match="need every policy to end"):
            certify(mdp, bounded=True)
        return
    for state, actions in case.optimal.items():
        best = [a for a in mdp.pairs_of(state) if optimum.optimal_pairs[a]]
        assert {int(mdp.pair_action[a]) for a in best} == set(actions)
    for state, action in case.policy.items():
        assert optimum.optimal_pairs[mdp.pair(state, action)]
    try:
        bounds = certify(mdp, bounded=True)
    except SolverError:
        assert case in HARD
        return
    assert bounds.violations() == []
    holds(bounds, optimum.value)


@pytest.mark.parametrize("case", [c for c in CASES if c.wrong_policy or c.uniform_values], ids=str)
def test_policies(case: Case) -> None:
    mdp = of_case(case)
    if case.uniform_values:
        chances = evaluate(mdp, "random")
        published(case, case.uniform_values, chances.value, chances.error)
    if case.wrong_policy:
        wrong = evaluate(mdp, [case.wrong_policy[s] for s in range(case.n_states)])
        published(case, case.wrong_values, wrong.value, wrong.error)
        assert wrong.start.interval[1] < certify(mdp).start_value


@pytest.mark.parametrize(
    ("name", "value"), [("FrozenLake-v1", 14 / 17), ("CliffWalking-v1", -13), ("Taxi-v4", 7.93)]
)
def test_mazes_of_gymnasium(name: str, value: float) -> None:
    pytest.importorskip("gymnasium")
    mdp = MDP.from_gymnasium(name)
    proof = certify(mdp)
    assert float(proof.start_value) == pytest.approx(value, abs=1e-12)
    assert proof.violations() == []
    assert solve(mdp).start_value == pytest.approx(value, abs=1e-9)


# ---- questions -----------------------------------------------------------------------------------


def posed(case: Asked) -> MDP:
    """The model whose value is the answer: until a label, or the total of one component."""
    mdp = MODELS[case.model].with_(sense=case.sense)
    if case.until is not None:
        return mdp.until(case.until, case.reward)
    top, bottom = mdp.component(case.reward)
    return mdp.with_(table=replace(mdp.table, gain=top, gain_denominator=bottom))


@pytest.mark.parametrize("case", PUBLISHED, ids=lambda c: f"{c.model}-{c.until}-{c.reward}")
def test_questions(case: Asked) -> None:
    """Exactly, and in floats; +∞ where a run may miss."""
    mdp = posed(case)
    proof, solution = certify(mdp), solve(mdp)
    assert proof.start_value == case.value
    assert proof.violations() == []
    assert solution.start.value == pytest.approx(float(case.value))
    if not isinf(case.value):
        assert within(solution.start, case.value)
        if np.isfinite(proof.value_float).all():
            assert check(mdp, solution).passed
        assert evaluate(mdp, solution).mean == pytest.approx(float(case.value))


# ---- averages ------------------------------------------------------------------------------------


def maintenance() -> MDP:
    """A machine wears out, from 1 to 4; broken (5), it is repaired in two days, the second one 6.

    A repair before costs 7, 7 and 5. The optimum waits in 1 to 3 and repairs in 4.
    """
    wear = [{0: "9/10", 1: "1/10"}, {1: "4/5", 2: "1/10", 3: "1/20", 4: "1/20"}]
    wear += [{2: "7/10", 3: "1/10", 4: "1/5"}, {3: "1/2", 4: "1/2"}]
    rows = [(s, 0, [(p, t, 0) for t, p in row.items()]) for s, row in enumerate(wear)]
    rows += [(s, 1, [(1, 0, cost)]) for s, cost in ((1, 7), (2, 7), (3, 5))]
    rows += [(4, 2, [(1, 5, 10)]), (5, 2, [(1, 0, 0)])]
    return MDP.from_outcomes(sorted(rows), sense="min")


CLASSES = MDP.from_arrays([[[1, 0, 0], [0, "2/5", "3/5"], [0, "7/10", "3/10"]]], [[2], [5], [4]])
# The gain of each state, its digits, and what was published of the policy.
AVERAGES: dict[str, tuple[MDP, list[Any], float, Any]] = {
    # pymdptoolbox src/tests/test_RelativeValueIteration.py: 3.24; 3.885235246, an iterate that
    # stopped before 35/9; 1.549681956
    "forest of 3": (of_case(BY_NAME["forest-3-9/10"]), [F(81, 25)] * 3, 0, None),
    "toolbox": (of_case(BY_NAME["toolbox-small-9/10"]), [F(35, 9)] * 2, 0, None),
    "forest of 10": (of_case(BY_NAME["forest-10-24/25"]), [F(4) * F(9, 10) ** 9] * 10, 0, None),
    # Puterman, example 9.1.1; msdm msdm/tests/domains/__init__.py
    "multichain": (of_case(BY_NAME["puterman-multichain-1/2"]), [F(3), F(2), F(2)], 0, None),
    # Puterman, sections 3.1 and 8.2: leaving a state of gain 5 - ... ends at -1 for ever
    "two states": (of_case(BY_NAME["puterman-two-state-1/2"]), [F(-1), F(-1)], 0, None),
    # Howard (1960), chapter 4: 13.34 a trip, at the stand in every town
    "taxicab": (of_case(BY_NAME["howard-taxicab"]), [13.34454] * 3, 5e-6, [1, 1, 1]),
    # Tijms, A First Course in Stochastic Models (2003), section 6.4, p. 251: the least costs
    "maintenance": (maintenance(), [0.4338] * 6, 5e-5, [0, 0, 0, 1, 2, 2]),
    # Puterman, example 8.2.2, pages 345 and 346: 4.538 in its recurrent states
    "two classes": (CLASSES, [F(2), F(59, 13), F(59, 13)], 0, None),
}
BIASES = {
    "maintenance": ([0.4338, 4.7717, 6.5982, 5, 9.5662, 0], 5e-5),  # less that of 6
    "two classes": ([0, F(60, 169), F(-70, 169)], 0),  # 0.354 and -0.416 from 4.538
}


@pytest.mark.parametrize("name", AVERAGES)
def test_averages(name: str) -> None:
    mdp, gain, digits, policy = AVERAGES[name]
    optimum, solution = certify(mdp, criterion="average"), solve(mdp, criterion="average")
    assert optimum.violations() == []
    assert max(abs(x - y) for x, y in zip(optimum.value, gain, strict=True)) <= digits
    assert policy in (None, optimum.policy.tolist())
    if name in BIASES:
        right, digits = BIASES[name]
        bias = [h - (digits > 0) * optimum.bias[-1] for h in optimum.bias]
        assert max(abs(x - y) for x, y in zip(bias, right, strict=True)) <= digits
    holds(solution, optimum.value)


def test_the_random_policy_of_the_forest() -> None:
    evaluation = evaluate(forest("9/10"), "random", criterion="average")
    assert within(evaluation.start, F(117, 160))
    assert evaluation.read_as == "policy"
    assert evaluation.frame().columns[:3].tolist() == ["state", "gain", "gain error"]
    best = evaluate(forest("9/10"), "optimal", criterion="average")
    assert best.start_value == pytest.approx(3.24)
