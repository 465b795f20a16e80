"""Derivatives of the start value against differentiated linear systems of every policy."""

from fractions import Fraction
from math import inf, prod
from typing import Any

import numpy as np
import pytest
from average_models import two_states
from curved_models import KINDS, CurvedModel, curved_model
from oracle import rows_of

from exact_mdp import MDP, Family, ModelError, Parameter, certify, evaluate, gradient, moving
from exact_mdp.analysis.vary.curves import gradient as inner
from exact_mdp.analysis.vary.curves.gradient import Checked
from exact_mdp.mdp.parametric.row_change import Piece, row_change
from exact_mdp.solvers.claims import Bounded, Certified, Claim

F = Fraction
SENSES = pytest.mark.parametrize("sense", ["max", "min"])


def sides(model: CurvedModel, t: Fraction) -> tuple[Fraction, Fraction]:
    """Just beside t the best of the policies that are best at t is ahead by its derivative."""
    slopes = [model.begin(model.slope(each, t)) for each in model.optimal_policies(t)]
    ends = min(slopes), max(slopes)
    return ends if model.sense == "max" else ends[::-1]


def actions(model: CurvedModel, policy: Any) -> list[int]:
    return [model.rows[pair].action for pair in policy]


@SENSES
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("t", [F(1, 3), F(0), F(1)])
def test_exact_derivatives_on_both_sides_are_those_of_the_best_policies(
    kind: str, t: Fraction, sense: str
) -> None:
    for seed in range(6):
        model = curved_model(seed, kind, sense)
        if seed % 2:
            model = model.tied(t, np.random.default_rng(seed))
        family = model.family(t)
        found = gradient(family)
        left, right = sides(model, t)
        each = found["t"]
        assert each.left is None if t == 0 else each.left is not None
        assert each.right is None if t == 1 else each.right is not None
        if each.left is not None:
            assert each.left.value == left
        if each.right is not None:
            assert each.right.value == right
        assert (found.start_value, found.start.claim) == (model.best(t), Claim.CERTIFIED)
        assert found.reoptimised
        single = right if t == 0 else left if t == 1 or left == right else None
        assert (each.value and each.value.value) == single
        assert each.claim is Claim.CHECKED
        if single is None or not found.start_value:
            assert each.elasticity is None
        else:
            assert each.elasticity == pytest.approx(float(single * t / found.start_value))


@SENSES
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("exact", [True, False])
def test_derivatives_of_a_policy_that_is_held_fixed(kind: str, sense: str, exact: bool) -> None:
    t = F(1, 4)
    for seed in range(6):
        model = curved_model(seed, kind, sense)
        policy = [*model.policies()][-1]
        found = gradient(model.family(t), policy=actions(model, policy), exact=exact)
        slope, value = (model.begin(each(policy, t)) for each in (model.slope, model.value))
        number = found["t"].value
        assert isinstance(number, Checked)
        assert not found.reoptimised
        if exact:
            assert (number.value, number.error, found.start_value) == (slope, 0, value)
            continue
        assert abs(F(number.value) - slope) <= F(number.error)
        assert 0 < number.error < 1e-10
        assert isinstance(number.number, Bounded)
        assert abs(F(found.start_value) - value) < F(1, 10**10)
        assert found["t"].elasticity == pytest.approx(float(slope * t / value) if value else 0.0)


@SENSES
@pytest.mark.parametrize("kind", KINDS)
def test_floats_have_bounds_that_hold_and_refuse_ties(kind: str, sense: str) -> None:
    t = F(3, 8)
    for seed in range(6):
        model = curved_model(seed, kind, sense)
        if len(model.optimal_policies(t)) == 1:
            found = gradient(model.family(t), exact=False)
            slope, number = sides(model, t)[0], found["t"].value
            assert number is not None
            assert abs(F(number.value) - slope) <= F(number.error)
            assert number.error < 1e-10
        tied = model.tied(t, np.random.default_rng(seed))
        best = tied.optimal_policies(t)
        if len({policy[0] for policy in best}) > 1 and 0 in tied.start:
            with pytest.raises(ModelError, match="several actions are optimal"):
                gradient(tied.family(t), exact=False)


