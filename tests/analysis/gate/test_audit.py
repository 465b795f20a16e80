"""The audit of a policy: its regret and the price of each state, against rational arithmetic."""

from fractions import Fraction as F
from math import inf
from random import Random
from typing import Any

import numpy as np
import pytest
from care_oracle import ACTIONS, acting, oracle_of
from cases import CASES, Case
from hypothesis import given, settings
from hypothesis import strategies as st
from made_models import forest
from oracle import evaluate_exact, mixed, solve_exact
from strategies import Pairs, Rows, any_models, models, of_case

from exact_mdp import (
    MDP,
    Bounded,
    Certified,
    Claim,
    ModelError,
    Scenario,
    assert_policy_optimal,
    certify,
    check,
    evaluate,
)

CARE = Scenario.load("yuan2025")
SMALL = CARE.with_(tasks=[2], max_trial=2, readings={"influence_orientation": "column-to-row"})


# ---- regret against rational arithmetic ------------------------------------------------------


@settings(max_examples=80)
@given(models(discounts=(F(0), F(1, 2), F(9, 10), F(1))), st.data())
def test_every_number_is_the_reference_s(rows: Rows, data: st.DataObject) -> None:
    offered = {s: [a for t, a, *_ in rows.pairs if t == s] for s in range(rows.n_states)}
    best, optimal = solve_exact(rows.n_states, rows.pairs, rows.discount)
    right = {s: max(actions) for s, actions in enumerate(optimal)}
    any_one = {s: st.sampled_from(actions) for s, actions in offered.items()}
    policy = data.draw(st.just(right) | st.fixed_dictionaries(any_one))
    own = evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy)
    coin = mixed(rows.pairs, {(s, a): F(1, len(offered[s])) for s, a, *_ in rows.pairs})
    even = evaluate_exact(rows.n_states, coin, rows.discount, dict.fromkeys(offered, 0))
    mdp, scale = rows.model(), float(max(1, *map(abs, best), *map(abs, own)))
    for learned, value in (("random", even), ([policy[s] for s in range(rows.n_states)], own)):
        audit, bounded = (check(mdp, learned, exact_values=exact) for exact in (None, False))
        lost = best[0] - value[0]
        assert (audit.claim, audit.passed) == (Claim.CERTIFIED, lost == 0)
        for name, truth in (("optimal", best[0]), ("learned", value[0]), ("at_start", lost)):
            assert getattr(audit.regret, name) == Certified(value=truth)
            low, high = getattr(bounded.regret, name).interval
            assert F(low) <= truth <= F(high)
        # Bounds pass what they prove; ties that they cannot tell are left to rational arithmetic.
        assert lost == 0 or not (bounded.passed or bounded.claim is Claim.CERTIFIED)
        listed, wrong = ({each.state for each in x.disagreements} for x in (audit, bounded))
        assert wrong <= listed
        assert len(listed - wrong) <= bounded.unclear

    if isinstance(bounded.regret.at_start, Bounded):
        assert bounded.regret.at_start.error <= 1e-11 * scale
    by_state = [float(a - b) for a, b in zip(best, own, strict=True)]
    assert audit.regret.by_state.tolist() == by_state
    assert bounded.regret.by_state == pytest.approx(by_state, abs=1e-9 * scale)
    for pair in range(mdp.n_pairs):
        taken = int(mdp.pair_action[pair]) in optimal[int(mdp.pair_state[pair])]
        assert audit.regret.optimal_pairs[pair] == taken
    moving = {s for s, _, r, law in rows.pairs if r or set(law) != {s}}
    choosing = {s for s, actions in offered.items() if len(actions) > 1} & moving
    wrong = {s for s in choosing if policy[s] not in optimal[s]}
    assert {each.state for each in audit.disagreements} == wrong
    assert audit.agreement == (1 - len(wrong) / len(choosing) if choosing else 1)
    # What the states cost sums to the regret.
    costs = [each.cost for each in audit.disagreements]
    assert costs == sorted(costs, reverse=True)
    assert sum(costs) == pytest.approx(float(lost), abs=1e-9 * scale)
    for each in audit.disagreements:
        s = each.state
        _, _, reward, row = next(pair for pair in rows.pairs if pair[:2] == (s, policy[s]))
        q = reward + rows.discount * sum(p * best[t] for t, p in row.items())
        assert each.gap == pytest.approx(float(best[s] - q), abs=1e-9 * scale)


