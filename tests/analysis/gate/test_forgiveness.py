"""What rounding forgives, by short cuts: each against the long way round."""

from fractions import Fraction as F
from itertools import pairwise
from random import Random
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp import MDP, ModelError, check, evaluate, solve
from exact_mdp.analysis.gate import disagreements as gate_visits
from exact_mdp.analysis.gate import forgiveness as gate_forgiveness
from exact_mdp.analysis.gate import regret
from exact_mdp.analysis.gate.forgiveness import (
    Forgiveness,
    Side,
    moved_at_start,
    tie_range,
    widest,
    widest_tie,
)
from exact_mdp.solvers.bounds.linear import FixedPoint
from exact_mdp.solvers.values.policy_chain import PolicyChain


def model(seed: int, rate: str) -> MDP:
    """Return a model of floats that often ties; at discount 1 the last state is the end."""
    rng, size = np.random.default_rng(seed), 6
    rows = rng.dirichlet(np.full(size, 0.3), (3, size))
    rows[1] = rows[0]
    reward = rng.choice([0.1, 0.3, 0.7], (size, 3)) * 10.0 ** rng.integers(-3, 4)
    if rate == "1":
        rows[:, :-1] = 0.8 * rows[:, :-1] + 0.2 * np.eye(size)[-1]
        rows[:, -1], reward[-1] = np.eye(size)[-1], 0.0
    return MDP.from_arrays(rows / rows.sum(axis=2, keepdims=True), reward, discount=rate)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["1/2", "99/100", "99999/100000", "1"]))
def test_a_gap_beyond_the_widest_tie_is_beyond_each(seed: int, rate: str) -> None:
    mdp = model(seed, rate)
    found = solve(mdp)
    known = FixedPoint(value=found.value, error=found.state_error)
    chain = PolicyChain.of(mdp, found)
    every = tie_range(mdp, known, chain)
    assert every.high.max() <= widest_tie(mdp, known)
    some = np.arange(0, mdp.n_pairs, 2)
    few = tie_range(mdp, known, chain, some)
    assert np.array_equal(few.high, every.high[some])
    assert np.array_equal(few.low, every.low[some])


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["1/2", "99/100", "1"]))
def test_no_two_policies_are_moved_apart_by_more_than_the_widest(seed: int, rate: str) -> None:
    mdp = model(seed, rate)
    rng, sides = np.random.default_rng(seed), list[Side]()
    for _ in range(2):
        chain = PolicyChain.of(mdp, rng.integers(0, 3, mdp.n_states))
        own = evaluate(mdp, chain)
        sides.append(Side(chain=chain, found=FixedPoint(value=own.value, error=own.error)))
    _, high = moved_at_start(mdp, *sides)
    assert 0 < high <= widest(mdp, *(side.found for side in sides))


@pytest.mark.parametrize(
    ("low", "high", "covered", "looked"),
    [(0, 0, True, 0), (0, 1, True, 0), (9, 9, False, 0), (2, 3, True, 1), (2, 5, None, 1),
     (7, 8, False, 1), (4, 4, True, 2), (5, 5, False, 2)],
)  # fmt: skip
def test_what_is_forgiven_is_looked_at_no_closer_than_need_be(
    low: int, high: int, covered: bool | None, looked: int
) -> None:
    asked = list[int]()
    found = Forgiveness(
        least=F(1),
        most=F(8),
        narrow=lambda: (asked.append(1), (F(3), F(6)))[1],
        make=lambda: (asked.append(2), F(4))[1],
    )
    assert found.covers(low, high) is covered
    assert max(asked, default=0) == looked
    assert found.low <= 4 <= found.high


def test_a_verdict_needs_no_visits(monkeypatch: pytest.MonkeyPatch) -> None:
    """Which may take longer than the solution; what is shown of an audit does."""
    mdp, asked = model(3, "99/100"), list[Any]()
    inner = gate_visits.visits
    for module in (gate_visits, gate_forgiveness):
        monkeypatch.setattr(module, "visits", lambda *given: asked.append(1) or inner(*given))
    for policy, passed in ((solve(mdp), True), ([2] * 6, False)):
        audit = check(mdp, policy, exact_values=False)
        assert (audit.passed, asked) == (passed, [])
    assert "rounding can move it by" in audit.verdicts[0].text
    before = len(asked)
    assert len(audit.disagreements) > 0
    assert 0 < before < len(asked)


