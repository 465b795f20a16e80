"""Chains that mix or end so slowly that floats cannot bound what is asked of them."""

from fractions import Fraction

import pytest
from answers import near, within
from oracle import limit

from exact_mdp import MDP, SolverError, certify, check, evaluate, solve

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
