"""What a model tells can be given back, and errors about numbers speak of the right ones."""

from __future__ import annotations

from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
import scipy.sparse as sp
from mixed_numbers import again, rows_of

from exact_mdp.analysis import check
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.care.perception import independent
from exact_mdp.mdp.care.process import Process
from exact_mdp.mdp.io.npz import load, save
from exact_mdp.solvers import ValueIteration, certify, evaluate, solve
from exact_mdp.solvers.pomdp.pomdp import solve_beliefs
from exact_mdp.solvers.robust.robust import solve_robust
from exact_mdp.solvers.robust.sets import Intervals
from exact_mdp.solvers.values.policy_chain import PolicyChain
from exact_mdp.solvers.values.returns import return_distribution


def dense(seed: int) -> MDP:
    rng = np.random.default_rng(seed)
    rows = rng.random((2, 6, 6))
    rows /= rows.sum(axis=2, keepdims=True)
    rewards = rng.normal(size=(6, 2) if seed % 2 else (2, 6, 6))
    return MDP.from_arrays(rows, rewards, 0.9, start={0: 0.5, 3: 0.5})


MODELS: dict[str, MDP] = {
    **{f"floats {seed}": dense(seed) for seed in range(6)},
    "a tenth, ten times": MDP.from_arrays([np.full((10, 10), 0.1)], np.arange(1.0, 11), 0.9),
    "mixed": MDP.from_arrays(
        [[["1/3", 0.6666666666666666, 0], [0.1, 0.2, 0.7], ["1/7", 0.5, "5/14"]]],
        [[0.1], ["1/7"], [-3]],
        "9/10",
    ),
    "added": MDP.from_outcomes(
        [
            (0, 0, [(0.1, 1, 0.5), (0.2, 1, 0.5), (0.7, 0, F(1, 3))]),
            (1, 0, [("1/3", 0, 1), (0.6666666666666666, 0, 1)]),
        ],
        0.9,
    ),
    "nearly certain": MDP.from_outcomes(
        [(0, 0, [(1 - 2.0**-40, 1, 1)]), (1, 0, [(1.0, 0, 2)])], 0.9
    ),
    "exact": Scenario.load("yuan2025").with_(tasks=[1], max_trial=2).compile(),
}


@pytest.mark.parametrize("name", MODELS)
def test_rows_given_back_are_the_same_model(name: str, tmp_path: Any) -> None:
    """Read every row, build again, by any road: the same fractions, the same roundings."""
    mdp = MODELS[name]
    wanted = certify(mdp)
    save(mdp, tmp_path / "m.npz")
    for other in (again(mdp), again(again(mdp)), load(tmp_path / "m.npz")):
        found = certify(other)
        assert list(found.value) == list(wanted.value)
        assert list(found.gaps) == list(wanted.gaps)
        assert found.start_value == wanted.start_value
        assert found.model == wanted.model
        assert other.table.weight.dtype == mdp.table.weight.dtype
        assert other.table.weight_rounding().tolist() == mdp.table.weight_rounding().tolist()


@pytest.mark.parametrize("name", [name for name in MODELS if name != "mixed"])
def test_plain_fractions_of_a_row_are_taken_too(name: str) -> None:
    """What is left of a row that another program read: fractions that know of nothing else."""
    mdp = MODELS[name]
    rows = [(s, a, [(F(p), t, r) for p, t, r in row]) for s, a, row in rows_of(mdp)]
    if name == "added":  # 1/3 beside a float, which alone tells why they do not sum to 1
        rows[1] = rows_of(mdp)[1]
    other = MDP.from_outcomes(rows, mdp.discount_exact, start=dict(mdp.start), actions=mdp.actions)
    assert list(certify(other).value) == list(certify(mdp).value)


def test_a_sign_can_be_flipped_a_target_frozen_and_time_unrolled() -> None:
    """Models made of the rows of a float model, whose probabilities do not sum to 1."""
    mdp = dense(1)
    rows, rate = rows_of(mdp), mdp.discount_exact
    costs = MDP.from_outcomes([(s, a, [(p, t, -r) for p, t, r in row]) for s, a, row in rows], rate)
    negative = certify(again(costs))
    assert rows_of(costs) == [(s, a, [(p, t, -r) for p, t, r in row]) for s, a, row in rows]
    assert costs.table.gain_rounding().tolist() == mdp.table.gain_rounding().tolist()
    assert list(negative.value) == list(certify(costs).value)
    frozen = MDP.from_outcomes([(s, a, [(1, s, 0)] if s == 2 else row) for s, a, row in rows], rate)
    value = certify(frozen).value
    assert value[2] == 0
    reward = mdp.table.row(0)[0][2]
    backup = [
        F(mdp.table.row(pair)[0][2]) + rate * sum(p * value[t] for p, t, _ in mdp.table.row(pair))
        for pair in mdp.pairs_of(0)
    ]
    assert reward in {r for _, _, r in frozen.table.row(0)}
    assert value[0] == max(backup)
    size, steps = mdp.n_states, 3
    unrolled = [
        (k * size + s, a, [(p, (k + 1) * size + t, r) for p, t, r in row])
        for k in range(steps)
        for s, a, row in rows
    ]
    unrolled += [(steps * size + s, 0, [(1, steps * size + s, 0)]) for s in range(size)]
    found = certify(MDP.from_outcomes(unrolled, rate)).value
    later = [F(0)] * size
    for _ in range(steps):
        later = [
            max(
                F(mdp.table.row(pair)[0][2])
                + rate * sum(p * later[t] for p, t, _ in mdp.table.row(pair))
                for pair in mdp.pairs_of(s)
            )
            for s in range(size)
        ]
    assert list(found[:size]) == later


