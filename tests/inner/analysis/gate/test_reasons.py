"""Where a policy loses what it loses, and errors of a Q-table, beside loops in fractions."""

from dataclasses import replace
from fractions import Fraction as F
from math import inf, sqrt
from typing import Any

import numpy as np
import oracle
import pytest
from small_models import small_model

from exact_mdp import MDP, Column, Policy, StateSpace, check
from exact_mdp.analysis.gate.reasons import (
    Representation,
    q_error,
)
from exact_mdp.analysis.gate.regret import policy_regret
from exact_mdp.solvers.values.policy_chain import PolicyChain


def test_errors_of_a_table_are_those_of_states_with_a_choice() -> None:
    for seed in range(12):
        sense = "min" if seed % 2 else "max"
        mdp = small_model(seed, "1/2", states=5).with_(sense=sense, start=int(seed % 6))
        rng = np.random.default_rng(seed)
        q = rng.normal(size=(mdp.n_states, mdp.n_actions))
        policy = Policy.of(mdp, q, kind="q")
        optimal = rng.normal(size=mdp.n_pairs)
        optimal[int(rng.integers(mdp.n_pairs))] = inf
        used = rng.random(mdp.n_pairs)
        if seed % 3 == 0:
            used[rng.random(mdp.n_pairs) < 0.5] = inf
        met, before = {s for s, p in mdp.start if p}, set[int]()
        while met != before:
            before = set(met)
            met |= {t for s, _, _, row in oracle.rows_of(mdp) if s in before for t in row}
        asked = [
            pair
            for pair, s in enumerate(mdp.pair_state.tolist())
            if s in met and not mdp.forced[s] and not mdp.terminal[s] and optimal[pair] < inf
        ]
        found = q_error(mdp, policy, optimal, used)
        if not asked:
            assert found is None
            continue
        assert found is not None
        said = q[mdp.pair_state, mdp.pair_action]
        error = {pair: said[pair] - optimal[pair] for pair in asked}
        worst = max(asked, key=lambda pair: abs(error[pair]))
        assert found.largest == pytest.approx(abs(error[worst]))
        assert found.where == mdp.where(worst)
        assert found.mean == pytest.approx(sum(error.values()) / len(error))
        square = sum(x * x for x in error.values()) / len(error)
        assert found.root_mean_square == pytest.approx(sqrt(square))
        endless = any(x == inf for x in used)
        weight = {pair: float(used[pair] == inf) if endless else used[pair] for pair in asked}
        total = sum(weight.values())
        by_visits = sum(weight[pair] * error[pair] ** 2 for pair in asked) / total if total else 0.0
        assert found.visited == pytest.approx(sqrt(by_visits))
        pick = max if sense == "max" else min
        start = mdp.start[0][0]
        assert found.promised == pytest.approx(pick(said[pair] for pair in mdp.pairs_of(start)))


def test_a_table_may_lack_actions_and_hold_numbers_that_no_float_holds() -> None:
    rows: Any = [(0, a, [(1, 1, a)]) for a in range(3)] + [(1, 1, [(1, 1, 0)])]
    mdp = MDP.from_outcomes(rows, actions=["a", "b", "c"])
    huge = F(10) ** 400
    values = np.array([[huge, F(1, 2)], [F(0), F(0)]], dtype=object)
    rule = np.array([0, 0])
    policy = Policy(space=mdp.space, actions=("c", "a"), rule=rule, values=values)
    found = q_error(mdp, policy, np.array([1.0, 0, 3, 0]), np.zeros(4))
    assert found is not None
    assert (found.largest, found.mean, found.root_mean_square) == (0.5, -0.5, 0.5)
    assert found.where == mdp.where(0)
    assert found.visited == 0
    assert found.promised == inf


def seen_in_rows(seed: int) -> MDP:
    """Two rows that look alike at two times, of which a policy that reads `row` is to be told."""
    rng, rows = np.random.default_rng(seed), list[Any]()
    for s in range(4):
        for a in range(3):
            to = [2, 3, 4] if s < 2 else [4]
            rows.append((s, a, [(F(1, len(to)), t, int(rng.integers(-5, 6))) for t in to]))
    rows.append((4, 0, [(1, 4, 0)]))
    columns = (Column(name="time", size=2), Column(name="row", size=2))
    mdp = MDP.from_outcomes(rows, start={0: "1/2", 1: "1/2"})
    return mdp.with_(space=StateSpace(columns=columns, extra=("end",)))