@pytest.mark.parametrize("case", [case for case in CASES if case.proper and case.n_states <= 200])
def test_published_policies_pass_and_wrong_ones_do_not(case: Case) -> None:
    mdp = of_case(case)
    best, optimal = solve_exact(case.n_states, case.pairs, case.discount)
    for choose in (min, max):
        audit = check(mdp, [choose(actions) for actions in optimal])
        assert (audit.passed, audit.agreement, audit.disagreements) == (True, 1.0, ())
    if len(case.wrong_policy) == case.n_states:
        wrong = [case.wrong_policy[s] for s in range(case.n_states)]
        own = evaluate_exact(case.n_states, case.pairs, case.discount, case.wrong_policy)
        failed, lost = check(mdp, wrong), best[case.start] - own[case.start]
        assert float(failed.regret.at_start.value) == pytest.approx(float(lost), abs=1e-9)
        assert failed.passed == (lost == 0)
        for s, value in case.wrong_values.items():
            wanted = pytest.approx(float(value), abs=max(1e-11, case.tolerance))
            assert failed.regret.learned_value[s] == wanted


# ---- the care model --------------------------------------------------------------------------


@pytest.mark.parametrize("seed", range(4))
def test_a_q_table_over_the_statuses_against_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    readings = [{}, {"skip_timestep": "own"}, {"task_bonus": "no-subtask-skipped"}, {}][seed]
    scenario = SMALL.with_(readings=readings, discount=["1", "19/20"][seed % 2])
    oracle, mdp = oracle_of(scenario), scenario.compile()
    q = rng.normal(size=(16, 4))

    greedy = acting({format(s, "04b"): ACTIONS[int(q[s].argmax())] for s in range(16)})
    own = oracle.evaluate(greedy, distribution=False)["mean"]
    audit = check(mdp, q)
    assert audit.regret.at_start == Certified(value=oracle.value(oracle.start) - own)
    assert audit.policy.columns == ("status",)
    why = audit.representation
    assert why is not None
    assert isinstance(why.loss, Certified)
    assert isinstance(why.learning_error, Certified)
    assert why.loss.value + why.learning_error.value == audit.regret.at_start.value
    assert why.learning_error.value >= 0
    assert why.best.proven


def test_q_errors_by_hand() -> None:
    mdp = SMALL.compile()
    exact = certify(mdp)
    q = np.zeros((mdp.n_states, mdp.n_actions))
    q[mdp.pair_state, mdp.pair_action] = mdp.backup(exact.value_float)
    right = check(mdp, q)
    assert right.passed
    assert right.q_error is not None
    assert right.q_error.largest < 1e-12
    assert right.q_error.promised == pytest.approx(float(exact.start_value), abs=1e-12)
    state = mdp.space.index(subtask=1, trial=1, status=6)
    q[state, 2] += 7.5
    q_error = check(mdp, q).q_error
    assert q_error is not None
    assert q_error.largest == pytest.approx(7.5)
    assert q_error.where == mdp.where(mdp.pair(state, 2))
    pairs = 4 * int(((evaluate(mdp, "random").visits > 0) & ~mdp.forced).sum())
    assert q_error.mean == pytest.approx(7.5 / pairs)
    assert q_error.root_mean_square == pytest.approx(7.5 / np.sqrt(pairs))
    assert check(mdp, "random").q_error is None


def test_a_wrong_state_that_is_never_visited_does_no_harm() -> None:
    rows = [
        (0, 0, [(1, 1, 0)]),
        (0, 1, [(1, 2, -5)]),  # nobody who is wise goes to state 2
        (1, 0, [(1, 3, 3)]),
        (1, 1, [(1, 3, 3)]),
        (2, 0, [(1, 3, 1)]),
        (2, 1, [(1, 3, -100)]),
        (3, 0, [(1, 3, 0)]),
    ]
    mdp = MDP.from_outcomes(rows)
    harmless = check(mdp, [0, 1, 1, 0])
    assert harmless.passed
    (wrong,) = harmless.disagreements
    assert (wrong.state, wrong.gap, wrong.expected_visits, wrong.cost) == (2, 101.0, 0.0, 0.0)
    assert "  1 that it never visits, which cost nothing" in str(harmless).splitlines()
    assert harmless.agreement == pytest.approx(2 / 3)  # the tie in state 1 counts as agreement
    assert harmless.agreement_by_visits == 1.0
    assert harmless.regret.by_state.tolist() == [0, 0, 101, 0]
    costly = check(mdp, [1, 0, 1, 0])
    assert not costly.passed
    assert [each.state for each in costly.disagreements] == [2, 0]
    assert [each.cost for each in costly.disagreements] == [101.0, 7.0]