def test_rows_that_are_mixed_and_miss_1_have_bounds_that_hold() -> None:
    """Solvers and bounds count what a row of integers misses, as they do for rows of floats."""
    off = 2.0**-31
    for excess in (off, -off):
        last = 2 / 3 + excess
        mdp = MDP.from_outcomes(
            [(0, 0, [("1/3", 0, 5), (last, 1, "1/7")]), (1, 0, [("1/3", 0, 1), (last, 1, -2)])],
            "99/100",
        )
        assert mdp.table.weight.dtype != np.float64
        value = list(certify(mdp).value)
        bounded = certify(mdp, bounded=True)
        assert bounded.violations() == []
        solution = solve(mdp)
        kept = evaluate(mdp, solution.policy)
        for s in range(2):
            assert F(bounded.lower[s]) <= value[s] <= F(bounded.upper[s])
            assert abs(F(solution.value[s]) - value[s]) <= F(solution.error_bound)
            assert abs(F(kept.value[s]) - value[s]) <= F(kept.error[s])


def test_a_sparse_array_of_pair_rewards_works() -> None:
    """Sparse rewards of shape (S, A) are those of the dense array."""
    rewards = np.array([[0.0, 1.5], [2.0, 0.0], [0.0, -1.0]])
    P = [np.eye(3), np.eye(3)[[1, 2, 0]]]
    for form in (sp.csr_array, sp.csc_matrix, sp.coo_array, sp.lil_matrix):
        mdp = MDP.from_arrays(P, form(rewards), 0.5)
        assert mdp.reward.tolist() == rewards.reshape(-1).tolist()
        assert MDP.from_arrays(P, form(rewards.astype(int)), 0.5).table.gain.dtype == np.int64


def damaged(place: int) -> sp.csr_array:
    matrix = sp.csr_array(np.eye(2))
    matrix.indices[1] = place
    return matrix


EYE = sp.csr_array(np.eye(2))
REFUSED: dict[str, tuple[Any, Any, str, str]] = {
    "three dimensions": (sp.coo_array(np.stack([np.eye(2)] * 2)), [0, 0], "P", "(2, 2, 2)"),
    "index of P": ([damaged(5)], [0, 0], "P", "column 5"),
    "negative index of P": ([damaged(-1)], [0, 0], "P", "column -1"),
    "index of R": ([EYE, EYE], [EYE, damaged(7)], "R", "column 7"),
    "shapes of R": ([EYE, EYE], [EYE, sp.eye_array(3)], "R", "matrices of rewards"),
    "size of R": ([EYE, EYE], [sp.eye_array(3)] * 2, "R", "rewards have shape (2, 3, 3)"),
    "kinds of R": ([EYE, EYE], [EYE, np.eye(2)], "R", "R mixes sparse and dense"),
    "words in R": ([EYE], ["a", "b"], "R", "not a finite rational"),
    "complex R": ([EYE], sp.csr_array(np.eye(2) * 1j), "R", "complex"),
    "shape of sparse R": ([EYE], sp.csr_array(np.ones((3, 1))), "R", "rewards have shape (3, 1)"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_errors_name_the_array_that_is_wrong(name: str) -> None:
    """No error of SciPy, and none about R that speaks of P."""
    P, R, where, what = REFUSED[name]
    with pytest.raises(ModelError) as caught:
        MDP.from_arrays(P, R, 0.5)
    assert caught.value.where == where
    assert what in caught.value.what
    assert caught.value.fix


PROCESS = Process.of(MODELS["exact"], independent([0.9] * 4, [0.8] * 4))


def test_true_is_no_number_of_iterations() -> None:
    """Counts are whole numbers; True does not count as 1, nor does 1.0."""
    mdp = MDP.from_arrays([[["1/2", "1/2"], [0, 1]]], [1, 0])
    calls: list[Any] = [
        lambda count: ValueIteration(max_iterations=count),
        lambda count: return_distribution(mdp, "optimal", max_sweeps=count),
        lambda count: solve_beliefs(PROCESS, max_trials=count),
        lambda count: solve_robust(mdp, Intervals.relative(mdp, 0.2), max_iterations=count),
    ]
    for call in calls:
        for count in (True, 0, 1.5):
            with pytest.raises(ModelError, match=f"is {count}"):
                call(count)


def test_float_action_numbers_are_called_what_they_are() -> None:
    """[0.0, 1.0] for a policy: action numbers are whole."""
    mdp = MDP.from_arrays([np.eye(2)] * 2, np.eye(2), 0.9)
    with pytest.raises(ModelError) as caught:
        evaluate(mdp, np.array([0.0, 1.0]))
    assert "action numbers are whole numbers" in caught.value.what
    assert "astype(int)" in caught.value.fix


def test_a_policy_of_single_outcomes_earns_what_the_outcomes_earn() -> None:
    """Rewards of outcomes stay those of outcomes where a policy's rows have one outcome each."""
    near = 1 - 2.0**-40
    first, second = (0, 0, [(near, 1, 3.0)]), (0, 1, [(0.5, 1, 3.0), (0.5, 0, 1.0)])
    end = (1, 0, [(1.0, 1, 0)])
    mdp = MDP.from_outcomes([first, second, end], discount="1/2")
    top, bottom = PolicyChain.of(mdp, np.array([0, 0])).table.expected_gain_exact()
    assert F(int(top[0]), int(bottom[0])) == 3 * F(near)
    assert check(mdp, [0, 0], exact_values=True).regret.learned.value == 3 * F(near)
