"""What passes: zero means zero, limits are exact, unknowns never pass, and exact visits decide."""

from dataclasses import replace
from fractions import Fraction as F
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import each_choice, fixed_point, rows_of, visits

from exact_mdp import MDP, Bounded, Certified, Claim, ModelError, assert_policy_optimal, check

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
@pytest.mark.parametrize("gain", [5, 5.0, 0.1, 1e-13, 1e-300, F(1, 10**13), F(1, 10**300)])
def test_a_start_that_gives_up_anything_fails_whatever_an_unreachable_state_is_worth(
    far: Any, gain: Any
) -> None:
    """Small rewards are rewards; the values of states that cannot be reached have no say."""
    mdp = choice(gain, gain * 0, (2, 0, [(1, 1, far)]), (2, 1, [(1, 1, 0)]))
    for exact_values in (None, True, False):
        assert not check(mdp, [1, 0, 0], exact_values=exact_values).passed
    audit = check(mdp, [1, 0, 0])
    assert (audit.agreement, audit.claim) == (0.5, Claim.CERTIFIED)
    assert audit.regret.at_start.value == F(gain)
    assert audit.forgiven <= F(gain) / 2**52
    assert [(each.state, each.gap) for each in audit.disagreements] == [(0, float(gain))]
    assert check(mdp, [0, 0, 0]).passed
    assert check(mdp, [0, 0, 1]).passed
    with pytest.raises(AssertionError, match="the regret is not zero"):
        assert_policy_optimal(mdp, [1, 0, 0])


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
    assert forgiven <= audit.forgiven <= forgiven * (1 + F(1, 10**5))
    assert "up to the rounding of the given floats" in audit.message()
    assert "4.9e-17" in audit.message()
    assert not check(mdp, [0, 0, 0], max_regret=0).passed  # a limit of 0 forgives nothing
    assert check(mdp, [1, 0, 0], max_regret=0).passed
    failed = check(choice(0.3, 0.3 + 1e-15), [0, 0])
    assert (failed.passed, failed.agreement) == (False, 0.0)
    # The same numbers, given exactly, know no rounding at all.
    precise = detour(F(0.3), F(0.1), F(0.2))
    audit = check(precise, [0, 0, 0])
    assert (audit.passed, audit.forgiven, precise.floats) == (False, 0, False)
    assert audit.verdicts[0].name == "the regret is zero"


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


def onward(mdp: MDP, pairs: list[int]) -> list[dict[int, F]]:
    rows = enumerate(rows_of(mdp, pairs))
    return [
        {} if mdp.terminal[s] else {t: mdp.discount_exact * p for t, p in law.items()}
        for s, (*_, law) in rows
    ]


def solved(mdp: MDP, pairs: list[int], earned: list[F]) -> list[F]:
    """Return x = earned + γ P x of some pairs."""
    right = [F(0) if over else x for over, x in zip(mdp.terminal, earned, strict=True)]
    return fixed_point(right, onward(mdp, pairs))


def movable(mdp: MDP, pair: int, *ways: tuple[F, list[F]]) -> F:
    """Return what half a unit in the last place of one pair's numbers moves in Σ n (r + γ V)."""
    row, rounded, earns = mdp.table.row(pair), mdp.float_probabilities, mdp.float_rewards
    x = [sum(n * (r + mdp.discount_exact * value[t]) for n, value in ways) for _, t, r in row]
    # Errors of probabilities sum to 0: any number may be taken off, and the median is best.
    halves = [rounded * ulp(float(p)) for p, _, _ in row]
    moved = min(sum(h * abs(each - c) for h, each in zip(halves, x, strict=True)) for c in x)
    earned = sum(p * ulp(float(r)) for p, _, r in row if r)
    return moved + earns * earned * abs(sum(n for n, _ in ways))


def apart(mdp: MDP, own: tuple[list[int], list[F]], ideal: tuple[list[int], list[F]]) -> F:
    """Return what rounding moves in the difference of two values at the start, pair by pair."""
    uses = []
    for pairs, _ in (own, ideal):
        visited = visits({0: F(1)}, onward(mdp, pairs))
        uses.append({l: visited[s] for s, l in enumerate(pairs) if not mdp.terminal[s]})
    total = F(0)
    for l in uses[0].keys() | uses[1].keys():
        u, v = (of.get(l, F(0)) for of in uses)
        total += movable(mdp, l, (v, ideal[1]), (-u, own[1]))
    return total


