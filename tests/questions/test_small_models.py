"""Small models of which an analysis once forgot part of the question."""

import pickle
from copy import deepcopy
from fractions import Fraction as F
from math import inf
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from exact_mdp import (
    MDP,
    Column,
    Family,
    ModelError,
    Parameter,
    Policy,
    Scenario,
    StateSpace,
    best_cvar,
    best_policy,
    certify,
    check,
    cost_effectiveness,
    curve,
    error_costs,
    evaluate,
    gradient,
    independent,
    moving,
    one_way,
    parametric,
    psa,
    return_distribution,
    robust,
    simulate,
    solve,
    study,
    tornado,
    tradeoff,
)

# ---- a run that ends outside the goal is worth +∞ ------------------------------------------------


def beside_the_goal() -> MDP:
    """Action 0 costs 5 and arrives with 1/2, action 1 costs 1 and ends outside the goal."""
    rows = [
        (0, 0, [("1/2", 1, 5), ("1/2", 0, 5)]),
        (0, 1, [(1, 2, 1)]),
        (1, 0, [(1, 1, 0)]),
        (2, 0, [(1, 2, 0)]),
    ]
    return MDP.from_outcomes(rows, labels={"goal": [1]}, sense="min")


def test_a_curve_leaves_out_what_may_miss_the_goal() -> None:
    asked = beside_the_goal().until("goal")
    line = curve(asked, "reward.5", (4, 6), policy=[0, 0, 0])
    assert [line.at(4), line.at(6)] == [8, 12]
    assert line.violations() == []
    for policy in ([1, 0, 0], "random"):
        with pytest.raises(ModelError, match="the policy held fixed may miss the goal"):
            curve(asked, "reward.5", (4, 6), policy=policy)
    with pytest.raises(ModelError, match="outside the goal"):
        curve(asked.with_(start=2), "reward.5", (4, 6))


def test_a_study_knows_the_goal() -> None:
    asked = beside_the_goal().until("goal")
    table = one_way(asked, "reward.5", (4, 6), policy=[0, 0, 0], points=2).table
    assert table.optimal == pytest.approx([8, 12], abs=1e-12)
    assert table.fixed[:, 0] == pytest.approx([8, 12], abs=1e-12)
    with pytest.raises(ModelError, match="infinite"):
        study(asked, {"reward.5": [5]}, [[1, 0, 0]])


def test_a_gradient_beside_the_goal_is_refused_and_one_that_arrives_is_right() -> None:
    asked = beside_the_goal().until("goal")
    for exact in (True, False):
        held = gradient(asked, policy=[0, 0, 0], names=["reward.5"], exact=exact)
        assert float(held["reward.5"].value.value) == pytest.approx(2, abs=1e-12)
        with pytest.raises(ModelError, match="outside the goal"):
            gradient(asked, policy=[1, 0, 0], names=["reward.5"], exact=exact)


def test_a_gradient_of_the_optimum_leaves_out_what_may_miss_the_goal() -> None:
    asked = beside_the_goal().until("goal")
    best = gradient(asked, names=["reward.5"])
    assert best["reward.5"].value.value == 2
    with pytest.raises(ModelError, match="infinite, and floats cannot compare") as refused:
        gradient(asked, names=["reward.5"], exact=False)
    assert refused.value.fix == "ask for exact=True"


def test_the_best_policy_does_not_end_beside_the_goal() -> None:
    asked = beside_the_goal().until("goal")
    best = best_policy(asked, [])
    assert (best.actions, best.value.value) == ({"all states": "0"}, pytest.approx(10))
    lost = best_policy(asked.with_(start=2), [])
    assert (lost.value.value, lost.upper_bound, lost.proven) == (inf, inf, True)


