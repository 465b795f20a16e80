"""Zero means zero: what a verdict without a limit forgives, and how ties are decided."""

from fractions import Fraction as F
from itertools import product
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from exact_mdp.analysis import assert_policy_optimal, check
from exact_mdp.analysis.gate.forgiveness import of_floats
from exact_mdp.mdp import MDP
from exact_mdp.solvers import Claim

Row = tuple[int, int, list[tuple[Any, int, Any]]]


def choice(first: Any, second: Any, *more: Row, discount: Any = 1) -> MDP:
    """Return a model with a choice between two rewards in state 0, then the end in state 1."""
    rows: list[Row] = [(0, 0, [(1, 1, first)]), (0, 1, [(1, 1, second)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes([*rows, *more], discount)


def detour(short: Any, first: Any, second: Any) -> MDP:
    """Return a choice between one reward and two in a row."""
    rows = [(0, 0, [(1, 2, short)]), (0, 1, [(1, 1, first)]), (1, 0, [(1, 2, second)])]
    return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])])


def ulp(number: float) -> F:
    return F(float(np.spacing(abs(number)))) / 2


# ---- the regret at the start -----------------------------------------------------------------


@pytest.mark.parametrize("far", [1e13, 1e300, 10**13])
@pytest.mark.parametrize("five", [5, 5.0, 0.1])
def test_a_start_that_gives_up_five_fails_whatever_an_unreachable_state_is_worth(
    far: Any, five: Any
) -> None:
    """The values of states that cannot be reached have no say."""
    mdp = choice(five, five * 0, (2, 0, [(1, 1, far)]), (2, 1, [(1, 1, 0)]))
    for exact_values in (None, True, False):
        assert not check(mdp, [1, 0, 0], exact_values=exact_values).passed
    audit = check(mdp, [1, 0, 0])
    assert audit.regret.at_start.value == F(five)
    assert audit.forgiven <= F(five) / 2**52
    assert [each.state for each in audit.disagreements] == [0]
    assert audit.disagreements[0].gap == five
    assert check(mdp, [0, 0, 0]).passed
    assert check(mdp, [0, 0, 1]).passed
    with pytest.raises(AssertionError):
        assert_policy_optimal(mdp, [1, 0, 0])


@pytest.mark.parametrize("gain", [1e-13, 1e-300, F(1, 10**13), F(1, 10**300)])
def test_small_rewards_are_rewards(gain: Any) -> None:
    """A policy that gives up a certified 1e-13 does not pass, nor does it agree."""
    audit = check(choice(gain, gain * 0), [1, 0])
    assert (audit.passed, audit.agreement, audit.claim) == (False, 0.0, Claim.CERTIFIED)
    assert audit.regret.at_start.value == F(gain)
    assert audit.disagreements[0].gap == float(gain)
    with pytest.raises(AssertionError, match="the regret is zero"):
        assert_policy_optimal(choice(gain, gain * 0), [1, 0])
    assert check(choice(gain, gain * 0), [0, 0]).passed


def test_sums_of_floats_tie_and_more_than_rounding_does_not() -> None:
    """0.1 + 0.2 in two steps ties with 0.3, on either side; 0.3 and 0.3 + 1e-15 differ."""
    mdp = detour(0.3, 0.1, 0.2)
    for action in (0, 1):
        audit = check(mdp, [action, 0, 0])
        assert (audit.passed, audit.agreement, audit.disagreements) == (True, 1.0, ())
    assert F(0.1) + F(0.2) > F(0.3)
    lost, forgiven = F(0.1) + F(0.2) - F(0.3), ulp(0.1) + ulp(0.2) + ulp(0.3)
    audit = check(mdp, [0, 0, 0])
    assert audit.regret.at_start.value == lost
    assert forgiven * (1 - F(1, 10**5)) <= audit.forgiven <= forgiven
    assert "up to the rounding of the given floats" in audit.message()
    assert "4.8e-17" in audit.message()
    assert not check(mdp, [0, 0, 0], max_regret=0).passed  # a limit of 0 forgives nothing
    assert check(mdp, [1, 0, 0], max_regret=0).passed
    other = choice(0.3, 0.3 + 1e-15)
    failed = check(other, [0, 0])
    assert (failed.passed, failed.agreement) == (False, 0.0)
    # The same numbers, given exactly, know no rounding at all.
    precise = detour(F(0.3), F(0.1), F(0.2))
    audit = check(precise, [0, 0, 0])
    assert (audit.passed, audit.forgiven, of_floats(precise)) == (False, 0, False)
    assert audit.verdicts[0].name == "the regret is zero"


