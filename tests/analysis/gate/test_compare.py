"""The audit of a policy: its regret, the price of each state, and what its columns allow."""

from fractions import Fraction as F
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from cases import CASES, Case
from cases.reference import evaluate_exact, solve_exact
from hypothesis import given, settings
from hypothesis import strategies as st
from oracle import ACTIONS, Oracle, State
from strategies import Rows, model_of, models

from exact_mdp.analysis import Audit, assert_policy_optimal, best_policy, check, value_of_memory
from exact_mdp.analysis.gate.relaxation import Relaxations, one_hot
from exact_mdp.analysis.gate.relaxation import Rows as TableRows
from exact_mdp.mdp import MDP, Column, ModelError, Policy, Scenario
from exact_mdp.mdp.chain import reachable
from exact_mdp.mdp.space import StateSpace
from exact_mdp.solvers import Bounded, Certified, Claim, certify, evaluate, solve

CARE = Scenario.load("yuan2025")
SMALL = CARE.with_(tasks=[2], max_trial=2, readings={"influence_orientation": "column-to-row"})
# Failed trials cost nothing and assistance much: what is best changes with the trial.
TEMPTING = CARE.with_(
    tasks=[2],
    max_trial=3,
    parameters={"reward.assist.directive": -30, "reward.trial": 0, "reward.timestep": 0},
)


def reference(rows: Rows, policy: dict[int, int]) -> tuple[list[F], list[F], list[set[int]]]:
    """Return optimal values, those of a policy, and the sets of optimal actions."""
    best, optimal = solve_exact(rows.n_states, rows.pairs, rows.discount)
    return best, evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy), optimal


def absorbing(rows: Rows) -> set[int]:
    return {
        s
        for s in range(rows.n_states)
        if all(r == 0 and set(row) == {s} for t, _, r, row in rows.pairs if t == s)
    }


def offered(rows: Rows) -> dict[int, list[int]]:
    return {s: [a for t, a, *_ in rows.pairs if t == s] for s in range(rows.n_states)}


@st.composite
def policies(draw: st.DrawFn, **wanted: object) -> tuple[Rows, dict[int, int]]:
    rows = draw(models(**wanted))
    return rows, {s: draw(st.sampled_from(actions)) for s, actions in offered(rows).items()}


def choices(rows: Rows, policy: dict[int, int]) -> list[int]:
    return [policy[s] for s in range(rows.n_states)]


# ---- regret against rational arithmetic ------------------------------------------------------


@settings(max_examples=40)
@given(policies())
def test_every_exact_number_is_the_reference_s(drawn: tuple[Rows, dict[int, int]]) -> None:
    rows, policy = drawn
    mdp = rows.model()
    best, own, optimal = reference(rows, policy)
    audit = check(mdp, choices(rows, policy))
    assert audit.claim is Claim.CERTIFIED
    assert audit.regret.optimal == Certified(value=best[0])
    assert audit.regret.learned == Certified(value=own[0])
    assert audit.regret.at_start == Certified(value=best[0] - own[0])
    assert audit.regret.by_state.tolist() == [float(a - b) for a, b in zip(best, own, strict=True)]
    assert audit.passed == (best[0] == own[0])
    for pair in range(mdp.n_pairs):
        taken = int(mdp.pair_action[pair]) in optimal[int(mdp.pair_state[pair])]
        assert audit.regret.optimal_pairs[pair] == taken
    ends = absorbing(rows)
    choosing = {s for s, actions in offered(rows).items() if len(actions) > 1} - ends
    wrong = {s for s in choosing if policy[s] not in optimal[s]}
    assert {each.state for each in audit.disagreements} == wrong
    assert audit.agreement == (1 - len(wrong) / len(choosing) if choosing else 1)