def test_a_robust_policy_does_not_end_beside_the_goal() -> None:
    asked = beside_the_goal().until("goal")
    held = robust(asked, policy=[1, 0, 0])
    assert (held.worst.value, held.best.value) == (inf, inf)
    assert held.robust.start.value == pytest.approx(5 / 0.4)
    assert held.optimistic.start.value == pytest.approx(5 / 0.6)
    lost = robust(asked.with_(start=2))
    assert (lost.robust.start.value, lost.price, lost.gain) == (inf, None, None)


def test_values_of_states_that_are_not_reached_know_the_goal() -> None:
    rows = [(0, 0, [(1, 1, 5)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 3, 7)]), (3, 0, [(1, 3, 0)])]
    asked = MDP.from_outcomes(rows, labels={"goal": [1]}).until("goal")
    assert evaluate(asked, [0, 0, 0, 0]).value.tolist() == [5, 0, inf, inf]


# ---- another discount of a model that answers a question -----------------------------------------


@pytest.mark.parametrize("saved", [False, True])
def test_the_goal_is_set_at_discount_1_and_dropped_below(tmp_path: Path, *, saved: bool) -> None:
    mdp = beside_the_goal()
    below = mdp.with_(discount="9/10").until("goal")
    if saved:
        below.save(tmp_path / "below.npz")
        below = MDP.load(tmp_path / "below.npz")
    assert below.goal is None
    assert below.with_(discount=1) == mdp.until("goal")
    assert certify(below.with_(discount=1)).value.tolist() == [10, 0, inf]
    proof = certify(mdp.until("goal").with_(discount="9/10"))
    assert (proof.value.tolist(), proof.violations()) == (certify(below).value.tolist(), [])
    assert mdp.until("goal").with_(goal=None).with_(discount="1/2").with_(discount=1).goal is None
    assert below.negated().with_(discount=1).goal is not None
    assert below.within(2).with_(discount=1) == mdp.until("goal").within(2)


def test_a_curve_by_the_discount_does_not_pass_over_the_goal_at_1() -> None:
    asked = beside_the_goal().with_(discount="9/10").until("goal")
    assert curve(asked, "discount", ("1/2", "9/10")).at("1/2") == 1
    with pytest.raises(ModelError, match="outside the range"):
        curve(asked, "discount", ("1/2", 1)).at(1)


def test_a_goal_belongs_to_discount_1() -> None:
    with pytest.raises(ModelError, match="a goal needs discount 1"):
        beside_the_goal().with_(discount="1/2", goal=[False, True, False])


# ---- components that differ between outcomes of a pair -------------------------------------------


def by_outcome(end: int = 1) -> MDP:
    """One component differs between outcomes, and the other is 0."""
    rows = [(0, 0, [("1/2", 1, {"x": 2, "y": 0}), ("1/2", end, {"x": 0, "y": 0})])]
    rows += [(1, 0, [(1, end, {"x": 0, "y": 0})])]
    rows += [(2, 0, [(1, 1, {"x": 0, "y": 0})])] * (end == 2)
    return MDP.from_outcomes(rows, labels={"end": [end]})


@pytest.mark.parametrize("name", [None, "mdp.npz", "mdp.umb", "model.json"])
def test_the_law_of_a_component_is_that_of_its_outcomes(tmp_path: Path, name: str | None) -> None:
    mdp = by_outcome()
    if name is not None:
        mdp.save(tmp_path / name)
        mdp = MDP.load(tmp_path / name)
    asked = mdp.until("end", reward="x")
    law = return_distribution(asked, [0, 0], exact=True)
    assert dict(zip(law.values, law.exact, strict=True)) == {0: F(1, 2), 2: F(1, 2)}
    assert float(evaluate(asked, [0, 0]).sd) == pytest.approx(1)
    assert best_cvar(asked, "1/2").value == 0


def test_a_component_follows_the_rows_that_move() -> None:
    asked, whole = by_outcome(2).until("end", reward="x"), by_outcome(2).until("end")
    for one, other in ((robust(asked).worst, robust(whole).worst),):
        assert one.value == pytest.approx(other.value)
    assert psa(asked, 3).frame()["value"].tolist() == psa(whole, 3).frame()["value"].tolist()
    family = moving(asked, {"p": [((0, 0), 1)]})
    assert gradient(family, names=["p"])["p"].value.value == 2  # E x = 2 p