def test_its_text_names_the_costliest_states_and_its_table_begins_with_what_matters() -> None:
    """A certificate in the regret is not spelled out."""
    rows = [(s, a, [(1, s + 1, a * (s + 1))]) for s in range(5) for a in (0, 1)]
    mdp = MDP.from_outcomes([*rows, (5, 0, [(1, 5, 0)])], discount=1)
    audit = check(mdp, [0] * 6)
    first, second, *states, rest = str(audit).splitlines()
    assert first == audit.message().splitlines()[0] == "read as a policy, discount 1, start state 0"
    assert second == "failed: regret 15 (certified) of 15, 5 disagreements"
    assert repr(audit) == f"Audit({first}; {second})"
    assert [line.partition(":")[0] for line in states] == ["  state 4", "  state 3", "  state 2"]
    assert rest == "  and 2 more, 3 in all"
    table = audit.frame()
    assert [*table.columns[:5]] == ["label", "learned", "optimal", "cost", "share"]
    assert table["share"].sum() == pytest.approx(1)
    assert (table.index.name, table.index[0]) == ("state", 4)
    assert "expected_visits" in audit.frame(full=True)
    assert max(map(len, str(table).splitlines())) <= 80
    assert repr(audit.regret) == "Regret(15 (certified): optimal 15, learned 0)"


def test_many_actions_take_one_line() -> None:
    """A policy that draws from many is named by its likeliest actions, and ties are counted."""
    rows = [(0, a, [(1, 1, int(a == 7))]) for a in range(25)] + [(1, 0, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows)
    (each,) = check(mdp, "random").disagreements
    assert (each.learned, each.optimal) == ("any of 25", ("7",))
    table = np.zeros((2, 25))
    table[1, 0] = 1
    for others, line in (
        (2, "0.5 3, 0.25 9, 0.125 0, 0.125 1"),
        (4, "0.5 3, 0.25 9, 0.0625 0, 3 others"),
    ):
        table[0] = 0
        table[0, [3, 9]] = 1 / 2, 1 / 4
        table[0, [0, 1, 4, 5][:others]] = 1 / 4 / others
        (each,) = check(mdp, table, kind="policy").disagreements
        assert sorted(each.learned.split(", ")) == sorted(line.split(", "))
    worst = check(mdp.with_(sense="min"), "always:7")
    assert len(worst.disagreements[0].optimal) == 24
    assert "optimal 0 or 1 or 2 or 21 others" in worst.message()


# ---- where a policy never ends -------------------------------------------------------------------


@settings(max_examples=60)
@given(any_models(4), st.randoms(use_true_random=False))
def test_policies_of_models_without_end_are_judged(pairs: Pairs, rng: Random) -> None:
    """Infinite values and visits are priced; what is proven optimal passes.

    Where rewards cancel on a loop, or the optimum is infinite, no gap says where it is lost: the
    states that are named pay for all of it.
    """
    rows = [(s, 2 * a + 1, [(p, t, r) for t, p in law.items()]) for s, a, r, law in pairs[1]]
    try:
        mdp = MDP.from_outcomes(rows, sense=rng.choice(["max", "min"]))
        proof = certify(mdp)
    except ModelError:  # totals that swing have no optimum
        return
    if isinstance(proof.start_value, float):  # nothing is compared with an equal infinity
        with pytest.raises(ModelError, match="nothing can be compared"):
            check(mdp, proof.policy)
    else:
        assert check(mdp, proof.policy).passed
    for _ in range(4):
        chosen = [rng.choice(list(mdp.pairs_of(state))) for state in range(mdp.n_states)]
        try:
            audit = check(mdp, mdp.pair_action[chosen])
        except ModelError:
            continue
        assert audit.message()
        assert len(audit.frame()) == len(audit.disagreements)
        assert audit.passed == (audit.value.value == 0)
        lost = sum(each.cost for each in audit.disagreements)
        assert lost == pytest.approx(float(audit.value.value))


def test_an_audit_says_what_it_compares_and_what_is_lost() -> None:
    """Rewards, costs, averages, limits that nothing keeps, and totals without end."""
    chances, rewards = [[[0, 1], [0, 1]]] * 2, [[1, 3], [0, 0]]
    mdp = MDP.from_arrays(chances, rewards, layout="ass", components={"c": [[1, 2], [0, 0]]})
    costs = mdp.with_(sense="min")
    for model, policy, best, own in ((mdp, [0, 0], 3, 1), (costs, [1, 0], 1, 3)):
        audit, aim = check(model, policy), ", costs to minimise" * (model is costs)
        assert audit.message().splitlines()[::2] == [
            f"read as a policy, discount 1{aim}, start state 0",
            f"optimal value {best}, learned {own}; not optimal in 1 of 1 states with a choice",
        ]
        assert audit.regret.optimal_value.tolist() == [best, 0]
        assert audit.regret.learned_value.tolist() == [own, 0]
        assert audit.relative_regret == 2 / best
    still = MDP.from_arrays([np.eye(2)] * 2, rewards, layout="ass")
    average = check(still, [0, 0], criterion="average")
    assert average.question == "read as a policy, reward per step, start state 0"
    # For ever 1 in state 1, to which state 0 may go: what leaves them loses all.
    endless = MDP.from_outcomes(
        [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 2, 5)]), (1, 0, [(1, 1, 1)]), (1, 1, [(1, 2, 0)]),
         (2, 0, [(1, 2, 0)])]
    )  # fmt: skip
    lost = check(endless, [1, 1, 0])
    assert (lost.value.value, lost.relative_regret) == (inf, None)
    assert lost.regret.gap.tolist() == [0, inf, 0, inf, 0]
    assert lost.regret.optimal_pairs.tolist() == [True, False, True, False, True]