@settings(max_examples=40)
@given(policies(discounts=(F(0), F(1, 2), F(9, 10), F(1))))
def test_each_state_s_price_is_that_of_changing_it_alone(
    drawn: tuple[Rows, dict[int, int]],
) -> None:
    rows, policy = drawn
    mdp = rows.model()
    best, own, optimal = reference(rows, policy)
    audit = check(mdp, choices(rows, policy))
    scale = float(max(1, *map(abs, best), *map(abs, own)))
    total = sum(each.cost for each in audit.disagreements)
    assert total == pytest.approx(float(best[0] - own[0]), abs=1e-9 * scale)
    first = {s: min(actions) for s, actions in enumerate(optimal)}
    values = dict(enumerate(best))
    for each in audit.disagreements:
        s = each.state
        _, _, reward, row = next(pair for pair in rows.pairs if pair[:2] == (s, policy[s]))
        q = reward + rows.discount * sum(p * values[t] for t, p in row.items())
        assert each.gap == pytest.approx(float(best[s] - q), abs=1e-9 * scale)
        corrected = evaluate_exact(rows.n_states, rows.pairs, rows.discount, policy | {s: first[s]})
        gain = float(corrected[0] - own[0])
        assert each.gain_if_corrected == pytest.approx(gain, abs=1e-8 * scale)
        spoiled = evaluate_exact(rows.n_states, rows.pairs, rows.discount, first | {s: policy[s]})
        loss = float(best[0] - spoiled[0])
        assert each.loss_if_alone == pytest.approx(loss, abs=1e-8 * scale)
    costs = [each.cost for each in audit.disagreements]
    assert costs == sorted(costs, reverse=True)


@settings(max_examples=40)
@given(policies(discounts=(F(1, 2), F(9, 10), F(1))), st.booleans())
def test_bounds_hold_the_exact_regret(
    drawn: tuple[Rows, dict[int, int]], optimal_one: bool
) -> None:
    rows, policy = drawn
    if optimal_one:
        best = solve_exact(rows.n_states, rows.pairs, rows.discount)[1]
        policy = {s: max(actions) for s, actions in enumerate(best)}
    best, own, _ = reference(rows, policy)
    audit = check(rows.model(), choices(rows, policy), exact_values=False)
    if audit.claim is Claim.CERTIFIED:  # the bounds prove that the policy is optimal
        assert audit.regret.at_start == Certified(value=F(0))
    for found, truth in (
        (audit.regret.optimal, best[0]),
        (audit.regret.learned, own[0]),
        (audit.regret.at_start, best[0] - own[0]),
    ):
        assert F(found.interval[0]) <= truth <= F(found.interval[1])
    scale = float(max(1, *map(abs, best), *map(abs, own)))
    if isinstance(audit.regret.at_start, Bounded):
        assert audit.regret.at_start.error <= 1e-11 * scale
    if audit.passed:
        assert best[0] == own[0]
    if best[0] == own[0]:  # ties that the bounds cannot tell are left to rational arithmetic
        assert check(rows.model(), choices(rows, policy)).passed
    assert audit.regret.by_state == pytest.approx(
        [float(a - b) for a, b in zip(best, own, strict=True)], abs=1e-9 * scale
    )


@settings(max_examples=30)
@given(models(discounts=(F(1, 2), F(9, 10), F(1))))
def test_a_mixed_policy_is_certified_and_bounded(rows: Rows) -> None:
    mdp = rows.model()
    best = solve_exact(rows.n_states, rows.pairs, rows.discount)[0]
    mixed = []  # choosing among a state's actions at random, as one action
    for s, actions in offered(rows).items():
        share = F(1, len(actions))
        own = [pair for pair in rows.pairs if pair[0] == s]
        row: dict[int, F] = {}
        for _, _, _, following in own:
            for t, p in following.items():
                row[t] = row.get(t, F(0)) + share * p
        mixed.append((s, 0, share * sum(r for _, _, r, _ in own), row))
    value = evaluate_exact(rows.n_states, mixed, rows.discount, dict.fromkeys(range(len(mixed)), 0))
    audit = check(mdp, "random")
    assert audit.regret.learned == Certified(value=value[0])
    assert audit.regret.at_start == Certified(value=best[0] - value[0])
    assert audit.passed == (best[0] == value[0])
    low, high = check(mdp, "random", exact_values=False).regret.at_start.interval
    assert F(low) <= best[0] - value[0] <= F(high)