def test_components_of_a_row_that_moves_are_kept_by_outcome() -> None:
    rows = [
        (0, 0, [("1/2", 0, {"qaly": 2, "cost": -2}), ("1/2", 1, {"qaly": 0, "cost": 0})]),
        (1, 0, [(1, 1, 0)]),
    ]
    family = moving(MDP.from_outcomes(rows, "1/2"), {"p": [((0, 0), 0)]})
    front = tradeoff(family.at({"p": "1/4"}), ["qaly", "cost"])
    assert front.vertices == [(F(4, 7), F(-4, 7))]  # V = 2 p + p/2 V
    draws = pd.DataFrame({"p": [0.25]})
    found = cost_effectiveness(family, {"it": [0, 0]}, uncertain=draws)
    assert found.effect == pytest.approx(4 / 7)


def test_a_component_of_a_scenario_has_a_mean_and_no_law(tmp_path: Path) -> None:
    mdp = Scenario.load("tea").with_(discount=1).compile()
    mdp.save(tmp_path / "tea.npz")
    for model in (mdp, MDP.load(tmp_path / "tea.npz")):
        asked = model.until("end", reward="anxiety")
        own = evaluate(asked, "random")
        assert own.mean == pytest.approx(evaluate(mdp, "random").components["anxiety"])
        assert np.isnan(own.sd)
        assert "only the mean" in own.quantiles_missing
        for ask in (
            lambda mdp: return_distribution(mdp, "random"),
            lambda mdp: simulate(mdp, "random", 10, 0),
            lambda mdp: best_cvar(mdp, "1/2"),
            lambda mdp: psa(mdp, 2),
            robust,
        ):
            with pytest.raises(ModelError, match="only the mean of each pair is known"):
                ask(asked)


def test_two_outcomes_that_differ_in_their_components_are_two() -> None:
    rows = [
        (0, 0, [("1/2", 1, {"x": 3, "y": 1}), ("1/2", 1, {"x": 1, "y": 3})]),
        (1, 0, [(1, 1, 0)]),
    ]
    mdp = MDP.from_outcomes(rows, labels={"end": [1]})
    assert certify(mdp).start_value == 4
    law = return_distribution(mdp.until("end", reward="x"), [0, 0])
    assert law.values == (1, 3)
    assert mdp.components[0].tolist() == [2, 2]


@pytest.mark.parametrize("form", ["dictionary", "array", "outcomes"])
def test_components_by_next_state_are_kept_so_in_every_form(form: str) -> None:
    labels = {"end": [1, 2]}
    if form == "dictionary":
        P = {0: {0: {1: "1/2", 2: "1/2"}}, 1: {0: {1: 1}}, 2: {0: {2: 1}}}
        x = {0: {0: {1: 4, 2: 0}}, 1: {0: 0}, 2: {0: 0}}
        mdp = MDP.from_arrays(P, {0: 2, 1: 0, 2: 0}, components={"x": x}, labels=labels)
    elif form == "array":
        rows = [[[0, "1/2", "1/2"], [0, 1, 0], [0, 0, 1]]]
        x = np.array([[[0, 4, 0], [0, 0, 0], [0, 0, 0]]])
        mdp = MDP.from_arrays(rows, [2, 0, 0], components={"x": x}, labels=labels)
    else:
        outcomes = [
            (0, 0, [("1/2", 1, 2), ("1/2", 2, 2)]),
            (1, 0, [(1, 1, 0)]),
            (2, 0, [(1, 2, 0)]),
        ]
        mdp = MDP.from_outcomes(outcomes, components={"x": [[4, 0], 0, 0]}, labels=labels)
    assert mdp.components[:, 0].tolist() == [2, 0, 0]
    law = return_distribution(mdp.until("end", reward="x"), [0, 0, 0], exact=True)
    assert dict(zip(law.values, law.exact, strict=True)) == {0: F(1, 2), 4: F(1, 2)}


