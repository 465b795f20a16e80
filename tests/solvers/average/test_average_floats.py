"""Average rewards in floats: bounds that hold, three methods, evaluations of any policy."""

from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import gain_and_bias, mixed
from strategies import Rows, models

from exact_mdp import MDP, PrecisionWarning, SolverError, ValueIteration, certify, evaluate, solve

SMALL = models(discounts=[F(1, 2)])


def off(floats: np.ndarray, exact: object) -> np.ndarray:
    """How far floats are from exact numbers, rounded up."""
    return np.array([float(abs(F(x) - y)) for x, y in zip(floats.tolist(), exact, strict=True)])  # type: ignore[call-overload]


@given(SMALL, st.data())
@settings(max_examples=60)
def test_evaluations_are_within_their_bounds(rows: Rows, data: st.DataObject) -> None:
    """Gain, bias and share of time of a mixed policy; a share is a gain, of the reward 1 there."""
    mdp, chances = rows.model().with_(start=rows.n_states - 1), {}
    for s in range(rows.n_states):
        actions = [a for t, a, *_ in rows.pairs if t == s]
        weights = data.draw(st.tuples(*[st.integers(0, 3)] * len(actions)))
        weights = weights if any(weights) else [1] * len(actions)
        chances |= {(s, a): F(w, sum(weights)) for a, w in zip(actions, weights, strict=True)}
    given_as = np.array([float(chances[key]) for key in sorted(row[:2] for row in rows.pairs)])
    evaluation = evaluate(mdp, given_as, criterion="average")
    chain = mixed(rows.pairs, chances)
    # what a float cannot say exactly moves the numbers by little more
    gain, bias = gain_and_bias(chain)
    drawn = (evaluation.weights != np.rint(evaluation.weights)).any()
    slack = 1e-9 * (1 + float(max(map(abs, bias)))) * drawn
    assert (off(evaluation.value, gain) <= evaluation.error + slack).all()
    assert (off(evaluation.bias, bias) <= evaluation.bias_error + 1e3 * slack).all()
    times = [
        gain_and_bias([(s, a, F(s == t), p) for s, a, _, p in chain])[0][-1]
        for t in range(rows.n_states)
    ]
    assert (off(evaluation.share.value, times) <= evaluation.share.error + slack).all()
    total = evaluation.components["reward"]
    assert abs(total.value - evaluation.start.value) <= total.error + evaluation.start.error


@pytest.mark.parametrize("seed", range(6))
def test_gains_that_are_equal_but_for_rounding_do_not_hide_what_is_better(seed: int) -> None:
    """Rings of sevenths with ends: states whose equal gains come of unlike equations."""
    rng, rows = np.random.default_rng(seed), []
    for s in range(30):
        for a in range(1 + s % 3):
            each = zip(rng.integers(-2, 4, 3).tolist(), (1, 2, 4), strict=True)
            near = {(s + d) % 30: w for d, w in each}
            total, reward = sum(near.values()), F(int(rng.integers(-4, 5)), 10)
            rows.append((s, a, [(F(w, total), t, reward) for t, w in near.items()]))
    ends = set(rng.integers(0, 30, 2).tolist())
    rows = [row for row in rows if row[0] not in ends] + [(s, 0, [(1, s, 0)]) for s in ends]
    mdp = MDP.from_outcomes(rows)
    solution, best = solve(mdp, criterion="average"), certify(mdp, criterion="average")
    assert (off(solution.value, best.value) <= solution.state_error).all()
    assert solution.error_bound < 1e-9


def test_a_reset_chain_of_low_gain_is_solved() -> None:
    """41 states in a row, up with 1/2 and back with 1/2; 1 at the top: 2^-40 and less."""
    chances = [(s, min(s + 1, 40), int(s == 40)) for s in range(41)]
    mdp = MDP.from_outcomes([(s, 0, [("1/2", t, r), ("1/2", 0, r)]) for s, t, r in chances])
    exact = certify(mdp, criterion="average").start_value
    assert exact == F(1, 2**40)
    solution = solve(mdp, criterion="average")
    assert abs(F(solution.start_value) - exact) <= solution.start.error
    assert solution.start.error <= 1e-14


def test_components_of_rows_that_are_divided_by_their_sums_add_up() -> None:
    rows = [(0, 0, [(0.1, 0, 1.5), (0.9 + 1e-10, 1, 2.0)]), (1, 0, [(0.3, 0, 1.0), (0.7, 1, 0.1)])]
    mdp = MDP.from_outcomes(rows).with_(components={"first": [1.25, 0], "second": ["1/3", "1/7"]})
    evaluation = evaluate(mdp, [0, 0], criterion="average")
    total = sum(number.value for number in evaluation.components.values())
    assert list(evaluation.components) == ["first", "second", "rest"]
    assert total == pytest.approx(evaluation.start_value, rel=1e-12)
    assert evaluation.components["first"].value == pytest.approx(1.25 / 4 / (1 + 1e-10), rel=1e-9)


def test_the_random_policy_of_the_forest() -> None:
    evaluation = evaluate(forest("9/10"), "random", criterion="average")
    assert evaluation.start.interval[0] <= 117 / 160 <= evaluation.start.interval[1]
    assert evaluation.read_as == "policy"
    assert evaluation.frame().columns[:3].tolist() == ["state", "gain", "gain error"]
    assert evaluate(forest("9/10"), "optimal", criterion="average").start_value == pytest.approx(
        3.24
    )


def test_settings() -> None:
    mdp = forest("9/10")
    with pytest.warns(PrecisionWarning):
        assert solve(mdp, tol=1e-300, criterion="average").error_bound < 1e-12
    with pytest.raises(SolverError, match="after 3 iterations"):
        solve(mdp, ValueIteration(max_iterations=3), criterion="average")
    solution = solve(mdp, criterion="average")
    assert repr(solution).startswith("AverageSolution(policy-iteration: start value 3.24")
    assert solution.q[solution.pairs] == pytest.approx(solution.bias)