@settings(max_examples=100)
@given(small(), st.data())
def test_the_verdict_is_that_of_enumeration(mdp: MDP, data: st.DataObject) -> None:
    """It passes exactly where the exact regret is at most what rounding can move."""
    every = [list(pairs) for pairs in each_choice(mdp)]
    values = [solved(mdp, pairs, [r for _, _, r, _ in rows_of(mdp, pairs)]) for pairs in every]
    best = [max(value[s] for value in values) for s in range(mdp.n_states)]
    optimal = [all(value[s] == best[s] for s in range(mdp.n_states)) for value in values]
    ideal = every[optimal.index(True)]  # each_choice goes through the lowest actions first
    place = data.draw(st.integers(0, len(every) - 1))
    pairs, value = every[place], values[place]
    perfect = solved(mdp, ideal, [movable(mdp, l, (F(1), best)) for l in ideal])
    moved = apart(mdp, (pairs, value), (ideal, best))
    audit = check(mdp, [int(mdp.pair_action[l]) for l in pairs])
    lost = best[0] - value[0]
    assert audit.regret.at_start.value == lost
    assert audit.passed == (lost <= moved)
    assert moved <= audit.forgiven <= moved * (1 + F(1, 10**5)) + F(1, 10**28)
    own = solved(mdp, pairs, [movable(mdp, l, (F(1), value)) for l in pairs])
    assert moved <= own[0] + perfect[0]  # what both do alike moves both alike
    unlisted = audit.regret.optimal_pairs[pairs].all()
    assert audit.passed or not unlisted
    if not unlisted and not audit.passed:
        return
    for l in range(mdp.n_pairs):
        s, row = int(mdp.pair_state[l]), mdp.table.row(l)
        gap = best[s] - sum((p * (r + mdp.discount_exact * best[t]) for p, t, r in row), F(0))
        later = sum((p * perfect[t] for p, t, _ in row), F(0)) * mdp.discount_exact
        ties = mdp.terminal[s] or gap <= movable(mdp, l, (F(1), best)) + later + perfect[s]
        assert audit.regret.optimal_pairs[l] == ties
        if not ties:
            assert audit.regret.gap[l] == pytest.approx(float(gap), rel=1e-8)


# ---- limits -----------------------------------------------------------------------------------

TWO_WAYS = choice(2, 2 - F(1, 10))


@pytest.mark.parametrize(
    ("limits", "passed", "proven"),
    [
        ({}, False, False),
        ({"max_regret": "1/10"}, True, None),
        ({"max_regret": 0.1}, True, None),  # the float is above 1/10
        ({"max_regret": F(1, 10) - F(1, 10**30)}, False, None),
        ({"max_relative_regret": "1/20"}, True, None),
        ({"max_relative_regret": "51/1000"}, True, True),
        ({"max_relative_regret": "49/1000"}, False, False),
        ({"max_regret": 1, "max_relative_regret": 0}, False, False),
        ({"max_regret": 0}, False, False),
    ],
)
def test_limits_are_compared_exactly(
    limits: dict[str, object], passed: bool, proven: bool | None
) -> None:
    """At a limit itself bounds cannot decide, and what is not decided does not pass."""
    audit = check(TWO_WAYS, [1, 0], **limits)
    assert audit.passed is passed
    assert len(audit.verdicts) == max(1, len(limits))
    assert audit.relative_regret == pytest.approx(0.05)
    bounded = check(TWO_WAYS, [1, 0], exact_values=False, **limits)
    assert (bounded.passed, bounded.undecided) == (proven is True, proven is None)


# ---- bounds -----------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("value", "error", "limits", "decision"),
    [
        *((0.0, error, {}, None) for error in (1e-3, 1e-9, 1e-300)),
        (450.0, 1.6, {}, False),
        (450.0, 1.6, {"max_regret": 448}, False),
        (450.0, 1.6, {"max_regret": 449}, None),
        (450.0, 1.6, {"max_regret": 451}, None),
        (450.0, 1.6, {"max_regret": 452}, True),
        (450.0, 1.6, {"max_relative_regret": F(448, 900)}, False),
        (450.0, 1.6, {"max_relative_regret": F(449, 900)}, None),
        (450.0, 1.6, {"max_relative_regret": F(451, 900)}, None),
        (450.0, 1.6, {"max_relative_regret": F(452, 900)}, True),
    ],
)
def test_the_upper_bound_has_to_keep_the_limit(
    value: float, error: float, limits: dict[str, object], decision: bool | None
) -> None:
    """Bounds around zero, however narrow, prove nothing; what is open is said to be."""
    audit = check(choice(900, 450), [1, 0], exact_values=False, **limits)
    wide = replace(
        audit.regret,
        at_start=Bounded(value=value, error=error),
        optimal=Bounded(value=900.0, error=0.0),
    )
    changed = replace(audit, regret=wide)
    assert (changed.passed, changed.undecided) == (decision is True, decision is None)
    assert ("do not decide" in changed.message()) == (decision is None)
    assert ("--certify" in changed.message()) == (decision is None)