@pytest.mark.parametrize("case", [case for case in CASES if case.proper and case.n_states <= 200])
def test_published_policies_pass_and_wrong_ones_do_not(case: Case) -> None:
    mdp = model_of(case.n_states, case.pairs, case.discount, start=case.start)
    best, optimal = solve_exact(case.n_states, case.pairs, case.discount)
    audit = check(mdp, [min(actions) for actions in optimal])
    assert (audit.passed, audit.agreement, audit.disagreements) == (True, 1.0, ())
    assert check(mdp, [max(actions) for actions in optimal]).passed
    if len(case.wrong_policy) == case.n_states:
        wrong = [case.wrong_policy[s] for s in range(case.n_states)]
        own = evaluate_exact(case.n_states, case.pairs, case.discount, case.wrong_policy)
        found = check(mdp, wrong)
        assert float(found.regret.at_start.value) == pytest.approx(
            float(best[case.start] - own[case.start]), abs=1e-9
        )
        assert found.passed == (best[case.start] == own[case.start])
        for s, value in case.wrong_values.items():
            assert found.regret.learned_value[s] == pytest.approx(
                float(value), abs=max(1e-11, case.tolerance)
            )


def test_the_forest_policy_of_a_learner_s_test_is_rejected() -> None:
    """Its test takes (0, 1, 1) for right, and believes it to be worth 11.2 in the first state."""
    wait, cut = [["1/10", "9/10", 0], ["1/10", 0, "9/10"], ["1/10", 0, "9/10"]], [[1, 0, 0]] * 3
    forest = MDP.from_arrays([wait, cut], [[0, 0], [0, 1], [4, 2]], discount="24/25")
    q = np.array([[11.19899, 10.34652], [10.74229, 11.74105], [2.86981, 12.25978]])
    audit = check(forest, q)
    assert not audit.passed
    assert audit.regret.learned == Certified(value=F(10800, 932))
    assert audit.regret.optimal == Certified(value=F(746496, 10_000))
    assert [each.state for each in audit.disagreements] == [1, 2]
    assert audit.q_error is not None
    assert audit.q_error.promised == 11.19899
    with pytest.raises(AssertionError, match=r"\(state 1\): 1, not 0"):
        assert_policy_optimal(forest, q)


# ---- the care model --------------------------------------------------------------------------


def oracle_of(scenario: Scenario) -> Oracle:
    return Oracle(
        dict(scenario.readings),
        scenario.tasks,
        scenario.max_trial,
        scenario.discount,
        scenario.values(),
    )


@pytest.mark.parametrize("seed", range(4))
def test_a_q_table_over_the_statuses_against_the_oracle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    readings = [{}, {"skip_timestep": "own"}, {"task_bonus": "no-subtask-skipped"}, {}][seed]
    scenario = SMALL.with_(readings=readings, discount=["1", "19/20"][seed % 2])
    oracle, mdp = oracle_of(scenario), scenario.compile()
    q = rng.normal(size=(16, 4))

    def greedy(state: State) -> dict[str, F]:
        assert not isinstance(state, str)
        status = int("".join(map(str, state[3])), 2)
        return {ACTIONS[int(q[status].argmax())]: F(1)}

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
    found = check(mdp, q).q_error
    assert found is not None
    assert found.largest == pytest.approx(7.5)
    assert found.where == mdp.where(mdp.pair(state, 2))
    pairs = 4 * int((reachable(mdp) & ~mdp.forced).sum())
    assert found.mean == pytest.approx(7.5 / pairs)
    assert found.root_mean_square == pytest.approx(7.5 / np.sqrt(pairs))
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
    assert (wrong.gain_if_corrected, wrong.loss_if_alone) == (0.0, 0.0)
    assert harmless.agreement == pytest.approx(2 / 3)  # the tie in state 1 counts as agreement
    assert harmless.agreement_by_visits == 1.0
    assert harmless.regret.by_state.tolist() == [0, 0, 101, 0]
    costly = check(mdp, [1, 0, 1, 0])
    assert not costly.passed
    assert [each.state for each in costly.disagreements] == [2, 0]
    assert [each.cost for each in costly.disagreements] == [101.0, 7.0]