def test_mixtures_of_actions_have_the_mixed_rows() -> None:
    """A third of one action and two thirds of the other, in the first state."""
    t = F(1, 2)
    for kind in KINDS:
        model = curved_model(3, kind)
        first, second, *others = model.rows
        laws = tuple(
            {s: a.get(s, F(0)) / 3 + 2 * b.get(s, F(0)) / 3 for s in {*a, *b}}
            for a, b in zip(first.laws, second.laws, strict=True)
        )
        paid = tuple(x / 3 + 2 * y / 3 for x, y in zip(first.reward, second.reward, strict=True))
        rows = (type(first)(0, 0, laws, paid), *others)
        mixed = CurvedModel(rows, model.states, model.rate, model.start)
        policy = next(iter(mixed.policies()))
        shares = {"state 0": {"0": "1/3", "1": "2/3"}}
        shares |= {f"state {s}": {"0": 1} for s in range(1, model.states)}
        for exact in (True, False):
            found = gradient(model.family(t), policy=shares, exact=exact)["t"].value
            assert found is not None
            wanted = mixed.begin(mixed.slope(policy, t))
            assert float(found.value) == pytest.approx(float(wanted), abs=1e-12)


# ---- models with named numbers -------------------------------------------------------------------

LOOP = MDP.from_outcomes(
    [(0, 0, [("1/2", 0, 2), ("1/4", 1, 0), ("1/4", 2, 4)]), (0, 1, [(1, 2, 1)]),
     (1, 0, [("1/2", 0, 1), ("1/2", 1, 3)]), (2, 0, [(1, 2, 0)])],
    discount="3/4",
)  # fmt: skip
NAMED = moving(LOOP, {"stay": [(0, 0)], "back": [(2, 0)]}, {"reward.4": 4, "reward.3": 3})


def test_what_is_known_of_a_model_is_certified_and_a_difference_of_values() -> None:
    """Of V = N / D with polynomials of degree 2 at most, by values at points nearer and nearer."""
    found = gradient(NAMED)
    for name, each in found.derivatives.items():
        assert isinstance(each.value, Certified)
        assert each.claim is Claim.CERTIFIED
        today, slopes = each.parameter.value, []
        for step in (F(1, 10**6), -F(1, 10**6)):
            value = certify(NAMED.at({name: today + step})).start_value
            slopes.append((F(value) - F(found.start_value)) / step)
        assert float(each.value.value) == pytest.approx(float(sum(slopes) / 2), rel=1e-9)
        assert each.elasticity == pytest.approx(
            float(each.value.value * today / F(found.start_value))
        )
    bounded = gradient(NAMED, exact=False)
    for name, each in bounded.derivatives.items():
        own = found[name].value
        assert isinstance(each.value, Bounded)
        assert own is not None
        assert each.claim is Claim.BOUNDED
        assert abs(F(each.value.value) - F(own.value)) <= F(each.value.error)
    assert [*gradient(NAMED, names=["back", "stay"]).derivatives] == ["back", "stay"]
    assert [*found.derivatives] == [parameter.name for parameter in NAMED.parameters]


def test_tables_have_the_largest_elasticity_first() -> None:
    found = gradient(NAMED)
    frame = found.frame()
    order = sorted(found.derivatives, key=lambda name: -abs(found[name].elasticity or 0))
    assert frame["parameter"].tolist() == order
    for k, name in enumerate(order):
        each, row = found[name], frame.iloc[k]
        assert row["value"] == float(each.parameter.value)
        assert each.value is not None
        assert row["derivative (reward per unit)"] == float(each.value.value)
        assert row["left"] == row["right"] == float(each.value.value)
        assert row["elasticity (% per %)"] == each.elasticity
        assert (row["policy"], row["claim"]) == ("re-optimised", "certified")
    facts = found.report().facts
    assert facts["derivatives"] == {n: float(found[n].value.value) for n in found.derivatives}
    assert facts["error_bounds"].value == dict.fromkeys(found.derivatives, 0.0)
    assert facts["exact_derivatives"].value["stay"] == found["stay"].value.value
    assert "error_bound" not in facts
    fixed = gradient(NAMED, policy=[0, 0, 0], exact=False)
    assert fixed.frame()["policy"].tolist() == ["fixed"] * len(order)
    assert fixed.report().facts["policy"] == "fixed"
    errors = fixed.report().facts["error_bounds"].value
    assert errors["stay"] == fixed["stay"].value.error > 0


