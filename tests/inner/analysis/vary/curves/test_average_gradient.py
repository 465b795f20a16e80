"""Derivatives of averages: closed forms, and differences of proven averages beside today."""

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction as F
from random import Random
from typing import Any

import numpy as np
import pytest
from average_models import average_of, moved_family, random_rows, sure_rows, two_states

from exact_mdp import MDP, Family, ModelError, Parameter, evaluate, gradient
from exact_mdp.analysis.vary.curves import average_gradient
from exact_mdp.solvers.bounds.gains import BoundedVector
from exact_mdp.solvers.claims import Bounded, Certified, Claim
from exact_mdp.solvers.values.average import evaluate_average
from exact_mdp.solvers.values.policy_chain import PolicyChain

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
    mean = pytest.approx(float(3 * share + 1 - share))
    assert evaluate(build({"t": t, "r": F(3)}), [0, 0, 0], criterion="average").mean == mean
    assert float(gradient(family, criterion="average", exact=exact).start.value) == mean


@EXACTLY
@pytest.mark.parametrize("policy", ["optimal", [0, 0, 0]])
def test_an_average_does_not_move_with_the_discount(exact: bool, policy: Any) -> None:
    rows = [(0, 0, [("1/2", 0, 3), ("1/2", 1, 2)]), (1, 0, [(1, 2, 5)]), (2, 0, [(1, 1, 1)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    slope = gradient(mdp, criterion="average", policy=policy, names=["discount"], exact=exact)
    found = slope["discount"].value
    assert found is not None
    assert abs(found.value) <= getattr(found, "error", 0)


@EXACTLY
@pytest.mark.parametrize("policy", ["optimal", [0, 0]])
def test_a_discount_may_move_with_the_chances(exact: bool, policy: Any) -> None:
    """g = q / (t + q) at discount t."""

    def build(at: Any) -> MDP:
        return two_states({"p": at["t"], "q": F(1, 5), "r": 1}).with_(discount=at["t"])

    value, error = slope_of(family_of(build, t="1/3"), "t", exact=exact, policy=policy)
    assert abs(value + F(1, 5) / F(8, 15) ** 2) <= error < F(1, 10**12)


@EXACTLY
def test_a_policy_may_be_silent_where_a_run_has_ended_nearby_too(exact: bool) -> None:
    """State 2 is terminal at t = 0, and state 1 always; the run ends in either of them."""

    def build(at: Any, start: int) -> MDP:
        t = at["t"]
        rows = [(0, 0, [("1/2", 0, 1 + t), ("1/2", 1, 1 + t)])]
        rows += [(1, a, [(1, 1, 0)]) for a in range(2)]
        return MDP.from_outcomes(rows + [(2, a, [(1, 2, a * t)]) for a in range(2)], start=start)

    for start in (0, 1):
        family = family_of(lambda at, start=start: build(at, start), t=0)
        value, error = slope_of(family, "t", policy={"state 0": "0"}, exact=exact)
        assert abs(value) <= error
    with pytest.raises(ModelError, match="names no action"):
        slope_of(family_of(lambda at: build(at, 2), t=0), "t", policy={"state 0": "0"}, exact=exact)


def test_a_best_policy_may_lose_what_is_earned_once() -> None:
    """max(1, t) at 1: beyond it, the way to t is best, which earns 6 or 1 less once."""

    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 1, 5)]), (0, 1, [(1, 2, -1)])]
        return MDP.from_outcomes([*rows, (1, 0, [(1, 1, 1)]), (2, 0, [(1, 2, at["t"])])])

    def stay_or_go(at: Any) -> MDP:
        rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, at["t"])])]
        return MDP.from_outcomes(rows, start=0)

    for family in (family_of(build, t=1), family_of(stay_or_go, t=1)):
        assert slope_of(family, "t", -1) == (0, 0)
        assert slope_of(family, "t", 1) == (1, 0)
        with pytest.raises(ModelError, match="several actions are optimal"):
            slope_of(family, "t", exact=False)


