"""The value as a function of a parameter, against closed forms and single certificates."""

from __future__ import annotations

from fractions import Fraction
from itertools import pairwise

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis.sensitivity import gap_polynomials, thresholds, value_function
from exact_mdp.analysis.sensitivity.curve import ValueFunction
from exact_mdp.analysis.sensitivity.exact_chain import ExactChain
from exact_mdp.mdp import MDP, ModelError, Scenario
from exact_mdp.mdp.parametric import Parametric, moving, parametric
from exact_mdp.solvers import certify

F = Fraction
SMALL = Scenario.load("tea").with_(tasks=[1], max_trial=2)


def start_of(mdp: MDP, policy: object) -> Fraction:
    """The exact value of a policy at one point, by its linear equations."""
    chain = ExactChain(mdp, policy)
    values = chain.values(chain.reward)
    exact = (F(int(values[s].p), int(values[s].q)) * weight for s, weight in mdp.start)
    return sum(exact, F(0))


def agrees(found: ValueFunction, family: Parametric, at: Fraction, policy: object) -> None:
    mdp = family.at({found.parameter.name: at})
    certificate = certify(mdp)
    assert found.at(at) == certificate.start_value
    assert found.fixed_at(at) == start_of(mdp, policy)
    for piece in found.around(at):
        if piece.low[1] < at < piece.high[0]:
            assert (piece.optimal == certificate.optimal_pairs)[~mdp.terminal[mdp.pair_state]].all()


def test_puterman_in_closed_form() -> None:
    # Puterman (1994), section 3.1; QuantEcon.py, quantecon/markov/tests/test_ddp.py
    rows = [(0, 0, [("1/2", 0, 5), ("1/2", 1, 5)]), (0, 1, [(1, 1, 10)]), (1, 0, [(1, 1, -1)])]
    found = value_function(MDP.from_outcomes(rows, "1/2"), "discount", (0, "99/100"))
    low, high = found.pieces
    assert (low.value.numerator, low.value.denominator) == ((10, -11), (1, -1))
    assert (high.value.numerator, high.value.denominator) == (
        (5, F(-11, 2)),
        (1, F(-3, 2), F(1, 2)),
    )
    assert low.high == high.low
    assert low.high[0] <= F(10, 11) <= low.high[1]
    with pytest.raises(ModelError, match="outside the range"):
        found.at(1)


shares = st.integers(1, 6)


@settings(max_examples=25, deadline=None)
@given(
    weights=st.lists(st.tuples(shares, shares, shares), min_size=6, max_size=6),
    rewards=st.lists(st.integers(-5, 5), min_size=6, max_size=6),
    place=st.fractions(0, 1, max_denominator=50),
    name=st.sampled_from(["p", "discount", "gain"]),
    sense=st.sampled_from(["max", "min"]),
)
def test_random_models_with_cycles(
    weights: list[tuple[int, int, int]], rewards: list[int], place: Fraction, name: str, sense: str
) -> None:
    rows = [
        (s // 2, s % 2, [(F(w, sum(each)), t, rewards[s]) for t, w in enumerate(each)])
        for s, each in enumerate(weights)
    ]
    mdp = MDP.from_outcomes(rows, discount="9/10", start={0: F(1, 3), 2: F(2, 3)}, sense=sense)
    gains = {"gain": rewards[1]} if rewards[1] else {"gain": rewards[0]} if rewards[0] else {}
    family = moving(mdp, {"p": [(0, 1)]}, gains)
    if name not in [parameter.name for parameter in family.parameters]:
        return
    found = value_function(family, name, policy="random")
    span = found.range
    agrees(found, family, span.low + (span.high - span.low) * place, "random")
    for left, right in pairwise(found.pieces):
        assert left.high == right.low
        for end in left.high:
            agrees(found, family, end, "random")


@pytest.mark.parametrize(
    ("limit", "name", "message"),
    [
        ("LARGEST", "gain", "2 states with cycles among them(.|\n)*at most 1 state"),
        ("CYCLIC_DEGREE", "p", "2 states on cycles(.|\n)*degree 3(.|\n)*up to degree 1;"),
    ],
)
def test_the_limit_that_was_hit_is_named(
    limit: str, name: str, message: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    rows = [(s, a, [("1/2", 0, 1), ("1/2", 1, a)]) for s in (0, 1) for a in (0, 1)]
    family = moving(MDP.from_outcomes(rows, "9/10"), {"p": [(0, 1)]}, {"gain": 1})
    assert value_function(family, name).pieces
    monkeypatch.setattr(gap_polynomials, limit, 1)
    with pytest.raises(ModelError, match=message):
        value_function(family, name)


@pytest.mark.parametrize("name", ["base.anxiety", "reward.assist.prompt", "discount"])
def test_scenarios(name: str) -> None:
    family = parametric(SMALL)
    span = (F(1, 10), F(9, 10)) if name != "reward.assist.prompt" else (-6, 1)
    found = value_function(SMALL, name, span, policy="always:prompt")
    crossed = [t for t in thresholds(SMALL, name, span).found if not t.touch]
    ends = {(t.low, t.high) for t in crossed}
    assert ends <= {piece.high for piece in found.pieces[:-1]}
    assert len(found.frame()) == len(found.pieces) > len(ends)
    for k in range(5):
        agrees(found, family, F(span[0]) + (F(span[1]) - span[0]) * F(k, 4), "always:prompt")