def test_ties_of_floats_are_no_disagreements() -> None:
    """Thirds as floats: two ways round to the same place differ in the last digit."""
    a, b = [0.1, 0.2, 0.7], [0.7, 0.2, 0.1]
    rows = [(0, 0, [(p, 1 + i, 0.3) for i, p in enumerate(a)])]
    rows += [(0, 1, [(p, 3 - i, 0.1 + 0.2) for i, p in enumerate(b)])]
    rows += [(s, 0, [(1.0, 4, [0.1, 0.2, 0.1][s - 1])]) for s in (1, 2, 3)] + [
        (4, 0, [(1.0, 4, 0.0)])
    ]
    mdp = MDP.from_outcomes(rows)
    assert certify(mdp).gaps[0] is not None  # exactly, they differ
    for action in (0, 1):
        audit = check(mdp, [action, 0, 0, 0, 0])
        assert (audit.passed, audit.agreement, audit.claim) == (True, 1.0, Claim.CERTIFIED)


# ---- limits ----------------------------------------------------------------------------------


def two_ways(lost: F = F(1, 10)) -> MDP:
    """A choice between earning 2 and earning a little less."""
    rows = [(0, 0, [(1, 1, 2)]), (0, 1, [(1, 1, 2 - lost)]), (1, 0, [(1, 1, 0)])]
    return MDP.from_outcomes(rows)


@pytest.mark.parametrize(
    ("limits", "passed"),
    [
        ({}, False),
        ({"max_regret": "1/10"}, True),
        ({"max_regret": 0.1}, True),  # the float is above 1/10
        ({"max_regret": F(1, 10) - F(1, 10**30)}, False),
        ({"max_relative_regret": "1/20"}, True),
        ({"max_relative_regret": "49/1000"}, False),
        ({"max_regret": 1, "max_relative_regret": 0}, False),
        ({"max_regret": 0}, False),
    ],
)
def test_limits_are_compared_exactly(limits: dict[str, object], passed: bool) -> None:
    audit = check(two_ways(), [1, 0], **limits)
    assert audit.passed is passed
    assert len(audit.verdicts) == max(1, len(limits))
    assert audit.relative_regret == pytest.approx(0.05)
    bounded = check(two_ways(), [1, 0], exact_values=False, **limits)
    # At the limit itself bounds cannot decide, and what is not decided does not pass.
    at_the_limit = limits in ({"max_regret": "1/10"}, {"max_regret": 0.1})
    at_the_limit |= limits == {"max_relative_regret": "1/20"}
    assert bounded.passed is (passed and not at_the_limit)
    if passed and not bounded.passed:
        assert "do not decide" in bounded.message()


@pytest.mark.parametrize("limit", [-1, "nan", float("nan"), float("inf"), "x", True, [1]])
def test_limits_that_are_none_are_refused(limit: object) -> None:
    with pytest.raises(ModelError) as error:
        check(two_ways(), [0, 0], max_regret=limit)
    assert error.value.where == "max_regret"


def test_relative_regret_of_nothing() -> None:
    mdp = two_ways(F(1)).with_(start=1)
    assert (check(mdp, [1, 0]).relative_regret, check(mdp, [1, 0]).passed) == (None, True)
    assert not check(mdp, [1, 0], max_relative_regret=0).passed
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, -1)]), (1, 0, [(1, 1, 0)])]
    audit = check(MDP.from_outcomes(rows), [1, 0], max_relative_regret=1000)
    assert (audit.relative_regret, audit.passed) == (None, False)
    assert "undefined" in audit.message()