def test_the_forest_policy_of_a_learner_s_test_is_rejected() -> None:
    """Its test takes (0, 1, 1) for right, and believes it to be worth 11.2 in the first state."""
    q = np.array([[11.19899, 10.34652], [10.74229, 11.74105], [2.86981, 12.25978]])
    audit = check(forest("24/25"), q)
    assert not audit.passed
    assert audit.regret.learned == Certified(value=F(10800, 932))
    assert audit.regret.optimal == Certified(value=F(746496, 10_000))
    assert [each.state for each in audit.disagreements] == [1, 2]
    assert audit.q_error is not None
    assert audit.q_error.promised == 11.19899
    with pytest.raises(AssertionError, match="state 1: yours 1, optimal 0"):
        assert_policy_optimal(forest("24/25"), q)


def test_the_error_of_a_table_that_waits_for_ever_is_that_of_where_it_waits() -> None:
    rows: list[Any] = [(2, 0, [(1, 2, 0)])]
    for state in range(2):
        rows += [(state, 0, [(1, state, -1)]), (state, 1, [(1, state + 1, -1)])]
    audit = check(MDP.from_outcomes(rows), np.zeros((3, 2)))
    assert audit.regret.at_start.value == inf
    assert audit.q_error is not None
    assert audit.q_error.visited == 3  # Q*(0, wait) = -1 + V*(0)


def test_an_action_that_only_a_policy_without_gain_uses_for_ever_is_to_blame() -> None:
    """The loop 0 -> 1 -> 0 earns nothing, and on average it is at a debt; staying in 0 is not."""
    rows: list[Any] = [(0, 0, [(1, 0, 0)]), (1, 0, [("4/5", 0, 1), ("1/5", 1, 0)])]
    rows += [(0, a, [("2/3", 0, 0), ("1/3", 1, -1)]) for a in (1, 2)] + [(1, 1, [(1, 1, 0)])]
    audit = check(MDP.from_outcomes(rows), [2, 0])
    assert audit.value.value == F(5, 17)
    [wrong] = audit.disagreements
    assert (wrong.state, wrong.optimal, wrong.cost) == (0, ("0",), 5 / 17)
    # The loop 0 -> 1 -> 2 -> 0: state 1 leaves where it should stay, and in 0 the actions are one.
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 0, [(1, 1, 0)]), (1, 1, [(1, 2, -1)])]
    audit = check(MDP.from_outcomes([*rows, (2, 0, [(1, 0, 1)])]), [1, 1, 0])
    assert [(each.state, each.cost) for each in audit.disagreements] == [(1, 1 / 3)]