def test_an_optimum_with_margins_is_proven_without_rational_arithmetic() -> None:
    """Every action is better than the others by more than the errors: the regret is exactly 0."""
    audit = check(choice(900, 450, discount="9/10"), [0, 0], exact_values=False)
    assert (audit.passed, audit.claim) == (True, Claim.CERTIFIED)
    assert audit.regret.at_start == Certified(value=F(0))
    # Two actions with the same row and reward are equally good, whatever the bounds.
    for learned in ([0, 0], [1, 0], "random"):
        assert check(choice(F(1, 3), F(1, 3)), learned, exact_values=False).passed
    # Equal by other means: the bounds leave it open, and rational arithmetic does.
    tie = detour(F(2, 3), F(1, 3), F(1, 3))
    left_open = check(tie, [1, 0, 0], exact_values=False)
    assert (left_open.passed, left_open.undecided, left_open.unclear) == (False, True, 1)
    assert "the bounds leave it open" in left_open.message()
    assert check(tie, [1, 0, 0]).passed


@pytest.mark.parametrize("exact_values", [None, True, False])
def test_a_relative_regret_of_nothing_is_undefined(exact_values: bool | None) -> None:
    """At an optimum of 0 it is neither 0 nor infinite, and does not pass."""
    mdp = choice(0, -1)
    for learned in ([0, 0], [1, 0]):
        audit = check(mdp, learned, max_relative_regret=1000, exact_values=exact_values)
        assert (audit.passed, audit.relative_regret) == (False, None)
        assert "undefined" in audit.message()
    assert check(mdp, [0, 0], max_regret=0).passed


# ---- where floats cannot bound visits --------------------------------------------------------

HARDLY = F(1, 10**20)


def loop(reward: int = 0, other: int = 1) -> MDP:
    """Return a model whose action 0 stays with probability 1 - 10**-20, and action 1 with 1/2."""
    stay = [(1 - HARDLY, 0, reward), (HARDLY, 1, reward)]
    leave = [("1/2", 0, other), ("1/2", 1, other)]
    return MDP.from_outcomes([(0, 0, stay), (0, 1, leave), (1, 0, [(1, 1, 0)])])


# Of discount 1 - 10**-20; action 1 earns 1 a step and 0 nothing.
PATIENT = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 0, 1)])], discount=1 - HARDLY)
CASES: list[tuple[MDP, Any, F]] = [
    (loop(), {"0": "0"}, F(2)),
    (loop(), {"0": "1"}, F(0)),
    (loop(), "always:0", F(2)),
    (loop(-1, -1), {"0": "0"}, 10**20 - F(2)),
    (loop(1, 0), {"0": "1"}, F(10**20)),
    (loop(1, 0), {"0": "0"}, F(0)),
    (PATIENT, {"0": "0"}, F(10**20)),
    (PATIENT, {"0": "1"}, F(0)),
    (PATIENT, "random", F(10**20, 2)),
]


@pytest.mark.parametrize("model, policy, lost", CASES)
@pytest.mark.parametrize("exact", [None, True])
def test_the_verdict_is_given_where_floats_cannot_bound_visits(
    model: MDP, policy: Any, lost: F, exact: bool | None
) -> None:
    """The exact regret is given; it passes a limit of just that amount, and fails any below."""
    audit = check(model, policy, exact_values=exact)
    assert (audit.regret.at_start.value, audit.passed) == (lost, lost == 0)
    assert audit.claim == "certified"
    assert sum(each.cost for each in audit.disagreements) == pytest.approx(float(lost), rel=1e-12)
    assert check(model, policy, max_regret=lost).passed
    assert not lost or not check(model, policy, max_regret=lost - HARDLY).passed
    assert "nan" not in audit.message()