def test_at_a_tie_and_at_a_breakpoint_the_sides_differ() -> None:
    """max(t, 1/2) at 1/2, and |t| at a break that is stated."""
    bets = Family(
        parameters=(Parameter(name="t", value="1/2"),),
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[at["t"], "1/2"], [0, 0]], 1),
    )
    each = gradient(bets)["t"]
    assert (each.left.value, each.right.value, each.value, each.elasticity) == (0, 1, None, None)
    row = gradient(bets).report().tables["derivatives"].rows[0]
    assert row["derivative (reward per unit)"] == "0 | 1"
    size = Family(
        parameters=(Parameter(name="t", value=0),),
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [abs(at["t"]), 0], 1),
        breaks={"t": [F(0)]},
    )
    for exact in (True, False):
        each = gradient(size, exact=exact)["t"]
        assert (each.left.value, each.right.value, each.value) == (-1, 1, None)


def test_rationals_are_taken_of_models_that_are_small_or_without_cycles(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def claims(mdp: MDP) -> Claim:
        return gradient(mdp, names=["discount"])["discount"].claim

    def ring(states: int, *, line: bool = False, share: object = "1/2") -> MDP:
        end = states - 1
        rows = [(s, 0, [(share, s + 1, 1), (1 - F(str(share)), end, 0)]) for s in range(end - 1)]
        rows.append((end - 1, 0, [(1, end if line else 0, 1)]))
        return MDP.from_outcomes([*rows, (end, 0, [(1, end, 0)])], discount="1/2")

    def uniform(states: int) -> MDP:
        return MDP.from_arrays(np.full((1, states, states), F(1, states)), np.arange(states), "1/2")

    assert inner.EXACT_TRANSITIONS == 100_000
    assert claims(ring(200)) is Claim.CERTIFIED
    assert claims(ring(201)) is Claim.BOUNDED
    assert claims(ring(300, line=True)) is Claim.CERTIFIED
    # Long numbers, or more than 10,000 transitions.
    long = F(10**30 + 57, 3 * 10**30)
    assert claims(ring(64, share=long)) is Claim.CERTIFIED
    assert claims(ring(65, share=long)) is Claim.BOUNDED
    assert claims(uniform(100)) is Claim.CERTIFIED
    assert claims(uniform(101)) is Claim.BOUNDED
    more = np.zeros((1, 101, 101), dtype=object)
    more[0, :100, :100], more[0, 100, 0] = F(1, 100), 1
    assert claims(MDP.from_arrays(more, np.arange(101), "1/2")) is Claim.BOUNDED
    line = ring(300, line=True)
    for fewer, claim in ((0, Claim.CERTIFIED), (1, Claim.BOUNDED)):
        monkeypatch.setattr(inner, "EXACT_TRANSITIONS", line.n_transitions - fewer)
        assert claims(line) is claim


# ---- what is refused -----------------------------------------------------------------------------


@pytest.mark.parametrize("exact", [True, False])
def test_what_has_no_finite_derivative_is_refused(exact: bool) -> None:
    stays = MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)])], 1)
    with pytest.raises(ModelError, match="some policy never ends"):
        gradient(stays, exact=exact)
    with pytest.raises(ModelError, match="some policy never ends"):
        gradient(stays, policy=[0, 0], exact=exact)
    assert gradient(stays, policy=[1, 0], names=[], exact=exact).start_value == 0
    # A terminal state that would earn for ever.
    ends = Family(
        parameters={"t": 0},
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [1, at["t"]], 1),
    )
    with pytest.raises(ModelError, match="a terminal state would earn forever"):
        gradient(ends, exact=exact)
    halves = Family(
        parameters={"t": 0},
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]], [1, at["t"]], "1/2"),
    )
    slope = gradient(halves, exact=exact)["t"].value  # 1/2 + 1/4 + … = 1
    assert slope is not None
    assert float(slope.value) == pytest.approx(1)