@settings(max_examples=40)
@given(st.integers(0, 10**6), st.sampled_from(["1/2", "99/100", "1"]))
def test_what_both_do_alike_moves_both_alike(seed: int, rate: str) -> None:
    """The bounds of a policy against itself hold those of the same policy written twice."""
    mdp = model(seed, rate)
    rng, sides = np.random.default_rng(seed), list[Side]()
    policy = rng.integers(0, 3, mdp.n_states)
    chains = [PolicyChain.of(mdp, policy) for _ in range(2)]
    for chain, off in zip(chains, (0.0, 1e-9), strict=True):
        own = evaluate(mdp, chain)
        known = FixedPoint(value=own.value + off * ~mdp.terminal, error=own.error)
        sides.append(Side(chain=chain, found=known))
    low, high = moved_at_start(mdp, *sides)
    alike = moved_at_start(mdp, sides[0], Side(chain=chains[0], found=sides[1].found))
    assert high <= widest(mdp, *(side.found for side in sides))
    assert alike[0] == 0
    assert alike[0] <= low <= high
    assert alike[1] >= low
    # A span of x is at most twice its size.
    assert alike[1] <= F(10) ** -9


@pytest.mark.parametrize("rate", ["99/100", "1"])
@pytest.mark.parametrize("seed", range(6))
def test_audits_are_the_same_without_the_short_cut(
    monkeypatch: pytest.MonkeyPatch, seed: int, rate: str
) -> None:
    mdp = model(seed, rate)
    policy = np.random.default_rng(seed).integers(0, 3, mdp.n_states)
    found: list[Any] = []
    for tie, moved in ((widest_tie, widest), (lambda *_: np.inf, lambda *_: np.inf)):
        monkeypatch.setattr(regret, "widest_tie", tie)
        monkeypatch.setattr(regret, "widest", moved)
        found.append(check(mdp, policy, exact_values=False))
    one, other = found
    assert np.array_equal(one.regret.optimal_pairs, other.regret.optimal_pairs)
    assert np.array_equal(one.regret.gap, other.regret.gap)
    assert (one.passed, one.disagreements) == (other.passed, other.disagreements)
    assert one.verdicts == other.verdicts
    assert one.forgiven == other.forgiven


def test_prices_are_worked_out_when_asked_for(monkeypatch: pytest.MonkeyPatch) -> None:
    mdp = model(3, "99/100")
    asked = list[int]()
    inner = vars(PolicyChain)["discounted"].func
    audit = check(mdp, [2] * 6, exact_values=False)
    audit.visits.sum()
    with monkeypatch.context() as patch:
        patch.setattr(PolicyChain, "discounted", property(lambda c: asked.append(1) or inner(c)))
        frame = audit.frame()
        assert not asked
        full = audit.frame(full=True)
        assert asked
    assert list(full.columns) == [
        *frame.columns,
        "expected_visits",
        "gain_if_corrected",
        "loss_if_alone",
    ]
    assert full["gain_if_corrected"].notna().all()


def model_of_fractions(rng: Random) -> MDP:
    """Actions that are equal but for their roundings, and action 3, which earns 1e-9 less."""
    states, parts = rng.randint(1, 5), rng.choice([3, 6, 7, 10])
    rows: list[Any] = [(states, 0, [(1, states, 0)])]
    for state in range(states):
        cuts = [0, *sorted(rng.randint(0, parts) for _ in range(2)), parts]
        law = [((high - low) / parts, rng.randint(0, states)) for low, high in pairwise(cuts)]
        earned = rng.randint(-3, 3) / parts
        for action in range(3):
            law = rng.sample([each for each in law if each[0]], k=sum(p > 0 for p, _ in law))
            (p, target), cut = law[0], rng.choice([1, 3, 10])
            rows.append((state, action, [(q, t, earned) for q, t in law[1:]]))
            rows[-1][2].extend([(p / cut, target, earned)] * cut)
        rows.append((state, 3, [(q, t, earned - 1e-9) for q, t in law]))
    return MDP.from_outcomes(rows, rng.choice([1, 1, 0.9, 1 / 3, 0.99]))


@pytest.mark.parametrize("seed", range(60))
def test_what_solve_returns_passes(seed: int) -> None:
    """Rows of floats miss 1, which breaks ties; who loses more than that explains still fails."""
    rng = Random(seed)
    mdp = model_of_fractions(rng)
    policy = solve(mdp).policy
    try:
        audit = check(mdp, policy)
    except ModelError:  # infinite totals are not compared
        return
    assert audit.passed, audit
    worse = [3, *policy[1:]]
    assert not check(mdp, worse).passed
    assert not check(mdp, worse, exact_values=False).passed