# ---- ends with several actions -------------------------------------------------------------------


def earns_around_zero(order: int = 1) -> Family:
    """State 1 earns p or -p for ever, and is an end today."""

    def build(at: dict[str, F]) -> MDP:
        p = order * at["p"]
        rows = [(0, 0, [(1, 1, 0)]), (1, 0, [(1, 1, p)]), (1, 1, [(1, 1, -p)])]
        return MDP.from_outcomes(rows, "1/2", actions=["x", "y"])

    return Family(parameters={"p": 0}, build=build)


@pytest.mark.parametrize("order", [1, -1])
def test_a_gradient_where_an_end_begins_to_earn(order: int) -> None:
    derivative = gradient(earns_around_zero(order))["p"]
    assert (derivative.left.value, derivative.right.value) == (-1, 1)
    with pytest.raises(ModelError, match="ask for exact=True"):
        gradient(earns_around_zero(order), exact=False)


def test_a_gradient_is_exact_where_floats_cannot_tell_actions_apart() -> None:
    """A ring of 70 states: too many to be exact by default, but a tie needs it."""

    def build(at: dict[str, F]) -> MDP:
        rows = [(s, 0, [("1/2", (s + 1) % 70, 1), ("1/2", s, 1)]) for s in range(70)]
        return MDP.from_outcomes([*rows, (0, 1, [("1/2", 1, at["p"]), ("1/2", 0, 1)])], "9/10")

    derivative = gradient(Family(parameters={"p": 1}, build=build))["p"]
    assert derivative.left.value == 0
    assert derivative.right.value > 0
    assert isinstance(derivative.right.value, F)


def test_a_policy_held_fixed_says_what_it_does_where_a_state_begins() -> None:
    family, silent = earns_around_zero(), {"0": "x"}
    for ask in (
        lambda: gradient(family, policy=silent),
        lambda: gradient(family, policy=silent, exact=False),
        lambda: curve(family, "p", (-1, 1), policy=silent),
        lambda: study(family, {"p": [1]}, [silent]),
        lambda: study(family, {"p": [1]}),  # today's optimum says nothing of an end either
        lambda: tornado(family, policy=silent, ranges={"p": (-1, 1)}),
    ):
        with pytest.raises(ModelError, match="names no action in a state"):
            ask()
    assert study(family, {"p": [1]}, [{"0": "x", "1": "y"}]).fixed.tolist() == [[-1]]


def test_the_best_policy_may_do_anything_where_all_is_over() -> None:
    space = StateSpace(columns=(Column(name="c", size=2), Column(name="x", size=2)))
    rows = [
        *((0, 0, [(1, 1, 5)]), (0, 1, [(1, 1, 1)]), (1, 1, [(1, 1, 0)])),
        *((1, 2, [(1, 1, 0)]), (2, 0, [(1, 2, 0)]), (3, 0, [(1, 3, 0)])),
    ]
    mdp = MDP.from_outcomes(rows, space=space, actions=["a", "b", "c"])
    assert best_policy(mdp, ["c"]).value.value == pytest.approx(5)
    columns = StateSpace(columns=space.columns[:1])
    policy = Policy(space=columns, actions=mdp.actions, rule=np.array([0, 0]))
    assert check(mdp, policy).passed


# ---- what is counted for ever, and what is one row -----------------------------------------------


def test_what_an_end_counts_for_ever_is_not_dropped() -> None:
    def build(at: dict[str, F]) -> MDP:
        rows = [(0, 0, [(1, 1, 5 * at["c"])]), (1, 0, [(1, 1, 0)])]
        return MDP.from_outcomes(rows, components={"qaly": [3, 2], "cost": [2, -2]})

    family = Family(parameters={"c": 1}, build=build)
    with pytest.raises(ModelError, match="a total is infinite"):
        cost_effectiveness(family, {"p": [0, 0]}, uncertain=pd.DataFrame({"c": [1.0]}))