def test_classes_that_are_never_left_may_have_a_best_action_each() -> None:
    """State 0 earns 1 or 0, and state 1 earns t = 2 or 3/2; a run begins in one of them."""

    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 0)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, "3/2")])]
        return MDP.from_outcomes(rows, start={"state 0": "1/3", "state 1": "2/3"})

    for exact in (True, False):
        value, error = slope_of(family_of(build, t=2), "t", exact=exact)
        assert abs(value - F(2, 3)) <= error + F(1, 10**30)


@EXACTLY
def test_a_reward_that_does_not_move_at_first_has_the_derivative_0(exact: bool) -> None:
    family = Family(
        parameters={"t": 0},
        build=lambda at: MDP.from_outcomes([(0, 0, [(1, 0, at["t"] ** 2)])]),
        degrees={"t": 2},
    )
    value, error = slope_of(family, "t", exact=exact)
    assert abs(value) <= error < 1


def test_the_way_from_one_best_class_to_another_may_cost_something_next_to_today() -> None:
    """max(1, (1 - t) (1 + 2 t)) at 0: going there misses with chance t, and both earn alike."""

    def build(at: Any) -> MDP:
        t = at["t"]
        go = [(1 - t, 1, 1), (t, 2, 1)] if t else [(1, 1, 1)]
        rows = [(0, 0, [(1, 0, 1)]), (0, 1, go), (1, 0, [(1, 1, 1 + 2 * t)]), (2, 0, [(1, 2, 0)])]
        return MDP.from_outcomes(rows, start=0)

    parameters = (Parameter(name="t", value=0, low=0, high=1),)
    family = Family(parameters=parameters, build=build, degrees={"t": 1})
    assert slope_of(family, "t") == (1, 0)


def test_biases_apart_from_each_other_give_no_derivative() -> None:
    """States 1 and 2 earn 1 where they stay; with chance t the pair of state 1 goes to state 2.

    Each of them may go to the other for nothing, so that both are in one end component. If state 2
    earns nothing, the average is 1 / (1 + t).
    """

    def family(second: int) -> Family:
        def build(at: Any) -> MDP:
            t = at["t"]
            stay = [(1 - t, 1, 1), (t, 2, 1)] if t else [(1, 1, 1)]
            rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 2, 0)]), (1, 1, stay), (2, 0, [(1, 1, 0)])]
            rows.append((2, 1, [(1, 2, second)]))
            for state in (3, 4):  # the same again, without t
                rows += [(state, 0, [(1, 7 - state, 0)]), (state, 1, [(1, state, 1)])]
            return MDP.from_outcomes([*rows, (5, 0, [(1, 0, 0)])], start=0)

        t = Parameter(name="t", value=0, low=0, high=1)
        return Family(parameters=(t,), build=build, degrees={"t": 1})

    for exact in (True, False):
        with pytest.raises(ModelError, match="the average may jump") as refused:
            slope_of(family(1), "t", exact=exact)
        assert refused.value.where == "parameter t, state 1, action 1"
        assert "leave it out (names=)" in refused.value.fix
    assert slope_of(family(0), "t") == (-1, 0)


def test_a_tie_has_a_derivative_on_each_side() -> None:
    """max(t, 1/2) at 1/2; in a state that is left either way, the choice does not matter."""

    def build(at: Any) -> MDP:
        rows = [(0, 0, [(1, 1, 4)]), (0, 1, [(1, 1, 5)])]
        rows += [(1, 0, [(1, 1, at["t"])]), (1, 1, [(1, 1, "1/2")]), (2, 0, [(1, 1, 0)])]
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
    for seed in range(6):
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