def test_what_columns_cannot_express_and_what_was_learned_wrongly() -> None:
    for seed in range(6):
        for sense in ("max", "min"):
            mdp = seen_in_rows(seed).with_(sense=sense)
            rule = np.random.default_rng(seed).integers(0, 3, size=2)
            space = StateSpace(columns=(mdp.space.column("row"),))
            policy = Policy(space=space, actions=mdp.actions, rule=rule)
            lost = policy_regret(PolicyChain.of(mdp, policy))
            why = Representation.of(mdp, policy, lost)

            def worth(choice: Any, mdp: MDP = mdp) -> F:
                pairs = [mdp.pair(s, int(choice[s % 2])) for s in range(4)] + [mdp.n_pairs - 1]
                value = oracle.policy_values(oracle.rows_of(mdp, pairs), F(1), {4})
                return mdp.sense.sign * (value[0] + value[1]) / 2

            each = [(a, b) for a in range(3) for b in range(3)]
            best = max(map(worth, each))
            full, _ = oracle.solve_exact(
                5, [(s, a, mdp.sense.sign * r, row) for s, a, r, row in oracle.rows_of(mdp)], F(1)
            )
            whole = (full[0] + full[1]) / 2
            assert why.loss.value == whole - best
            assert why.learning_error.value == best - worth(rule)
            assert why.uncertainty == 0
            assert why.unseen == "time"
            gains = []
            for k in range(2):
                others = [[*rule[:k], a, *rule[k + 1 :]] for a in range(3) if a != rule[k]]
                gain = max(worth(other) - worth(rule) for other in others)
                if gain > 0:
                    gains.append((float(gain), f"row {k}"))
            found = [(row["gain"], row["row"]) for row in why.rows]
            assert [g for g, _ in found] == pytest.approx(
                sorted((g for g, _ in gains), reverse=True)
            )
            assert {name for _, name in found} == {name for _, name in gains}
            for row in why.rows:
                k = int(row["row"][-1])
                changed = rule.copy()
                changed[k] = mdp.actions.index(row["best"])
                assert row["learned"] == mdp.actions[rule[k]]
                assert row["gain"] == pytest.approx(float(worth(changed) - worth(rule)))
            open_ = replace(why, best=replace(why.best, proven=False, upper_bound=-7.5))
            assert open_.uncertainty == abs(-7.5 - why.best.value.value)
            facts = why.list_facts()["representation"].value
            assert facts["loss"] == float(why.loss.value)
            assert facts["learning_error"] == float(why.learning_error.value)


def test_rows_change_to_actions_that_all_their_states_offer() -> None:
    """State 0 does not offer action 2, so that row 0 has no such change; nobody meets row 2."""
    columns = (Column(name="row", size=3), Column(name="bed", size=2))
    pays = {(s, a): 9 if (s, a) == (1, 2) else a for s in range(6) for a in range(3)}
    rows: Any = [(s, a, [(1, 6, pay)]) for (s, a), pay in pays.items() if (s, a) != (0, 2)]
    mdp = MDP.from_outcomes([*rows, (6, 0, [(1, 6, 0)])], start=dict.fromkeys(range(4), "1/4"))
    mdp = mdp.with_(space=StateSpace(columns=columns, extra=("end",)))
    policy = Policy(
        space=StateSpace(columns=columns[:1]), actions=mdp.actions, rule=np.array([0, 1, 0])
    )
    why = Representation.of(mdp, policy, policy_regret(PolicyChain.of(mdp, policy)))
    assert why.rows == (
        {"row": "row 0", "learned": "0", "best": "1", "gain": pytest.approx(0.5)},
        {"row": "row 1", "learned": "1", "best": "2", "gain": pytest.approx(0.5)},
    )


def test_a_mixture_has_no_rows_to_be_changed() -> None:
    mdp = seen_in_rows(0)
    audit = check(mdp, "random")
    assert audit.representation is None  # it reads the whole state
    space = StateSpace(columns=(mdp.space.column("row"),))
    policy = Policy(space=space, actions=mdp.actions, rule=np.full((2, 3), 1 / 3))
    mixed = Representation.of(mdp, policy, policy_regret(PolicyChain.of(mdp, policy)))
    assert mixed.rows == ()


def test_a_loss_that_is_infinite_is_split_only_if_another_policy_loses_less() -> None:
    """Two states look alike: in one or both of them one action misses the goal."""
    space = StateSpace(columns=(Column(name="bed", size=2),), extra=("goal", "ditch"))

    def of_pairs(*ends: int) -> MDP:
        pairs = [(0, 0), (0, 1), (1, 0), (1, 1)]
        rows = [(s, a, [(1, to, 1 + 2 * s)]) for (s, a), to in zip(pairs, ends, strict=True)]
        rows += [(s, 0, [(1, s, 0)]) for s in (2, 3)]
        mdp = MDP.from_outcomes(rows, sense="min", start=["1/2", "1/2", 0, 0], labels={"end": [2]})
        return mdp.with_(space=space).until("end")

    columns = StateSpace(columns=())
    for ends, loss in (((2, 3, 2, 2), 0.0), ((2, 3, 3, 2), None)):
        mdp = of_pairs(*ends)
        wrong = Policy(space=columns, actions=mdp.actions, rule=np.array([1]))
        audit = check(mdp, wrong)
        assert audit.regret.at_start.value == inf
        why = audit.representation
        assert loss == (None if why is None else float(why.loss))
        if why is not None:
            assert float(why.learning_error) == inf
            assert [(row["best"], row["gain"]) for row in why.rows] == [("0", inf)]