@pytest.mark.parametrize("exact", [True, False])
def test_a_chance_that_begins_to_lead_into_a_trap_is_refused(exact: bool) -> None:
    """The policy ends; with a chance t it would go to a state from which it never does."""

    def build(at: Any) -> MDP:
        t = at["t"]
        rows = [(0, 0, [(1 - t, 2, 1), (t, 1, 0)] if t else [(1, 2, 1)]), (1, 0, [(1, 1, 1)]),
                (1, 1, [(1, 2, 0)]), (2, 0, [(1, 2, 0)])]  # fmt: skip
        return MDP.from_outcomes(rows, 1)

    family = Family(parameters=(Parameter(name="t", value=0, low=0, high=1),), build=build)
    with pytest.raises(ModelError, match="leads to a state whose total may be infinite"):
        gradient(family, policy=[0, 0, 0], exact=exact)
    slope = gradient(family, policy=[0, 1, 0], exact=exact)["t"].value
    assert slope is not None
    assert float(slope.value) == -1


@pytest.mark.parametrize("exact", [True, False])
def test_a_state_that_is_over_today_and_begins_next_to_today_needs_an_action(exact: bool) -> None:
    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, 2 * at["t"])])]
        return MDP.from_outcomes(rows, "1/2")

    family = Family(parameters={"t": 0}, build=build)
    with pytest.raises(ModelError, match="names no action"):
        gradient(family, policy={"state 0": "0"}, exact=exact)
    slope = gradient(family, policy=[0, 1], exact=exact)["t"].value
    assert slope is not None
    assert float(slope.value) == pytest.approx(2)  # 1/2 · 2 (1 + 1/2 + …)
    if exact:
        each = gradient(family)["t"]
        assert (each.left.value, each.right.value) == (1, 2)
    else:
        with pytest.raises(ModelError, match="several actions are optimal"):
            gradient(family, exact=False)
    assert evaluate(build({"t": 0}), [0, 0]).start.value == 1


@pytest.mark.parametrize("exact", [True, False])
def test_what_the_policy_does_not_meet_is_not_refused(exact: bool) -> None:
    """An action not taken, and a state that is over today, would matter if they were met."""

    def build(at: Any) -> MDP:
        t = at["t"]
        rows = [
            (0, 0, [(1, 1, 1 + 3 * t)]),
            (0, 1, [(1 - t, 2, 0), (t, 3, 0)] if t else [(1, 2, 0)]),
            *((1, a, [(1, 2, 2)]) for a in range(2)),
            (2, 0, [(1, 2, 0)]),
            (3, 0, [(1, 3, 1)]),
            (3, 1, [(1, 2, 1)]),
        ]
        return MDP.from_outcomes(rows, 1)

    family = Family(parameters=(Parameter(name="t", value=0, low=0, high=1),), build=build)
    slope = gradient(family, policy=[0, 0, 0, 0], exact=exact)["t"].value
    assert slope is not None
    assert float(slope.value) == 3
    with pytest.raises(ModelError, match="leads to a state whose total may be infinite") as caught:
        gradient(family, policy=[1, 0, 0, 0], exact=exact)
    assert caught.value.where == "parameter t, state 0, action 1"

    def begin(at: Any) -> MDP:
        t = at["t"]
        rows = [(0, 0, [(1, 2, 1 + t)]), (0, 1, [(1, 1, 0)])]
        rows += [(1, a, [(1, 1, (a + 1) * t)]) for a in range(2)]
        return MDP.from_outcomes([*rows, (2, 0, [(1, 2, 0)])], "1/2", start=0)

    family = Family(parameters={"t": 0}, build=begin)
    slope = gradient(family, policy={"state 0": "0"}, exact=exact)["t"].value
    assert slope is not None
    assert float(slope.value) == 1
    with pytest.raises(ModelError, match="names no action"):
        gradient(family, policy={"state 0": "1"}, exact=exact)


def test_at_a_tie_states_that_no_best_policy_meets_are_not_refused() -> None:
    """Earn 1 or 1 + t at once; or 0, and then miss the goal with a chance t of 0 today."""

    def build(at: Any) -> MDP:
        t = at["t"]
        rows = [
            (0, 0, [(1, 2, 1)]),
            (0, 1, [(1, 2, 1 + t)]),
            (0, 2, [(1, 1, 0)]),
            (1, 0, [(1 - t, 2, 0), (t, 3, 0)] if t else [(1, 2, 0)]),
            *((s, 0, [(1, s, 0)]) for s in (2, 3)),
        ]
        return MDP.from_outcomes(rows, 1, goal=[2], unreached=-inf, start=0)

    family = Family(parameters=(Parameter(name="t", value=0, low=0, high=1),), build=build)
    each = gradient(family, exact=True)["t"]
    assert each.left is None
    assert each.right is not None
    assert each.right.value == 1
    with pytest.raises(ModelError, match="the optimal value of a state is infinite") as caught:
        gradient(family, exact=False)
    assert (caught.value.where, caught.value.fix) == ("state 3", "ask for exact=True")