def test_what_is_forgiven_is_compared_exactly() -> None:
    """Neighbouring floats may both be the number between them: exactly what is forgiven."""
    above = float(np.nextafter(0.3, 1))
    assert F(above) - F(0.3) == ulp(0.3) + ulp(above)
    audit = check(choice(0.3, above), [0, 0])
    assert audit.passed
    assert audit.forgiven == ulp(0.3) + ulp(above)
    assert audit.disagreements == ()
    two = float(np.nextafter(above, 1))
    assert not check(choice(0.3, two), [0, 0]).passed
    assert len(check(choice(0.3, two), [0, 0]).disagreements) == 1


def test_rounded_rows_forgive_by_the_span_of_what_they_reach() -> None:
    """γ times the rounding of a row times the span of the values that this row can reach."""
    high = 1000
    rows = [
        (0, 0, [(0.1, 1, 0), (0.9, 2, 0)]),
        (0, 1, [(1, 2, F(0.1) * high - F(1, 10**14))]),
        (1, 0, [(1, 3, high)]),
        (2, 0, [(1, 3, 0)]),
        (3, 0, [(1, 3, 0)]),
    ]
    mdp = MDP.from_outcomes(rows, "1/2")
    moved = F(1, 2) * (ulp(0.1) + ulp(0.9)) * high
    audit = check(mdp, [0, 0, 0, 0])
    assert moved * (1 - F(1, 10**5)) <= audit.forgiven
    assert audit.forgiven <= F(1, 2) * (ulp(0.1) + ulp(0.9) + ulp(1.0)) * high


def test_long_horizons_forgive_by_visits() -> None:
    """At discount 0.999999 a million visits forgive a million roundings, and not more."""
    rows = [(0, 0, [(1, 0, 0.1)]), (0, 1, [(1, 0, float(np.nextafter(0.1, 1)))])]
    mdp = MDP.from_outcomes(rows, F(999999, 1000000))
    audit = check(mdp, [0])
    wanted = 10**6 * (ulp(0.1) + ulp(float(np.nextafter(0.1, 1))))
    assert audit.regret.at_start.value == wanted
    assert audit.passed
    assert audit.forgiven == wanted
    worse = MDP.from_outcomes(
        [(0, 0, [(1, 0, 0.1)]), (0, 1, [(1, 0, 0.1 + 1e-15)])], F(999999, 1000000)
    )
    assert not check(worse, [0]).passed


def test_a_regret_of_1e_300_is_a_regret_and_a_tie_is_none() -> None:
    """An exact model knows no rounding; a policy optimal by a tie alone passes."""
    assert not check(choice(1, 1 - F(1, 10**300)), [1, 0]).passed
    audit = check(choice(1, 1), [1, 0])
    assert (audit.passed, audit.disagreements, audit.forgiven) == (True, (), 0)