def test_a_passing_audit_has_no_table_of_what_is_wrong() -> None:
    """What is wrong only in states that are never visited is counted, and fills no table."""
    rows = [(0, 0, [(1, 1, 1)]), (1, 0, [(1, 1, 0)]), (2, 0, [(1, 1, 0)]), (2, 1, [(1, 1, 1)])]
    audit = check(MDP.from_outcomes(rows), [0, 0, 0])
    assert audit.passed
    assert len(audit.disagreements) == 1
    report = audit.report()
    assert report.shown_tables() == []
    assert "costliest" not in report.html(10)


@pytest.mark.parametrize("sense", ["max", "min"])
def test_who_gives_up_an_infinite_value_is_to_blame(sense: str) -> None:
    """To leave keeps it only where one stays next time; who leaves for good earns 2."""
    one = 1 if sense == "max" else -1
    rows = [
        (0, 0, [(1, 0, one)]),
        (0, 1, [("1/2", 0, one), ("1/2", 1, one)]),
        (1, 0, [(1, 1, 0)]),
    ]
    audit = check(MDP.from_outcomes(rows, sense=sense), [1, 0])
    (wrong,) = audit.disagreements
    assert (wrong.state, wrong.learned, wrong.optimal, wrong.cost) == (0, "1", ("0",), inf)
    assert audit.agreement == 0
    assert "not optimal in 1 of 1 states" in audit.message()


def test_who_leaves_later_is_to_blame_where_that_is() -> None:
    """To come in is a chance that the optimum takes as well; then one has to stay."""
    rows = [
        (0, 0, [("1/2", 1, 0), ("1/2", 2, 0)]),
        (1, 0, [(1, 1, 1)]),
        (1, 1, [(1, 2, 9)]),
        (2, 0, [(1, 2, 0)]),
    ]
    (wrong,) = check(MDP.from_outcomes(rows), [0, 1, 0]).disagreements
    assert (wrong.state, wrong.optimal, wrong.cost) == (1, ("0",), inf)


def test_every_place_to_rest_is_optimal() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 0, -1)]), (0, 2, [(1, 0, 0)]), (1, 0, [(1, 1, 0)])]
    (wrong,) = check(MDP.from_outcomes(rows), [1, 0]).disagreements
    assert wrong.optimal == ("0", "2")
    # Two states between which one goes to and fro for nothing are a place to rest, too.
    rows = [(0, 0, [(1, 2, 0)]), (0, 1, [(1, 1, 0)]), (0, 2, [(1, 0, -1)])]
    rows += [(1, 0, [(1, 0, 0)]), (2, 0, [(1, 2, 0)])]
    (wrong,) = check(MDP.from_outcomes(rows), [2, 0, 0]).disagreements
    assert wrong.optimal == ("0", "1")


def test_a_ratio_beyond_the_floats_is_infinite() -> None:
    least, most = F(1, 10**200), F(10**200)
    rows = [(0, 0, [(1, 1, least)]), (0, 1, [(1, 1, -most)]), (1, 0, [(1, 1, 0)])]
    audit = check(MDP.from_outcomes(rows), [1, 0], max_relative_regret=1)
    assert audit.relative_regret == inf
    assert not audit.passed
    assert '"relative_regret": "inf"' in audit.report().json()


def test_where_no_policy_keeps_the_limits_there_is_nothing_to_agree_with() -> None:
    mdp = MDP.from_outcomes([(0, 0, [(1, 1, 1)]), (0, 1, [(1, 1, 2)]), (1, 0, [(1, 1, 0)])])
    lines = check(mdp, [0, 0], subject_to={"reward": ">= 3"}).report().lines()
    assert "nan" not in " ".join(lines.values())


def test_an_audit_is_not_a_condition() -> None:
    """`assert check(…)` would hold whatever the verdict."""
    audit = check(forest("9/10"), "random", max_regret=0)
    assert not audit.passed
    with pytest.raises(ModelError, match=r"neither true nor false") as refused:
        assert audit
    assert refused.value.fix == "ask for its verdict, Audit.passed"
