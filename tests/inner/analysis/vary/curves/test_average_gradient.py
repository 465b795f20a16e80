"""Derivatives of averages: closed forms, and differences of proven averages beside today."""

from collections.abc import Callable
from fractions import Fraction as F
from random import Random
from typing import Any

import pytest
from average_models import average_of, moved_family, two_states

from exact_mdp import MDP, Family, ModelError, Parameter, evaluate, gradient
from exact_mdp.solvers.claims import Bounded, Certified, Claim

H = F(1, 10**15)
EXACTLY = pytest.mark.parametrize("exact", [True, False])


def family_of(build: Callable[[Any], MDP], **today: object) -> Family:
    parameters = [Parameter(name=name, value=value) for name, value in today.items()]
    return Family(parameters=tuple(parameters), build=build)


def slope_of(family: Family, name: str, side: int = 1, **asked: Any) -> tuple[F, F]:
    """Return the derivative on one side and its error bound."""
    each = gradient(family, criterion="average", names=[name], **asked)[name]
    found = each.right if side > 0 else each.left
    assert found is not None
    number = getattr(found, "number", found)
    return F(number.value), F(getattr(number, "error", 0))


# ---- closed forms --------------------------------------------------------------------------------


@EXACTLY
def test_a_chain_of_two_states(exact: bool) -> None:
    """g = r q / (p + q), whatever the discount."""
    p, q, r = F(1, 3), F(1, 5), F(7)
    family = family_of(two_states, p=p, q=q, r=r)
    found = gradient(family, criterion="average", exact=exact)
    wanted = {"r": q / (p + q), "p": -r * q / (p + q) ** 2, "q": r * p / (p + q) ** 2}
    for name, slope in wanted.items():
        value, error = slope_of(family, name, exact=exact)
        assert abs(value - slope) <= error
        assert error < F(1, 10**12)
        share = slope * {"p": p, "q": q, "r": r}[name] / (r * q / (p + q))
        assert found[name].elasticity == pytest.approx(float(share))
    start = found.start
    assert isinstance(start, Certified if exact else Bounded)
    assert float(start.value) == pytest.approx(float(r * q / (p + q)))
    assert "average reward" in repr(found)
    assert found.report().facts["criterion"].value == "average"


@EXACTLY
def test_a_way_to_one_of_two_classes(exact: bool) -> None:
    """From state 0 a run ends in a class that earns 3, with chance 2 t / (2 t + 1 - 3 t) or 1."""

    def build(at: Any) -> MDP:
        t, r = at["t"], at["r"]
        rows = [(0, 0, [(t, 0, 9), (2 * t, 1, 9), (1 - 3 * t, 2, 9)])]
        rows += [(1, 0, [(1, 1, r)]), (2, 0, [(1, 2, 1)])]
        return MDP.from_outcomes(rows)

    t = F(1, 4)
    family = family_of(build, t=t, r=3)
    share = 2 * t / (1 - t)
    for name, slope in (("t", 2 * 2 / (1 - t) ** 2), ("r", share)):
        value, error = slope_of(family, name, exact=exact)
        assert abs(value - slope) <= error
        assert error < F(1, 10**12)
    assert evaluate(build({"t": t, "r": F(3)}), [0, 0, 0], criterion="average").mean == (
        pytest.approx(float(3 * share + 1 - share))
    )


def test_a_tie_has_a_derivative_on_each_side() -> None:
    """max(t, 1/2) at 1/2; in a state that is left either way, the choice does not matter."""

    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 1, 4)]), (0, 1, [(1, 1, 5)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, "1/2")])]
        return MDP.from_outcomes(rows)

    family = family_of(build, t="1/2")
    assert slope_of(family, "t", -1) == (0, 0)
    assert slope_of(family, "t", 1) == (1, 0)
    with pytest.raises(ModelError, match="ask for exact=True"):
        gradient(family, criterion="average", exact=False)
    sure = family_of(build, t="3/4")
    assert slope_of(sure, "t") == slope_of(sure, "t", -1) == (1, 0)
    value, error = slope_of(sure, "t", exact=False)
    assert abs(value - 1) <= error


def test_costs_have_the_derivatives_of_rewards_turned_round() -> None:
    def build(at: Any, sense: str = "max") -> MDP:
        sign = 1 if sense == "max" else -1
        rows = [(0, 0, [(1, 0, sign * at["t"])]), (0, 1, [("1/2", 0, sign), ("1/2", 1, sign)])]
        rows.append((1, 0, [(1, 0, 0)]))
        return MDP.from_outcomes(rows, sense=sense)

    today = F(2, 3)  # both actions earn 2/3 a step
    rewards = family_of(build, t=today)
    costs = family_of(lambda at: build(at, "min"), t=today)
    for side, slope in ((-1, 0), (1, 1)):
        assert slope_of(rewards, "t", side) == (slope, 0)
        assert slope_of(costs, "t", side) == (-slope, 0)


# ---- random models -------------------------------------------------------------------------------


@pytest.mark.parametrize("sense", ["max", "min"])
@pytest.mark.parametrize("today", [F(1, 3), F(0)])
def test_random_models_beside_differences(sense: str, today: F) -> None:
    """At t = 0 transitions appear: where the average jumps, the derivative is refused."""
    answered, refused = 0, 0
    for seed in range(16):
        rng = Random(f"{sense} {today} {seed}")
        family = moved_family(rng, today, sense)
        held = [rng.randrange(len(family.at({}).pairs_of(s))) for s in range(4)]
        for policy in ("optimal", held):
            here, there = (average_of(family.at({"t": t}), policy) for t in (today, today + H))
            slope = (there - here) / H
            for exact in (True, False):
                try:
                    value, error = slope_of(family, "t", policy=policy, exact=exact)
                except ModelError as refusal:
                    refused += 1
                    if exact and "the average may jump" not in str(refusal):
                        raise
                    continue
                answered += 1
                assert abs(value - slope) <= error + F(1, 10**9)
    assert answered > 4 * refused
    assert refused or today


@EXACTLY
def test_an_average_that_jumps_is_refused(exact: bool) -> None:
    """With any chance t > 0 state 0 is left for good: the average jumps from 1 to 0."""

    def build(at: Any) -> MDP:
        t = at["t"]
        rows = [(0, 0, [(1 - t, 0, 1), (t, 1, 1)] if t else [(1, 0, 1)]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows)

    family = Family(parameters=(Parameter(name="t", value=0, low=0, high=1),), build=build)
    for policy in ("optimal", [0, 0]):
        with pytest.raises(ModelError, match="the average may jump"):
            gradient(family, policy=policy, criterion="average", exact=exact)


def test_what_has_no_average_is_refused() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2", labels={"goal": {0}})
    with pytest.raises(ModelError, match="has no horizon"):
        gradient(mdp.within(3), criterion="average")
    with pytest.raises(ModelError, match="has no target"):
        gradient(mdp.until("goal"), criterion="average", policy="random")
    found = gradient(mdp, criterion="average", names=["discount"])["discount"]
    assert (found.value, found.claim) == (Certified(value=F(0)), Claim.CERTIFIED)
    assert "discount" not in gradient(mdp, criterion="average").derivatives
