"""Average rewards: evaluations within bounds, gains that are near, and what proofs tell apart.

That optima are right is a law, in `test_laws`; published ones are in `test_published`.
"""

from dataclasses import replace
from fractions import Fraction
from fractions import Fraction as F

import numpy as np
import pytest
from answers import holds, near, within
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import gain_and_bias, limit, mixed
from strategies import Rows, models

from exact_mdp import (
    MDP,
    PrecisionWarning,
    SolverError,
    ValueIteration,
    certify,
    check,
    evaluate,
    solve,
)


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


def test_settings_of_the_average_reward() -> None:
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


# ---- chains that mix slowly ----------------------------------------------------------------------

F = Fraction


def kmr(n: int, p: Fraction, eps: Fraction) -> list[list[Fraction]]:
    """Kandori, Mailath and Rob (Econometrica 61, 1993): n players revise one at a time."""

    def likes(share: Fraction) -> Fraction:
        return eps / 2 + (1 - eps) * (F(1, 2) if share == p else F(share > p))

    rows = [[F(0)] * (n + 1) for _ in range(n + 1)]
    for k, row in enumerate(rows):
        if k:
            row[k - 1] = F(k, n) * (1 - likes(F(k - 1, n - 1)))
        if k < n:
            row[k + 1] = F(n - k, n) * likes(F(k, n - 1))
        row[k] = 1 - sum(row)
    return rows


def shares(rows: list[list[Fraction]]) -> list[Fraction]:
    """The shares of time of a chain of one class."""
    laws = [{t: F(p) for t, p in enumerate(row) if p} for row in rows]
    return list(limit([(s, 0, F(0), law) for s, law in enumerate(laws)])[0].values())


def uncoupled(eps: Fraction) -> list[list[Fraction]]:
    """Two pairs of states that hardly ever lead to each other."""
    half, left = F(1, 2), F(1, 2) - eps
    return [
        [half, half, 0, 0],
        [half, left, eps, 0],
        [0, 0, half, half],
        [eps / 3, 0, half, half - eps / 3],
    ]


CHAINS = {
    "two states": [[F("0.4"), F("0.6")], [F("0.2"), F("0.8")]],
    "a ring": [[0, 1, 0], [0, 0, 1], [1, 0, 0]],
    "3 players": kmr(3, F(1, 3), F("1e-14")),
    "27 players": kmr(27, F(1, 3), F("1e-2")),
    "uncoupled": uncoupled(F("1e-30")),
}


@pytest.mark.parametrize("rows", CHAINS.values(), ids=CHAINS)
def test_shares_of_time_have_all_their_digits(rows) -> None:
    evaluation = evaluate(
        MDP.from_arrays([rows], [[k] for k in range(len(rows))]),
        [0] * len(rows),
        criterion="average",
    )
    exact = shares(rows)
    near(evaluation.share.value, evaluation.share.error, exact)
    assert max(evaluation.share.error) <= 1e-14
    assert evaluation.visits == pytest.approx([float(x) for x in exact], rel=1e-15)
    mean = sum(k * share for k, share in enumerate(exact))
    assert within(evaluation.start, mean)
    assert evaluation.start.error <= 1e-12 * mean
    assert evaluation.components["reward"].value == pytest.approx(float(mean))


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("rows", CHAINS.values(), ids=CHAINS)
def test_the_best_average_is_exact_where_floats_cannot_bound_it(rows, sense) -> None:
    """A second action earns half as much and stays where it is."""
    size = len(rows)
    stay = [[F(s == t) for t in range(size)] for s in range(size)]
    rewards = [[k, F(k, 2)] for k in range(size)]
    mdp = MDP.from_arrays([rows, stay], rewards, layout="ass", sense=sense)
    proof = certify(mdp, criterion="average")
    for best in (solve(mdp, criterion="average"), evaluate(mdp, "optimal", criterion="average")):
        assert within(best.start, proof.start_value)
        assert best.start.error <= 1e-12
    assert check(mdp, solve(mdp, criterion="average"), criterion="average").passed


def test_a_method_that_is_named_says_that_floats_cannot_bound_it() -> None:
    mdp = MDP.from_arrays([CHAINS["3 players"]], [[k] for k in range(4)])
    with pytest.raises(SolverError, match="rational arithmetic"):
        solve(mdp, "policy-iteration", criterion="average")


def test_transient_states_and_two_classes_under_a_mixed_policy() -> None:
    eps = F("1e-25")
    slow = [[1 - 3 * eps, eps, 2 * eps], [0, 1, 0], [0, 0, 1]]
    mdp = MDP.from_arrays([slow, slow], [[0, 0], [3, 3], [6, 6]])
    evaluation = evaluate(mdp, [[F(1, 3), F(2, 3)]] * 3, kind="policy", criterion="average")
    assert evaluation.share.value == pytest.approx([0, 1 / 3, 2 / 3], rel=1e-15)
    assert evaluation.value == pytest.approx([5, 3, 6], rel=1e-15)
    assert evaluation.visits[0] == pytest.approx(1 / (3e-25), rel=1e-15)


@pytest.mark.parametrize("discount", [1, 1 - F("1e-30")])
def test_an_end_that_hardly_comes(discount) -> None:
    eps = F("1e-30")
    rows = [(0, 0, [(1 - 3 * eps, 0, 2), (eps, 1, 2), (2 * eps, 2, 2)])]
    rows += [(1, 0, [(1, 1, 0)]), (2, 0, [(1, 2, 0)])]
    mdp = MDP.from_outcomes(rows, discount=discount)
    mean = 2 / (1 - discount * (1 - 3 * eps))
    evaluation = evaluate(mdp, [0, 0, 0])
    assert within(evaluation.start, mean)
    assert evaluation.start.error <= mean * F("1e-14")
    assert evaluation.steps == pytest.approx(1e30 / 3, rel=1e-15)
    ends = evaluation.visits if discount == 1 else evaluate(mdp.undiscounted, [0, 0, 0]).visits
    assert ends.tolist() == pytest.approx([1e30 / 3, 1 / 3, 2 / 3], rel=1e-15)
    assert check(mdp, [0, 0, 0]).passed


def test_components_of_rows_that_are_divided_by_their_sums_add_up() -> None:
    rows = [(0, 0, [(0.1, 0, 1.5), (0.9 + 1e-10, 1, 2.0)]), (1, 0, [(0.3, 0, 1.0), (0.7, 1, 0.1)])]
    mdp = MDP.from_outcomes(rows).with_(components={"first": [1.25, 0], "second": ["1/3", "1/7"]})
    evaluation = evaluate(mdp, [0, 0], criterion="average")
    total = sum(number.value for number in evaluation.components.values())
    assert list(evaluation.components) == ["first", "second", "rest"]
    assert total == pytest.approx(evaluation.start_value, rel=1e-12)
    assert evaluation.components["first"].value == pytest.approx(1.25 / 4 / (1 + 1e-10), rel=1e-9)