def years() -> MDP:
    parts = {"qaly": [[1], [0]], "cost": [[5], [0]]}
    return MDP.from_arrays([[[0.9, 0.1], [0, 1]]], [1, 0], layout="ass", components=parts)


def test_the_rows_of_all_years_are_one_row() -> None:
    mdp = years().within(20)
    assert psa(mdp, 5).table.names == psa(years().with_(discount="1/2"), 5).table.names
    effect = cost_effectiveness(mdp, {"x": "always:0"}, 300).effect

    def build(at: dict[str, F]) -> MDP:
        parts = {"qaly": [[1], [0]], "cost": [[5], [0]]}
        rows = [[[1 - at["p"], at["p"]], [0, 1]]]
        return MDP.from_arrays(rows, [1, 0], layout="ass", components=parts).within(20)

    one = Family(parameters=(Parameter(name="p", value="1/10", low=0, high=1),), build=build)
    assert effect.std() == pytest.approx(
        cost_effectiveness(one, {"x": "always:0"}, 300).effect.std(), rel=0.15
    )


@pytest.mark.parametrize(
    "change",
    [
        lambda mdp: mdp.within(3).with_(start={"time 0, state 1": 1}),
        lambda mdp: mdp.within(3).with_(sense="min", name="other"),
        lambda mdp: mdp.with_(discount="9/10").until("end").within(3),
        lambda mdp: mdp.with_(discount="9/10").within(3).until("end"),
        lambda mdp: mdp.reaching("end").within(3),
        lambda mdp: mdp.within(3).negated(),
        lambda mdp: mdp.within(3).with_(discount="1/2"),
        lambda mdp: mdp.within(3, terminal_value=[1, 2]),
    ],
)
def test_the_parameters_of_a_question_are_those_of_the_model(change) -> None:
    mdp = years().with_(labels={"end": [1]})
    asked = change(mdp)
    assert psa(asked, 2).table.names == ("(state 0, 0): to state 1",)
    assert study(asked, {"discount": [asked.discount]}).optimal == pytest.approx(
        [solve(asked).start.value]
    )


def test_a_discount_after_a_question_is_that_of_the_model() -> None:
    asked = years().within(3).with_(discount="1/2")
    values = one_way(asked, "discount", (0, "1/2"), points=2).table.optimal
    assert values == pytest.approx([1, 1 + 0.45 + 0.45**2])


def test_a_model_that_was_unrolled_before_it_was_saved_is_not_drawn_by_year(tmp_path: Path) -> None:
    years().within(20).save(tmp_path / "years.npz")
    with pytest.raises(ModelError, match="alike at every time") as refused:
        psa(MDP.load(tmp_path / "years.npz"), 3)
    assert "--horizon 20" in str(refused.value)


# ---- other orders of the same --------------------------------------------------------------------


