"""Average rewards: evaluations within bounds, gains that are near, and what proofs tell apart.

That optima are right is a law, in `test_laws`; published ones are in `test_published`.
"""

from dataclasses import replace
from fractions import Fraction as F

import numpy as np
import pytest
from answers import holds, near, within
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import gain_and_bias, mixed
from strategies import Rows, models

from exact_mdp import MDP, PrecisionWarning, SolverError, ValueIteration, certify, evaluate, solve


@given(models(discounts=[F(1, 2)]), st.data())
@settings(max_examples=60)
def test_evaluations_are_within_their_bounds(rows: Rows, data: st.DataObject) -> None:
    """Gain, bias and share of time of a mixed policy; a share is a gain, of the reward 1 there."""
    mdp, chances = rows.model().with_(start=rows.n_states - 1), {}
    shares = np.full((mdp.n_states, mdp.n_actions), F(0))
    for s in range(rows.n_states):
        actions = [a for t, a, *_ in rows.pairs if t == s]
        weights = data.draw(st.tuples(*[st.integers(0, 3)] * len(actions)))
        weights = weights if any(weights) else [1] * len(actions)
        chances |= {(s, a): F(w, sum(weights)) for a, w in zip(actions, weights, strict=True)}
    for key, share in chances.items():
        shares[key] = share
    evaluation = evaluate(mdp, shares, kind="policy", criterion="average")
    chain = mixed(rows.pairs, chances)
    gain, bias = gain_and_bias(chain)
    holds(evaluation, gain)
    near(evaluation.bias, evaluation.bias_error, bias)
    times = [
        gain_and_bias([(s, a, F(s == t), p) for s, a, _, p in chain])[0][-1]
        for t in range(rows.n_states)
    ]
    near(evaluation.share.value, evaluation.share.error, times)
    assert within(evaluation.components["reward"], gain[-1])


@pytest.mark.parametrize("seed", range(6))
def test_gains_that_are_equal_but_for_rounding_do_not_hide_what_is_better(seed: int) -> None:
    """Rings of sevenths with ends: states whose equal gains come of unlike equations."""
    rng, rows = np.random.default_rng(seed), []
    for s in range(30):
        for a in range(1 + s % 3):
            each = zip(rng.integers(-2, 4, 3).tolist(), (1, 2, 4), strict=True)
            ahead = {(s + d) % 30: w for d, w in each}
            total, reward = sum(ahead.values()), F(int(rng.integers(-4, 5)), 10)
            rows.append((s, a, [(F(w, total), t, reward) for t, w in ahead.items()]))
    ends = set(rng.integers(0, 30, 2).tolist())
    rows = [row for row in rows if row[0] not in ends] + [(s, 0, [(1, s, 0)]) for s in ends]
    mdp = MDP.from_outcomes(rows)
    solution = solve(mdp, criterion="average")
    holds(solution, certify(mdp, criterion="average").value)
    assert solution.error_bound < 1e-9


def test_a_reset_chain_of_low_gain_is_solved() -> None:
    """41 states in a row, up with 1/2 and back with 1/2; 1 at the top: 2^-40 and less."""
    chances = [(s, min(s + 1, 40), int(s == 40)) for s in range(41)]
    mdp = MDP.from_outcomes([(s, 0, [("1/2", t, r), ("1/2", 0, r)]) for s, t, r in chances])
    exact = certify(mdp, criterion="average").start_value
    assert exact == F(1, 2**40)
    solution = solve(mdp, criterion="average")
    assert within(solution.start, exact)
    assert solution.start.error <= 1e-14


def test_rows_of_floats_mean_what_was_written() -> None:
    wait, cut = [[0.1, 0.9, 0], [0.1, 0, 0.9], [0.1, 0, 0.9]], [[1, 0, 0]] * 3
    mdp = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], 0.5)
    assert certify(mdp, criterion="average").value[0] == 4 * F(9, 10) ** 2
    step = mdp.undiscounted
    assert step.undiscounted is step
    assert (step.discount, step.floats) == (1, True)


@pytest.mark.parametrize("digits", [300, 325])
def test_shares_below_the_range_of_floats(digits: int) -> None:
    rare, most = F(1, 10**digits), F(10) ** 300
    mdp = MDP.from_outcomes([(0, 0, [(1 - rare, 0, 0), (rare, 1, 0)]), (1, 0, [(1, 0, most)])])
    evaluation = evaluate(mdp, [0, 0], criterion="average")
    exact = most * rare / (1 + rare)
    for number in (evaluation.components["reward"], evaluation.start):
        assert abs(F(number.value) - exact) <= F(number.error)
    assert evaluation.start.value == pytest.approx(float(exact))


def test_settings() -> None:
    mdp = forest("9/10")
    policy = evaluate(mdp, "random", criterion="average").policy
    assert policy is not None
    assert policy.weights(mdp).tolist() == [0.5] * 6
    with pytest.warns(PrecisionWarning):
        assert solve(mdp, tol=1e-300, criterion="average").error_bound < 1e-12
    with pytest.raises(SolverError, match="after 3 iterations"):
        solve(mdp, ValueIteration(max_iterations=3), criterion="average")
    solution = solve(mdp, criterion="average")
    assert repr(solution).startswith("AverageSolution(policy-iteration: start value 3.24")
    assert solution.q[solution.pairs] == pytest.approx(solution.bias)


@pytest.mark.parametrize(
    ("away", "back", "level", "bias", "less"),
    [
        # Both ways to the end earn its gain; one of them earns 5 on the way.
        ((1, 1, 5), (1, 1, 1), "h", [4, 0], [-1, 0]),
        # To stay is worth 0; to go and come back earns 1 and costs 1 in turn, but the 1 first.
        ((1, 1, 1), (1, 0, -1), "w", [F(1, 2), F(-1, 2)], [0, -1]),
    ],
)
def test_a_policy_of_less_bias_is_found(away, back, level: str, bias: list, less: list) -> None:
    first = (1, 1, 0) if level == "h" else (1, 0, 0)
    mdp = MDP.from_outcomes([(0, 0, [first]), (0, 1, [away]), (1, 0, [back])])
    good = certify(mdp, criterion="average")
    worse = certify(mdp.with_(table=mdp.table.of_pairs(np.array([0, 0, 2]))), criterion="average")
    assert good.violations() == worse.violations() == []
    assert (good.bias.tolist(), worse.bias.tolist()) == (bias, less)
    said = f"state 0, action 1: its {level} is more than is claimed"
    assert replace(worse, model=good.model, mdp=mdp).violations()[0] == said
    if level == "h":
        assert good.losses[1].tolist() == [5, 0, 0]