def tied_family(rng: Random, today: F, sense: str) -> Family:
    """Return a family in which some actions have the same row and reward today, and only today."""
    rows = random_rows(rng, 3)
    for state in range(3):
        if rng.random() < 0.6:
            (_, _, law), action = rng.choice([each for each in rows if each[0] == state]), 2
            rows.append((state, action, law))
    rows.sort(key=lambda row: row[:2])
    drift = [(rng.randrange(3), F(rng.randint(-2, 2))) for _ in rows]

    def build(at: Any) -> MDP:
        moved = []
        for (state, action, law), (_, extra) in zip(rows, drift, strict=True):
            # Two ways to the same row today: from the law towards a state, by t / 4 or today / 4.
            share = (at["t"] if action == 2 else today) / 4
            reward = law[0][2] + extra * (at["t"] - today)
            target = next(drift[k][0] for k, row in enumerate(rows) if row[0] == state)
            changed = [((1 - share) * p, other, reward) for p, other, _ in law]
            moved.append((state, action, [*changed, (share, target, reward)]))
        return MDP.from_outcomes(moved, start={"state 0": "1/3", "state 1": "2/3"}, sense=sense)

    return Family(
        parameters=(Parameter(name="t", value=today, low=0, high=1),), build=build, degrees={"t": 1}
    )


@pytest.mark.parametrize("sense", ["max", "min"])
def test_ties_have_the_slopes_of_both_sides(sense: str) -> None:
    bent = 0
    for seed in range(10):
        today = F(1, 3)
        family = tied_family(Random(f"{sense} {seed}"), today, sense)
        here, slopes = average_of(family.at({})), []
        for side in (-1, 1):
            there = average_of(family.at({"t": today + side * H}))
            value, error = slope_of(family, "t", side)
            assert error == 0
            assert abs(value - (there - here) / (side * H)) < F(1, 10**9)
            slopes.append(value)
        bent += slopes[0] != slopes[1]
    assert bent > 6


def test_where_the_average_jumps_no_derivative_is_given() -> None:
    """And few are refused besides: those whose average does not jump, but might have."""
    jumps, careful, given = 0, 0, 0
    for seed in range(60):
        rng = Random(f"jump {seed}")
        family = moved_family(rng, F(0), rng.choice(("max", "min")), sure_rows(rng))
        held = [rng.randrange(len(family.at({}).pairs_of(s))) for s in range(4)]
        for policy in ("optimal", held)[seed >= 20 :]:
            here, there = (average_of(family.at({"t": t}), policy) for t in (F(0), H))
            jumping = abs(there - here) > F(1, 1000)
            try:
                value, _ = slope_of(family, "t", policy=policy, exact=True)
            except ModelError as refusal:
                if "the average may jump" not in str(refusal):
                    raise
                jumps += jumping
                careful += not jumping
                continue
            assert not jumping
            assert abs(value - (there - here) / H) < F(1, 10**9)
            given += 1
    assert (jumps, careful, given) == (18, 14, 48)


def move_numbers(found: Any, part: str, off: float, rng: Random) -> Any:
    """Return an evaluation of which one part is off, by no more than its error says."""
    signs = np.array([rng.choice((-off, off)) for _ in found.value])
    old = getattr(found, part)
    if part in ("share", "arrivals"):
        return replace(
            found, **{part: BoundedVector(value=old.value + signs, error=old.error + off)}
        )
    error = {"value": "error", "bias": "bias_error"}[part]
    return replace(found, **{part: old + signs, error: getattr(found, error) + off})


@pytest.mark.parametrize("policy", ["optimal", "random"])
def test_the_error_covers_what_the_values_are_off(policy: str, monkeypatch: Any) -> None:
    """Gain, bias, shares and arrivals move within their bounds: so does the slope."""
    answered, off = 0, 2.0**-20
    monkeypatch.setattr(average_gradient, "_find_rivals", lambda *_: np.zeros(4, dtype=bool))
    for seed in range(8):
        rng = Random(f"off {seed}")
        family = moved_family(rng, F(1, 3), "max")
        try:
            exact, _ = slope_of(family, "t", policy=policy, exact=True)
            _, least = slope_of(family, "t", policy=policy, exact=False)
        except ModelError:
            continue
        for part in ("value", "bias", "share", "arrivals"):
            with monkeypatch.context() as patch:
                patch.setattr(
                    average_gradient,
                    "evaluate_average",
                    lambda chain, part=part, rng=rng: move_numbers(
                        evaluate_average(chain), part, off, rng
                    ),
                )
                value, error = slope_of(family, "t", policy=policy, exact=False)
            assert abs(value - exact) <= error
            assert error <= least + 60 * off
            answered += 1
    assert answered > 30


