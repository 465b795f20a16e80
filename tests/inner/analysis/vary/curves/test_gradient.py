"""Derivatives of the start value against differentiated linear systems of every policy."""

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from curved_models import KINDS, CurvedModel, curved_model

from exact_mdp import MDP, Family, ModelError, Parameter, certify, evaluate, gradient, moving
from exact_mdp.analysis.vary.curves import gradient as inner
from exact_mdp.analysis.vary.curves.gradient import Checked
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
    monkeypatch.setattr(inner, "EXACT_TRANSITIONS", 10)
    assert claims(ring(300, line=True)) is Claim.BOUNDED


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


def test_a_checked_number_compares_as_the_number_that_was_checked() -> None:
    third = Checked(number=Certified(value=F(-1, 3)), points=7)
    assert (third < 0, third >= F(-1, 3), third > -0.25) == (True, True, False)
    assert abs(third) == Checked(number=Certified(value=F(1, 3)), points=7)
    assert abs(abs(third)) == abs(third)
    assert f"{third:.2f} {float(third):.1f}" == "-0.33 -0.3"
    near = Checked(number=Bounded(value=1.0, error=0.5), points=7)
    assert third < near < 2
    with pytest.raises(ModelError, match="does not decide") as caught:
        near.__lt__(1)
    assert "float(number)" in caught.value.fix