def test_a_tie_that_no_best_policy_meets_is_none() -> None:
    """Earn 5 + t and end; both actions of state 1, which costs something to reach, earn 1."""

    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 3, 5 + at["t"])]), (0, 1, [(1, 1, 0)])]
        rows += [(s, a, [(1, 3, 1)]) for s in (1, 2) for a in (0, 1)]
        return MDP.from_outcomes([*rows, (3, 0, [(1, 3, 0)])], 1, start=0)

    each = gradient(Family(parameters={"t": 0}, build=build), exact=False)["t"].value
    assert each is not None
    assert abs(F(each.value) - 1) <= F(each.error) < F(1, 10**12)


def test_a_tie_in_floats_is_refused_with_a_way_out() -> None:
    bets = Family(
        parameters={"t": "1/2"},
        build=lambda at: MDP.from_arrays([[[0, 1], [0, 1]]] * 2, [[at["t"], "1/2"], [0, 0]], 1),
    )
    with pytest.raises(ModelError, match="several actions are optimal") as caught:
        gradient(bets, exact=False)
    assert "state 0" in caught.value.where
    assert "exact=True" in caught.value.fix


@pytest.mark.parametrize("exact", [True, False])
def test_a_policy_may_have_a_name(exact: bool) -> None:
    half = {"state 0": {"0": "1/2", "1": "1/2"}, "state 1": "0"}
    for name, given in (("random", half), ("always:0", [0, 0, 0])):
        found, wanted = (gradient(NAMED, policy=each, exact=exact) for each in (name, given))
        assert not found.reoptimised
        assert found.start_value == wanted.start_value
        for parameter, each in wanted.derivatives.items():
            assert found[parameter].value == each.value


@pytest.mark.parametrize("exact", [True, False])
@pytest.mark.parametrize("side", [-1, 1])
def test_totals_are_finite_on_each_side_of_today_or_refused(side: int, exact: bool) -> None:
    """On one side of 1/2 a run goes with chance (t - 1/2)² to where a policy may stay forever."""

    def build(at: Any) -> MDP:
        t = at["t"]
        apart = max(side * (t - F(1, 2)), F(0)) ** 2
        rows = [
            (0, 0, [(1 - apart, 2, t), (apart, 1, t)] if apart else [(1, 2, t)]),
            (1, 0, [(1, 1, 1)]),
            (1, 1, [(1, 2, 1)]),
            (2, 0, [(1, 2, 0)]),
        ]
        return MDP.from_outcomes(rows, at["g"], start=0)

    def family(discount: object) -> Family:
        t = Parameter(name="t", value="1/2", low=0, high=1)
        g = Parameter(name="g", value=discount, low=0, high=1)
        return Family(parameters=(t, g), build=build, degrees={"t": 2}, breaks={"t": ["1/2"]})

    with pytest.raises(ModelError, match="next to today's value, the total may be infinite"):
        gradient(family(1), policy=[0, 0, 0], names=["t"], exact=exact)
    for discount, policy in ((1, [0, 1, 0]), ("1/2", [0, 0, 0])):
        each = gradient(family(discount), policy=policy, names=["t"], exact=exact)["t"]
        assert each.left is not None
        assert each.right is not None
        assert float(each.left.value) == float(each.right.value) == 1