def test_a_question_about_negated_costs_is_that_about_costs() -> None:
    rows = [(0, 0, [(1, 0, -1)]), (0, 1, [(1, 1, -2)]), (1, 0, [(1, 1, 0)])]
    negated = MDP.from_outcomes(rows, labels={"goal": [1]}).negated()
    rows = [(0, 0, [(1, 0, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])]
    costs = MDP.from_outcomes(rows, labels={"goal": [1]}, sense="min")
    for mdp in (negated, costs):
        assert certify(mdp.until("goal")).start_value == 2
        assert certify(mdp.until("goal").negated()).start_value == -2


def two_steps() -> MDP:
    rows = [(0, 0, [(1, 1, {"a": 1, "b": 10})]), (0, 1, [(1, 2, {"a": 2, "b": 0})])]
    rows += [(state, 0, [(1, 1, {"a": 0, "b": 0})]) for state in (1, 2)]
    return MDP.from_outcomes(rows, "1/2", labels={"goal": [1]})


def test_a_component_does_not_earn_what_states_are_worth_at_the_horizon(tmp_path: Path) -> None:
    paid = two_steps().within(1, terminal_value={2: 100})
    assert paid.component_names == ("a", "b", "terminal value")
    paid.save(tmp_path / "paid.npz")
    for mdp in (paid, MDP.load(tmp_path / "paid.npz")):
        values = [
            certify(mdp.until("goal", reward=name)).start_value
            for name in ("a", "b", "terminal value")
        ]
        assert values == [2, 10, 50]


def test_what_states_are_worth_at_the_horizon_follows_the_discount() -> None:
    paid = two_steps().within(2, terminal_value={0: 0, 2: 8})
    assert certify(paid.with_(discount=1)) is not None
    again = two_steps().with_(discount=1).within(2, terminal_value={2: 8})
    assert paid.with_(discount=1) == again
    assert paid.with_(discount=1, sense="min") == again.with_(sense="min")
    values = one_way(paid, "discount", ("1/2", 1), points=2).table.optimal
    assert values == pytest.approx([float(certify(m).start_value) for m in (paid, again)])
    with pytest.raises(ModelError, match="unknown parameter 'discount'"):
        gradient(moving(paid, {}), names=["discount"])


def test_a_goal_is_paid_nothing_at_the_horizon() -> None:
    for ask in (
        lambda: two_steps().within(2, terminal_value={1: 8}).until("goal"),
        lambda: two_steps().until("goal").within(2, terminal_value={1: 8}),
        lambda: solve(two_steps().until("goal"), horizon=2, terminal_value={1: 8}),
    ):
        with pytest.raises(ModelError, match="earns no terminal value"):
            ask()
    orders = [
        two_steps().within(2, terminal_value={2: 8}).until("goal"),
        two_steps().until("goal").within(2, terminal_value={2: 8}),
    ]
    one, other = (certify(mdp).start_value for mdp in orders)
    assert one == other


def test_errors_of_perception_cost_as_much_where_rewards_are_costs() -> None:
    mdp = Scenario.load("tea").compile()
    seen = independent([0.9] * 3, [0.8] * 3)
    gained, cost = error_costs(mdp, "optimal", seen), error_costs(mdp.negated(), "optimal", seen)
    assert gained.loss == pytest.approx(cost.loss)
    assert gained.marginal == pytest.approx(cost.marginal)
    assert gained.rates == cost.rates
    assert cost.loss.sum() == pytest.approx(cost.value.value - cost.perfect.value)
    assert "loss (cost)" in cost.frame().columns


def test_means_stay_means_where_rewards_move() -> None:
    rows = [[[0, "1/2", "1/2"], [0, 1, 0], [0, 0, 1]]]
    rewards = [[[0, 0, 10], [0, 0, 0], [0, 0, 0]]]
    parts = {"c": [[3], [0], [0]]}
    labels = {"goal": [1, 2]}
    mdp = MDP.from_arrays(rows, rewards, components=parts, labels=labels, layout="ass")
    asked = mdp.until("goal", reward="c")
    for model in (asked, parametric(asked).at({"reward.3": 4})):
        with pytest.raises(ModelError, match="only the mean of each pair is known"):
            return_distribution(model, [0, 0, 0])


def test_what_components_leave_of_the_reward_is_known_by_outcome_too() -> None:
    rows = [[["1/2", "1/4", "1/4"], [0, 1, 0], [0, 0, 1]]]
    parts = {"c": [[[1, 3, 8], [0, 0, 0], [0, 0, 0]]]}
    labels = {"goal": [1, 2]}
    mdp = MDP.from_arrays(rows, [1, 0, 0], components=parts, layout="ass", labels=labels)
    assert mdp.component_names == ("c", "rest")
    law = return_distribution(mdp.until("goal", reward="c"), [0, 0, 0])
    assert law.values[:2] == (3, 4)
    moved = moving(mdp, {"stay": [(0, 0)]}).at({"stay": "1/3"})
    assert certify(moved.until("goal", reward="c")).start_value == 6  # 1/2 + 11/2


def test_model_json_keeps_what_runs_end_for_below_discount_1(tmp_path: Path) -> None:
    below = beside_the_goal().with_(discount="9/10").until("goal")
    below.save(tmp_path / "model.json")
    read = MDP.load(tmp_path / "model.json")
    assert read.with_(discount=1) == beside_the_goal().until("goal")
    with pytest.raises(ModelError, match="already answers a question"):
        read.until("goal")
    by_outcome().until("end", reward="x").save(tmp_path / "model.json")
    assert MDP.load(tmp_path / "model.json").component_names == ("x",)


@pytest.mark.parametrize("asked", [lambda m: m.until("goal"), lambda m: m.reaching("goal")])
def test_an_average_has_no_target(asked) -> None:
    mdp = asked(beside_the_goal())
    for ask in (
        lambda: certify(mdp, criterion="average"),
        lambda: solve(mdp, criterion="average"),
        lambda: evaluate(mdp, "random", criterion="average"),
        lambda: check(mdp, "random", criterion="average"),
    ):
        with pytest.raises(ModelError, match="has no target"):
            ask()


def test_copies_know_what_they_were_asked_of() -> None:
    for copied in (pickle.loads(pickle.dumps(years().within(3))), deepcopy(years().within(3))):
        assert len(psa(copied, 2).table.names) == 1


def test_a_value_at_which_a_state_is_over_is_refused_under_a_horizon() -> None:
    rows = [(0, 0, [(1, 1, 10)]), (1, 0, [(1, 1, 2)]), (1, 1, [(1, 1, 2)])]
    mdp = MDP.from_outcomes(rows, "1/2")
    values = one_way(mdp, "reward.2", (0, 2), points=3).table.optimal
    assert values == pytest.approx([10, 11, 12])
    with pytest.raises(ModelError, match="a state in which the episode is over has one action"):
        one_way(mdp.within(3), "reward.2", (0, 2), points=3)
    values = one_way(mdp.within(3), "reward.2", (1, 2), points=2).table.optimal
    assert values == pytest.approx([10.75, 11.5])


def test_a_component_that_misses_the_reward_by_less_than_floats_can_tell_is_a_mean() -> None:
    small = F(1, 10**30)
    rows = [(0, 0, [("1/2", 1, 1 + small), ("1/2", 1, 1 - small)]), (1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, components={"x": [1, 0]}, labels={"end": [1]})
    assert mdp.table.averaged
    assert certify(mdp.until("end")).start_value == 1


def test_another_discount_of_a_probability_is_kept() -> None:
    asked = two_steps().within(2, terminal_value={2: 8}).reaching("goal")
    assert asked.with_(discount="1/2").discount == 0.5
    assert certify(asked).start_value == certify(two_steps().within(2).reaching("goal")).start_value


def test_a_curve_is_refused_where_a_state_of_a_horizon_is_over_at_one_end() -> None:
    """At x = 1 state 0 is never left and earns nothing: it then stays at its time."""
    rows = [(0, 0, [("1/3", 0, 0), ("2/3", 1, 0)]), (1, 0, [(1, 2, 5)]), (2, 0, [(1, 2, 0)])]
    mdp = moving(MDP.from_outcomes(rows), {"x": [((0, 0), 0)]})
    asked = mdp.with_question(lambda m: m.within(3))
    with pytest.raises(ModelError, match="over in a state that is left at other values") as refused:
        curve(asked, "x", (0, 1))
    assert "x = 1" in refused.value.where
    line = curve(asked, "x", (0, "9/10"))
    assert line.violations() == []
    for x in (F(0), F(1, 4), F(9, 10)):
        # Left after one step or after two, in time to earn 5.
        assert line.at(x) == certify(asked.at({"x": x})).start_value == 5 * (1 - x) * (1 + x)