def test_assertion_names_the_costly_states_and_returns_the_audit() -> None:
    audit = assert_policy_optimal(two_ways(), [0, 0])
    assert isinstance(audit, Audit)
    assert assert_policy_optimal(two_ways(), [1, 0], 0.2).regret.at_start.value == F(1, 10)
    with pytest.raises(AssertionError) as error:
        assert_policy_optimal(two_ways(), [1, 0])
    assert "(state 0): 1, not 0; gap 0.1 x 1 visits = 0.1" in str(error.value)
    with pytest.raises(AssertionError):
        assert_policy_optimal(two_ways(), [1, 0], 0.2, max_relative_regret="1/100")


# ---- forms of what was learned ---------------------------------------------------------------


def test_every_form_of_a_policy_and_of_a_q_table(tmp_path: Path) -> None:
    mdp = SMALL.compile()
    q = np.random.default_rng(5).normal(size=(16, 4))
    greedy = q.argmax(axis=1)
    by_name = {format(s, "04b"): mdp.actions[a] for s, a in enumerate(greedy)}
    keys = mdp.space.values("status")
    whole = q[keys]  # the end reads the last row, which does not matter
    np.save(tmp_path / "q.npy", q)
    np.savez(tmp_path / "q.npz", q=whole, other=np.zeros(3))
    np.save(tmp_path / "regular.npy", whole[:-1])
    Policy.of(mdp, by_name).write(tmp_path / "policy.json")
    Policy.of(mdp, by_name).write(tmp_path / "policy.csv")
    tables = [q, q.tolist(), whole, whole[:-1], (1000 * q).astype(int)]
    tables += [tmp_path / "q.npy", str(tmp_path / "q.npz"), tmp_path / "regular.npy"]
    others = [by_name, Policy.of(mdp, by_name), greedy[keys], np.eye(4)[greedy[keys]]]
    others += [tmp_path / "policy.json", str(tmp_path / "policy.csv")]
    others += [np.eye(4, dtype=int)[greedy[keys]]]
    run = SimpleNamespace(q=q, policy=lambda mdp: Policy.from_q(mdp, q))
    expected = check(mdp, by_name).regret.at_start
    for learned in (*tables, run, Policy.from_q(mdp, q)):  # which knows its Q-table
        audit = check(mdp, learned)
        assert audit.regret.at_start == expected
        assert audit.q_error is not None
    for learned in others:
        audit = check(mdp, learned)
        assert (audit.regret.at_start, audit.q_error) == (expected, None)
    for solved in (solve(mdp), certify(mdp)):
        assert check(mdp, solved).passed
    assert check(mdp, "always:none").regret.learned.value == pytest.approx(
        evaluate(mdp, "always:none").mean
    )


@pytest.mark.parametrize(
    "learned",
    [
        np.full((16, 4), np.nan),
        np.zeros((15, 4)),
        np.zeros((16, 5)),
        np.zeros(16),
        np.array([["a"]]),
        {"0000": "none"},
        {"0000": "nothing"},
        "always:nothing",
        "missing.npy",
        3,
        None,
    ],
)
def test_what_does_not_fit_the_model_is_refused(learned: object) -> None:
    with pytest.raises(ModelError):
        check(SMALL.compile(), learned)


def test_probabilities_say_nothing_of_the_end() -> None:
    mdp = SMALL.compile()
    table = np.full((mdp.n_states, 4), 0.25)
    table[-1] = 0.0  # the end, where nothing is chosen
    uniform = check(mdp, "random").regret.at_start
    assert check(mdp, table, kind="policy").regret.at_start == uniform
    with pytest.raises(ModelError, match="may be probabilities or action values"):
        check(mdp, table)
    table[0] = 0.3
    with pytest.raises(ModelError, match="not a distribution"):
        check(mdp, table, kind="policy")


# ---- policies that read some columns only ----------------------------------------------------