@pytest.mark.parametrize("side", [-1, 1])
@pytest.mark.parametrize("zeros", [(), (1, 2), (1, 13), (1, 2, 3, 4, 5, 6)])
def test_the_model_next_to_today_has_all_transitions(side: int, zeros: tuple[int, ...]) -> None:
    """A chance that is 0 today, and at some points nearby."""
    today, degree = F(1, 2), 2 + 2 * len(zeros)
    # Of both transitions that move; each place is next to today by k of this many parts of a side.
    parts = 10**6 + 2 * degree
    places = [today + side * F(k, 2 * parts) for k in zeros]

    def chance(t: F) -> F:
        return prod(((t - place) ** 2 for place in places), start=(t - today) ** 2)

    def build(at: Any) -> MDP:
        p = chance(at["t"])
        return MDP.from_outcomes(
            [(0, 0, [(1 - p, 1, 1), (p, 2, 1)] if p else [(1, 1, 1)]), (1, 0, [(1, 1, 0)]),
             (2, 0, [(1, 0, 0)])],
            1,
        )  # fmt: skip

    t = Parameter(name="t", value=today, low=0, high=1)
    family = Family(parameters=(t,), build=build, degrees={"t": degree})
    change = row_change(
        family, "t", Piece(low=F(0), high=F(1), origin=today), family.at({"t": today})
    )
    seen = list[MDP]()

    def is_finite(near: MDP) -> bool:
        seen.append(near)
        return False

    with pytest.raises(ModelError, match="next to today's value"):
        inner._require_finite_side(change, family.at({}), side, family, is_finite)
    (near,) = seen
    # Where discounts are below 1, or transitions are all there today, nothing is looked at.
    for mdp in (family.at({}).with_(discount="1/2"), family.at({"t": today + side * F(1, 3)})):
        inner._require_finite_side(change, mdp, side, family, is_finite)
    assert len(seen) == 1
    first = next(k for k in range(1, 10) if k not in zeros)
    assert rows_of(near)[0][3].get(2, F(0)) == chance(today + side * F(first, 2 * parts)) > 0


@pytest.mark.parametrize("today", [0, 1])
def test_bounds_hold_where_the_discount_is_next_to_1(today: int) -> None:
    """t at each step from the second on: γ / (1 - γ), in which 1 - γ is known to few digits."""
    missed = 0
    for k in range(1, 40):
        discount = 1 - F(k, 3 * 2**30)

        def build(at: Any, discount: F = discount) -> MDP:
            return MDP.from_outcomes([(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, at["t"])])], discount)

        found = gradient(Family(parameters={"t": today}, build=build), exact=False)["t"].value
        assert found is not None
        off = abs(F(found.value) - discount / (1 - discount))
        assert off <= F(found.error)
        missed += off > F(found.value) / 10**9
        assert found.error < found.value / 10**4
    # A state that is terminal today is visited 1 / (1 - γ) times, where digits are lost indeed.
    assert (missed > 3) == (today == 0)


def test_the_bound_is_the_sum_of_what_each_error_may_do() -> None:
    """The formula at the top of the module, in fractions, of a policy that is held fixed."""
    for discount in ("1/2", "99/100", 1):
        base = LOOP.with_(discount=discount)
        family = moving(base, {"stay": [(0, 0)]}, {"reward.4": 4})
        names = ["stay", "reward.4", *(["discount"] if discount != 1 else [])]
        found = gradient(family, policy=[0, 0, 0], names=names, exact=False)
        own = evaluate(base, [0, 0, 0])
        visits = own.chain.discounted.visits
        rate, rows = base.discount_exact, rows_of(base)
        stay = 1 / (1 - rate) if rate != 1 else F(1)
        pairs = {0: 0, 1: 2, 2: 3}  # of states, the pairs that the policy takes
        moves: dict[str, dict[int, dict[int, F]]] = {"reward.4": {}}
        # A share of 1 more to stay takes from the others in proportion.
        moves["stay"] = {0: {0: F(1), 1: F(-1, 2), 2: F(-1, 2)}}
        moves["discount"] = {pair: {to: p / rate for to, p in rows[pair][3].items()}
                             for pair in pairs.values()}  # fmt: skip
        for name in names:
            gained = {0: F(1, 4)} if name == "reward.4" else {}
            bound = F(0)
            for state, pair in pairs.items():
                own_stay = stay if state == 2 and rate != 1 else F(1)
                seen = F(float(visits.value[state])) * own_stay
                doubt = F(float(visits.error[state])) * own_stay
                size, off = gained.get(pair, F(0)), F(0)
                for to, p in moves[name].get(pair, {}).items():
                    size += abs(rate * p) * abs(F(float(own.value[to])))
                    off += abs(rate * p) * F(float(own.error[to]))
                bound += doubt * size + (seen + doubt) * off
            number = found[name].value
            assert number is not None
            assert bound <= F(number.error) <= bound + F(1, 10**10)