def rivals_of(mdp: MDP, policy: list[int], **moved: Any) -> list[bool]:
    """Return the states in which another action may be as good, with other numbers and errors."""
    chain = PolicyChain.of(mdp, policy)
    found = replace(evaluate_average(chain), **{k: np.array(x) for k, x in moved.items()})
    used = np.zeros(mdp.n_pairs, dtype=bool)
    used[chain.pairs] = True
    return average_gradient._find_rivals(found, used).tolist()


def test_an_action_that_is_as_good_stays_a_rival_as_far_as_errors_go() -> None:
    """Each number is as far off as its error says, all of them against the other action."""
    # The other action of state 0 goes to state 1; both states earn 1, and so all gains are 1.
    rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 1)])]
    two = MDP.from_outcomes(rows)
    assert rivals_of(two, [0, 0], value=[1.75, 0.5], error=[0.75, 0.5]) == [True, False]
    assert rivals_of(two, [0, 0], value=[2.0, 0.5], error=[0.5, 0.25]) == [False, False]
    # From state 0 to 1 or 2 and back, with 2 and 0 or 1 and 1: gain 1, biases 1/2, -1/2 and 1/2.
    rows = [(0, 0, [(1, 1, 2)]), (0, 1, [(1, 2, 1)]), (1, 0, [(1, 0, 0)]), (2, 0, [(1, 0, 1)])]
    three = MDP.from_outcomes(rows)
    value, error = [1.25, 1.0, 1.0], [0.25, 0.0, 0.0]
    bias, doubt = [1.0, -0.5, 0.25], [0.5, 0.0, 0.25]
    held = {"value": value, "error": error}
    assert rivals_of(three, [0, 0, 0], **held, bias=bias, bias_error=doubt) == [True, False, False]
    for k, less in (("bias_error", [0.25, 0, 0.25]), ("error", [0, 0, 0])):
        moved = {**held, "bias": bias, "bias_error": doubt, k: less}
        assert rivals_of(three, [0, 0, 0], **moved) == [False] * 3
    nothing = MDP.from_outcomes([(0, 0, [(1, 0, 0)]), (0, 1, [(1, 0, 0)])])
    still = {name: [0.0] for name in ("value", "error", "bias", "bias_error")}
    assert rivals_of(nothing, [0], **still) == [True]


def test_a_loss_of_bias_is_larger_than_the_roundings_of_two_terms(monkeypatch: Any) -> None:
    """By its other action state 0 loses δ, or 1 - δ with its gain of 1: 4 2^-20 is in doubt.

    Here a unit is 2^-20, two of which count, of 2 in all. State 1, apart, earns 9.
    """
    off = 2.0**-20
    monkeypatch.setattr(average_gradient, "gamma", lambda terms: terms * off)
    for lost, rival in ((3.9 * off, True), (4.1 * off, False)):
        mdp = MDP.from_outcomes(
            [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 0, 1 - lost)]), (1, 0, [(1, 1, 9)])]
        )
        assert rivals_of(mdp, [0, 0]) == [rival, False]


def test_the_bound_counts_each_rounding(monkeypatch: Any) -> None:
    """With a unit of 1/16 and numbers that are exact, each rounding that is counted shows.

    A use is a product with a weight of some roundings; c is a sum of a row of two products, and
    the derivative one of two pairs.
    """
    unit = F(1, 16)
    monkeypatch.setattr(average_gradient, "gamma", lambda terms: terms * float(unit))

    def build(at: Any) -> MDP:
        rewards = (at["t"], 0)
        return MDP.from_outcomes(
            [(s, 0, [("1/2", 0, r), ("1/2", 1, r)]) for s, r in enumerate(rewards)]
        )

    family, mdp = family_of(build, t=1), build({"t": 1})
    value, error = slope_of(family, "t", policy=[0, 0], exact=False)
    doubt = (4 + PolicyChain.of(mdp, [0, 0]).roundings) * unit / 2
    bound = doubt + (2 * 2 + 2 + 8) * unit * (F(1, 2) + doubt)
    assert value == F(1, 2)
    assert bound <= error <= bound * (1 + F(1, 2**18))