def test_long_horizons_forgive_by_visits() -> None:
    """At discount 0.999999 a million visits forgive a million roundings, and not more."""
    rows = [(0, 0, [(1, 0, 0.1)]), (0, 1, [(1, 0, float(np.nextafter(0.1, 1)))])]
    mdp = MDP.from_outcomes(rows, F(999999, 1000000))
    audit = check(mdp, [0])
    wanted = 10**6 * (ulp(0.1) + ulp(float(np.nextafter(0.1, 1))))
    assert audit.regret.at_start.value == wanted
    assert audit.passed
    assert wanted <= audit.forgiven <= wanted * (1 + F(1, 10**5))
    rows[1] = (0, 1, [(1, 0, 0.1 + 1e-15)])
    assert not check(MDP.from_outcomes(rows, F(999999, 1000000)), [0]).passed


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


def test_what_every_policy_earns_is_not_forgiven() -> None:
    """A float on all ways is rounded for all of them alike; after the choice, too."""
    for loss, big in ((1e-4, -1e12), (0.1, 1e15)):
        rows = [(0, 0, [(1, 1, big)]), (1, 0, [(1, 2, 0.0)]), (1, 1, [(1, 2, -loss)])]
        mdp = MDP.from_outcomes([*rows, (2, 0, [(1, 3, big)]), (3, 0, [(1, 3, 0)])])
        audit = check(mdp, [0, 1, 0, 0])
        assert not audit.passed
        assert audit.forgiven < F(loss) / 10**12
        assert [each.state for each in audit.disagreements] == [1]
        assert check(mdp, [0, 0, 0, 0]).passed


def test_what_bounds_leave_open_goes_to_rational_arithmetic(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Where the model is too large for it, the verdict is open, fails, and says what to do."""
    size = 210  # a cycle that is bounded unless asked for more, beside an end
    rows = [(s, 0, [(1, (s + 1) % size, F(1, 3))]) for s in range(size)]
    rows += [(0, 2, [(1, size, 0)]), (size, 0, [(1, size, 0)])]
    learned = [1, *[0] * size]
    tie = (0, 1, [(F(1, 2), 1, 0), (F(1, 2), 1, F(2, 3))])
    mdp = MDP.from_outcomes([*rows, tie], "9/10")
    audit, loser = check(mdp, learned), check(mdp, [2, *learned[1:]])
    assert (audit.passed, audit.claim) == (True, Claim.CERTIFIED)
    assert (loser.passed, loser.claim) == (False, Claim.BOUNDED)
    worse = MDP.from_outcomes([*rows, (0, 1, [(1, 1, F(1, 3) - F(1, 10**30))])], "9/10")
    audit = check(worse, learned)
    assert (audit.passed, audit.claim) == (False, Claim.CERTIFIED)
    assert [each.state for each in audit.disagreements] == [0]
    monkeypatch.setattr("exact_mdp.analysis.gate.check.LAST_CYCLE", 10)
    audit = check(worse, learned)
    assert (audit.passed, audit.undecided) == (False, True)
    assert "exact_values=True" in audit.message()


# ---- regrets as numbers ----------------------------------------------------------------------


def test_a_regret_compares_sorts_and_formats_as_the_regret_at_the_start() -> None:
    mdp = choice(0, "1/20")
    audit, best = check(mdp, [0, 0]), check(mdp, [1, 0])
    assert (audit.regret <= F(1, 20), audit.regret < 0.05, audit.regret < 0.1) == (True, True, True)
    assert audit.regret >= F(1, 20) > best.regret
    assert float(audit) == float(audit.regret) == float(audit.value) == 0.05
    assert f"{audit.regret:.3f} {audit.value:.1%}" == "0.050 5.0%"
    assert sorted([audit, best], key=float) == [best, audit]
    assert min(audit.regret, best.regret) is best.regret
    assert audit.regret == F(1, 20) == audit.value
    assert best.regret == 0 != audit.regret
    assert best.regret == check(mdp, [1, 0]).regret
    assert len({audit.regret, check(mdp, [0, 0]).regret, best.regret}) == 2


def test_a_comparison_that_the_verdict_leaves_open_is_refused() -> None:
    audit = check(choice(0, F(1, 3)), [0, 0], max_regret=F(1, 3), exact_values=False)
    assert audit.undecided
    assert (audit.regret < 0.34, audit.regret > 0.33) == (True, True)
    with pytest.raises(ModelError, match="does not decide how it compares with 1/3") as caught:
        audit.regret.__le__(F(1, 3))
    assert "exact_values=True" in caught.value.fix
    assert float(audit) == pytest.approx(1 / 3)
    assert audit.regret != F(1, 3)
    assert check(choice(0, F(1, 3)), [0, 0], exact_values=True).regret <= F(1, 3)