def test_a_checked_number_compares_as_the_number_that_was_checked() -> None:
    third = Checked(number=Certified(value=F(-1, 3)), points=7)
    assert (third < 0, third >= F(-1, 3), third > -0.25) == (True, True, False)
    assert abs(third) == Checked(number=Certified(value=F(1, 3)), points=7)
    assert abs(abs(third)) == abs(third)
    assert f"{third:.2f} {float(third):.1f}" == "-0.33 -0.3"
    assert str(third) == "-1/3 (checked: the degree holds at 7 points, and is not proven)"
    nothing = Checked(number=Bounded(value=0.0, error=0.5), points=7)
    assert abs(nothing) is nothing
    near = Checked(number=Bounded(value=1.0, error=0.5), points=7)
    assert third < near < 2
    with pytest.raises(ModelError, match="does not decide") as caught:
        near.__lt__(1)
    assert "float(number)" in caught.value.fix


@pytest.mark.parametrize(("discount", "of_uses"), [(1, 4 + 1), ("1/2", (8 + 1) * 2)])
def test_the_bound_counts_each_rounding(discount: object, of_uses: int, monkeypatch: Any) -> None:
    """With a unit of 1/16 and numbers that are exact, each rounding that is counted shows.

    A use is a product with a weight of one rounding, and below discount 1 a share of 1 - γ = 1/2.
    The derivative is a sum of two pairs, and its terms are rows of one product.
    """
    unit = F(1, 16)
    monkeypatch.setattr(inner, "gamma", lambda terms: terms * float(unit))

    def build(at: Any) -> MDP:
        paid = at["t"], at["t"] ** 2 - 2 * at["t"]  # the second does not move at first
        return MDP.from_outcomes(
            [(0, 0, [(1, 1, paid[0])]), (1, 0, [(1, 1, paid[1] + 1)])], discount
        )

    family = Family(parameters={"t": 1}, build=build, degrees={"t": 2})
    number = gradient(family, policy=[0, 0], exact=False)["t"].value
    assert number is not None
    doubt = of_uses * unit
    bound = doubt + (2 * 1 + 2 + 8) * unit * (1 + doubt)
    assert number.value == 1
    assert bound <= F(number.error) <= bound * (1 + F(1, 2**19))


def test_a_reward_that_does_not_move_at_first_has_a_derivative_of_0() -> None:
    def build(at: Any) -> MDP:
        return MDP.from_outcomes([(0, 0, [(1, 1, at["t"] ** 2)]), (1, 0, [(1, 1, 0)])], 1)

    family = Family(parameters={"t": 0}, build=build, degrees={"t": 2})
    number = gradient(family, exact=False)["t"].value
    assert number is not None
    assert number.value == 0 < number.error < 1e-290  # what products may lose by underflow


@pytest.mark.parametrize("exact", [True, False])
def test_an_average_has_derivatives_too(exact: bool) -> None:
    """g = r q / (p + q), whatever the discount."""
    p, q, r = F(1, 3), F(1, 5), F(7)
    family = Family(parameters={"p": p, "q": q, "r": r}, build=two_states)
    slopes = {"p": -r * q / (p + q) ** 2, "q": r * p / (p + q) ** 2, "r": q / (p + q)}
    for policy in ("optimal", [0, 0]):
        found = gradient(family, criterion="average", exact=exact, policy=policy)
        assert found.criterion == "average"
        assert found.reoptimised == (policy == "optimal")
        assert [*found.derivatives] == ["p", "q", "r"]
        for name, slope in slopes.items():
            number = found[name].value
            assert number is not None
            assert abs(F(number.value) - slope) <= F(number.error) < F(1, 10**12)
        given = gradient(family, criterion="average", exact=exact, policy=policy, names=["r"])
        assert [*given.derivatives] == ["r"]
    mdp = family.at({})
    assert [*gradient(mdp, criterion="average", exact=exact, names=["discount"]).derivatives] == [
        "discount"
    ]
    assert "discount" not in gradient(mdp, criterion="average", exact=exact).derivatives