def test_large_values_hide_no_disagreement_and_invent_none() -> None:
    """Around 1e13 doubles cannot tell gaps of 1e-3: these are worked out exactly."""
    rows = [
        (0, 0, [(1, 1, 10**13)]),
        (0, 1, [(1, 1, 10**13 - F(1, 1000))]),
        (0, 2, [(1, 1, 10**13)]),
        (1, 0, [(1, 2, 10**13)]),
        (1, 1, [(1, 2, 10**13 - F(1, 10**9))]),
        (2, 0, [(1, 2, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    audit = check(mdp, [1, 1, 0])
    assert [each.gap for each in audit.disagreements] == [1e-3, 1e-9]
    assert [each.cost for each in audit.disagreements] == [1e-3, 1e-9]
    assert check(mdp, [2, 0, 0]).disagreements == ()
    assert not audit.passed


# ---- against every policy of small models ------------------------------------------------------

NUMBERS = st.sampled_from(
    [0.1, 0.2, 0.3, 0.1 + 0.2, float(np.nextafter(0.3, 1)), 1e-13, 1.0, 0, 1, F(3, 10), F(1, 3)]
)
CHANCES = st.sampled_from([[0.1, 0.9], [0.5, 0.5], [F(1, 3), F(2, 3)], [0.3, 0.7], [1]])


@st.composite
def small(draw: st.DrawFn) -> MDP:
    """Draw a model of one to three states and the end, of floats, of exact numbers, or of both."""
    states, rows = draw(st.integers(1, 3)), list[Row]()
    discount = draw(st.sampled_from([F(1, 2), F(9, 10), F(1)]))
    for s in range(states):
        for a in range(draw(st.integers(1, 2))):
            chances = draw(CHANCES)
            least = s + 1 if discount == 1 else 0
            targets = [draw(st.integers(least, states)) for _ in chances]
            if len(set(targets)) < len(targets):
                chances, targets = [1], targets[:1]
            reward = draw(NUMBERS)
            rows.append((s, a, [(p, t, reward) for p, t in zip(chances, targets, strict=True)]))
    return MDP.from_outcomes([*rows, (states, 0, [(1, states, 0)])], discount)


def solved(mdp: MDP, pairs: list[int], earned: list[F]) -> list[F]:
    """Return x = earned + γ P x of some pairs, by elimination in fractions."""
    n = mdp.n_states
    matrix = [[F(int(i == j)) for j in range(n)] + [earned[i]] for i in range(n)]
    for s, pair in enumerate(pairs):
        if not mdp.terminal[s]:
            for p, t, _ in mdp.table.row(pair):
                matrix[s][t] -= mdp.discount_exact * p
        else:
            matrix[s][n] = F(0)
    for i in range(n):
        swap = next(r for r in range(i, n) if matrix[r][i])
        matrix[i], matrix[swap] = matrix[swap], matrix[i]
        matrix[i] = [x / matrix[i][i] for x in matrix[i]]
        for r in range(n):
            if r != i and matrix[r][i]:
                matrix[r] = [
                    x - matrix[r][i] * y for x, y in zip(matrix[r], matrix[i], strict=True)
                ]
    return [row[n] for row in matrix]


def value(mdp: MDP, pairs: list[int]) -> list[F]:
    rewards = [sum((p * r for p, _, r in mdp.table.row(l)), F(0)) for l in pairs]
    return solved(mdp, pairs, rewards)


def movable(mdp: MDP, pair: int, worth: list[F]) -> F:
    """Return what the rounding of one pair's floats can move, from the model's own roundings."""
    table, row = mdp.table, mdp.table.row(pair)
    begin = int(table.offsets[pair])
    gains, weights = table.gain_rounding(), table.weight_rounding()
    single = len(gains) == table.pairs
    own = sum(
        (p * F(float(gains[pair if single else begin + i])) for i, (p, _, _) in enumerate(row)),
        F(0),
    )
    if single:
        own = F(float(gains[pair]))
    span = max(worth[t] for _, t, _ in row) - min(worth[t] for _, t, _ in row)
    moved = sum((F(float(weights[begin + i])) for i in range(len(row))), F(0))
    return own + mdp.discount_exact * moved * span


@settings(max_examples=150)
@given(small(), st.data())
def test_the_verdict_is_that_of_enumeration(mdp: MDP, data: st.DataObject) -> None:
    """It passes exactly where the exact regret is at most what rounding can move."""
    every = [list(pairs) for pairs in product(*(mdp.pairs_of(s) for s in range(mdp.n_states)))]
    values = [value(mdp, pairs) for pairs in every]
    best = [max(worth[s] for worth in values) for s in range(mdp.n_states)]
    optimal = [all(worth[s] == best[s] for s in range(mdp.n_states)) for worth in values]
    ideal = every[optimal.index(True)]  # product goes through the lowest actions first
    place = data.draw(st.integers(0, len(every) - 1))
    pairs, worth = every[place], values[place]
    own = solved(mdp, pairs, [movable(mdp, l, worth) for l in pairs])
    perfect = solved(mdp, ideal, [movable(mdp, l, best) for l in ideal])
    audit = check(mdp, [int(mdp.pair_action[l]) for l in pairs])
    lost = best[0] - worth[0]
    assert audit.regret.at_start.value == lost
    assert audit.passed == (lost <= own[0] + perfect[0])
    assert audit.forgiven <= own[0] + perfect[0]
    assert audit.forgiven >= (own[0] + perfect[0]) * (1 - F(1, 10**5))
    for l in range(mdp.n_pairs):
        s, row = int(mdp.pair_state[l]), mdp.table.row(l)
        gap = best[s] - sum((p * (r + mdp.discount_exact * best[t]) for p, t, r in row), F(0))
        later = sum((p * perfect[t] for p, t, _ in row), F(0)) * mdp.discount_exact
        ties = mdp.terminal[s] or gap <= movable(mdp, l, best) + later + perfect[s]
        assert audit.regret.optimal_pairs[l] == ties
        if not ties:
            assert audit.regret.gap[l] == pytest.approx(float(gap), rel=1e-8)