@st.composite
def tables(draw: st.DrawFn) -> MDP:
    """A model of a few steps or of a cycle, whose states have a row and something else."""
    times, rows, actions = draw(st.tuples(*[st.integers(1, 3)] * 2, st.integers(2, 3)))
    cyclic = draw(st.booleans())
    end = times * rows
    outcomes = []
    for s in range(end):
        later = range((s // rows + 1) * rows, min(end, (s // rows + 2) * rows))
        targets = [*range(end), end] if cyclic else [*later] or [end]
        for a in range(actions):
            weights = draw(
                st.lists(st.integers(0, 3), min_size=len(targets), max_size=len(targets))
            )
            weights[-1] += 1
            reward = draw(st.integers(-4, 4))
            outcomes.append(
                (
                    s,
                    a,
                    [
                        (F(w, sum(weights)), t, reward)
                        for t, w in zip(targets, weights, strict=True)
                        if w
                    ],
                )
            )
    outcomes.append((end, 0, [(F(1), end, 0)]))
    columns = (Column(name="time", size=times), Column(name="row", size=rows))
    space = StateSpace(columns=columns, extra=("end",))
    discount = F(9, 10) if cyclic else draw(st.sampled_from([F(1), F(1, 2)]))
    return MDP.from_outcomes(outcomes, discount).with_(space=space)


def every_policy(mdp: MDP, columns: tuple[str, ...]) -> list[float]:
    rows = TableRows.of(mdp, columns)
    return [
        evaluate(mdp, rows.policy(np.array(choice))).mean
        for choice in product(
            range(mdp.n_actions), repeat=int((rows.available.sum(axis=1) > 0).sum())
        )
    ]


@settings(max_examples=25)
@given(tables())
def test_the_best_policy_is_the_best_of_all(mdp: MDP) -> None:
    for columns in ((), ("row",)):
        values = every_policy(mdp, columns)
        best = best_policy(mdp, columns)
        assert best.proven
        assert best.value.value == pytest.approx(max(values), abs=1e-9)
        assert best.value.error < 1e-9
        assert max(values) <= best.upper_bound + 1e-12 <= best.value.value + 1e-8
        assert evaluate(mdp, best.policy).mean == pytest.approx(best.value.value, abs=1e-9)
        assert best.policy.columns == columns
        cut = best_policy(mdp, columns, node_limit=1)
        assert cut.upper_bound >= max(values) - 1e-12
        assert cut.value.value <= max(values) + 1e-9
        assert cut.proven == (cut.upper_bound - cut.value.value < 1e-8)
    found = value_of_memory(mdp, ("row",))
    assert [each.columns for each in found] == [("row",), ("time", "row")]
    exact = float(certify(mdp).start_value)
    assert found[1].value.value == pytest.approx(exact, abs=1e-9)
    assert best.mixed_upper_bound == pytest.approx(exact, abs=1e-9)


@settings(max_examples=30)
@given(tables(), st.integers(0, 2**32))
def test_no_policy_that_a_relaxation_allows_is_worth_more(mdp: MDP, seed: int) -> None:
    random = np.random.default_rng(seed)
    rows = TableRows.of(mdp, ("row",))
    allowed = random.random((8, *rows.available.shape)) < 0.6
    allowed |= one_hot(random.integers(mdp.n_actions, size=allowed.shape[:2]), mdp.n_actions)
    found = Relaxations(rows).expand(allowed)
    assert found.kept.tolist() == list(range(8))
    for n in range(8):
        mixed = random.random(rows.available.shape) * allowed[n]
        policy = Policy.by(mdp, ("row",), mixed / mixed.sum(axis=1, keepdims=True))
        worth = evaluate(mdp, policy)
        assert worth.mean - worth.start.error <= found.upper[n]
        own = evaluate(mdp, rows.policy(found.choice[n])).mean
        assert own == pytest.approx(found.value[n], abs=1e-9)
        assert allowed[n][np.arange(allowed.shape[1]), found.choice[n]].all()
        assert found.loss[n].sum() == pytest.approx(found.upper[n] - own, abs=1e-8)
    values, errors = Relaxations(rows).evaluate(found.choice)
    for value, error, choice in zip(values, errors, found.choice, strict=True):
        truth = evaluate(mdp, rows.policy(choice))
        assert abs(truth.mean - value) <= error + truth.start.error


def test_what_a_status_policy_cannot_express() -> None:
    mdp = TEMPTING.compile()
    best, *others = value_of_memory(mdp)
    optimal = float(certify(mdp).start_value)
    assert best.columns == ("status",)
    assert best.proven
    assert optimal - best.value.value > 0.005  # what is best changes with the trial
    assert [each.columns for each in others] == [
        ("subtask", "status"),
        ("trial", "status"),
        ("subtask", "trial", "status"),
    ]
    for each in others:
        assert each.proven
        assert best.value.value - 1e-9 <= each.value.value <= optimal + 1e-9
    assert others[-1].value.value == pytest.approx(optimal, abs=1e-9)
    audit = check(mdp, best.policy)
    why = audit.representation
    assert why is not None
    assert not audit.passed
    assert float(why.learning_error.value) == 0
    assert why.rows == ()
    assert why.loss == audit.regret.at_start
    assert [each.columns for each in why.memory] == [each.columns for each in (best, *others)]
    assert check(mdp, others[-1].policy).representation is None


def test_no_neighbour_of_the_best_status_policy_is_better() -> None:
    mdp = TEMPTING.with_(discount="19/20").compile()
    best = best_policy(mdp)
    taken = best.policy.table.argmax(axis=1)
    rng = np.random.default_rng(3)
    for _ in range(60):
        other = taken.copy()
        changed = rng.integers(16, size=rng.integers(1, 4))
        other[changed] = rng.integers(4, size=len(changed))
        worth = evaluate(mdp, Policy.by(mdp, ("status",), other))
        assert worth.mean - worth.start.error <= best.upper_bound


def test_rows_of_a_policy_that_gain_by_a_change() -> None:
    mdp = SMALL.compile()
    audit = check(mdp, np.random.default_rng(2).normal(size=(16, 4)))
    assert audit.representation is not None
    changes = audit.representation.rows
    assert len(changes) > 3
    assert [each.gain for each in changes] == sorted((e.gain for e in changes), reverse=True)
    own = {format(s, "04b"): mdp.actions[int(a)]
           for s, a in enumerate(audit.policy.table.argmax(axis=1))}  # fmt: skip
    for each in changes:
        label = each.row.removeprefix("status ")
        assert own[label] == each.learned
        better = check(mdp, own | {label: each.best})
        gain = audit.regret.at_start.value - better.regret.at_start.value
        assert each.gain == pytest.approx(float(gain), abs=1e-9)


def test_a_start_policy_is_never_lost() -> None:
    mdp = TEMPTING.compile()
    good = best_policy(mdp).policy
    cut = best_policy(mdp, start=good, node_limit=1)
    assert cut.value.value == pytest.approx(best_policy(mdp).value.value, abs=1e-9)


def test_rows_that_share_no_action_are_refused() -> None:
    rows = [(0, 0, [(1, 1, 0)]), (0, 1, [(1, 1, 0)]), (1, 2, [(1, 2, 0)]), (1, 3, [(1, 2, 0)]),
            (2, 0, [(1, 2, 0)])]  # fmt: skip
    space = StateSpace(
        columns=(Column(name="time", size=2), Column(name="row", size=1)), extra=("end",)
    )
    mdp = MDP.from_outcomes(rows).with_(space=space)
    with pytest.raises(ModelError, match="no action is available in all"):
        best_policy(mdp, ("row",))
    assert best_policy(mdp, ("time", "row")).proven
    with pytest.raises(ModelError, match="unknown state column"):
        best_policy(mdp, ("rows",))
    with pytest.raises(ModelError, match="node_limit"):
        best_policy(mdp, ("time",), node_limit=0)