def test_the_bound_is_the_sum_of_what_each_error_may_do(monkeypatch: Any) -> None:
    """State 0 is left for state 1 or 2; from state 1 to state 3 and back. All chances move with t.

    In state 0 the gain counts and its error, in states 1 and 3 the bias and the reward 5 t.
    """
    slopes: list[dict[int, int]] = [{0: 1, 1: 2, 2: -3}, {1: 1, 3: -1}, {}, {1: -2, 3: 2}]

    def build(at: Any) -> MDP:
        t = at["t"]
        rows = [(0, 0, [(t, 0, 9 * t), (2 * t, 1, 9 * t), (1 - 3 * t, 2, 9 * t)])]
        rows += [(1, 0, [(t, 1, 5 * t), (1 - t, 3, 5 * t)]), (2, 0, [(1, 2, 4)])]
        return MDP.from_outcomes([*rows, (3, 0, [(1 - 2 * t, 1, 0), (2 * t, 3, 0)])], start=0)

    found = evaluate_average(PolicyChain.of(build({"t": F(1, 4)}), [0] * 4))
    off = dict(zip(("share", "arrivals", "gain", "bias"), 2.0 ** np.arange(-8, -4), strict=True))
    each = {name: off[name] * np.arange(1, 5) for name in off}
    moved = replace(
        found,
        share=BoundedVector(value=found.share.value, error=each["share"]),
        arrivals=BoundedVector(value=found.arrivals.value, error=each["arrivals"]),
        error=each["gain"],
        bias_error=each["bias"],
    )
    monkeypatch.setattr(average_gradient, "evaluate_average", lambda _: moved)
    _, error = slope_of(family_of(build, t="1/4"), "t", policy=[0] * 4, exact=False)
    bound = F(0)
    for state, moves in enumerate(slopes):
        parts = (found.share, "share", found.bias, "bias")
        if state == 0:
            parts = (found.arrivals, "arrivals", found.value, "gain")
        use, of_use, number, of_number = parts
        doubt = F(each[of_use][state])
        size = sum(abs(k) * abs(F(number[to])) for to, k in moves.items()) + 5 * (state == 1)
        loose = sum(abs(k) * F(each[of_number][to]) for to, k in moves.items())
        bound += doubt * size + (F(use.value[state]) + doubt) * loose
    assert bound <= error <= bound * (1 + F(1, 2**18))


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

    # By another action a run may stay: then the average is 1 next to today, too.
    def build_two(at: Any) -> MDP:
        t = at["t"]
        leak = [(1 - t, 0, 1), (t, 1, 1)] if t else [(1, 0, 1)]
        return MDP.from_outcomes([(0, 0, [(1, 0, 1)]), (0, 1, leak), (1, 0, [(1, 1, 0)])])

    stays = Family(parameters=family.parameters, build=build_two)
    with pytest.raises(ModelError, match="the average may jump"):
        slope_of(stays, "t", policy=[1, 0], exact=exact)
    assert slope_of(stays, "t", policy=[0, 0], exact=exact)[0] == 0


def test_what_has_no_average_is_refused() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 0, 1)])], "1/2", labels={"goal": {0}})
    with pytest.raises(ModelError, match="has no horizon"):
        gradient(mdp.within(3), criterion="average")
    with pytest.raises(ModelError, match="has no target"):
        gradient(mdp.until("goal"), criterion="average", policy="random")
    found = gradient(mdp, criterion="average", names=["discount"])["discount"]
    assert (found.value, found.claim) == (Certified(value=F(0)), Claim.CERTIFIED)
    assert "discount" not in gradient(mdp, criterion="average").derivatives
