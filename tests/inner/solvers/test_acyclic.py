"""Two forms of the acyclic pass, sizes known beforehand, and layouts of repeated blocks."""

from __future__ import annotations

from dataclasses import fields
from fractions import Fraction as F

import numpy as np
import pytest
from hypothesis import given
from model_contents import is_acyclic
from own_scenarios import check_own, own_text, scenario_of
from strategies import Rows, models

from exact_mdp import MDP, READINGS, ModelError, Scenario, solve
from exact_mdp.mdp.care import compile as blocks
from exact_mdp.mdp.care.compile import check_explicit, size
from exact_mdp.mdp.graph import numbered_in_order, runs_in_order
from exact_mdp.mdp.table import OutcomeTable
from exact_mdp.mdp.validate import check_model
from exact_mdp.solvers.bounds import bounds


def acyclic(rows: Rows, *, floats: bool) -> MDP | None:
    mdp = rows.model(floats=floats)
    return mdp if is_acyclic(mdp) else None


@pytest.mark.parametrize("floats", [False, True])
@given(rows=models())
def test_loops_and_numpy_find_the_same(floats: bool, rows: Rows) -> None:
    mdp = acyclic(rows, floats=floats)
    if mdp is None:
        return
    found = [bounds.backward(mdp, mdp.reward)]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bounds, "MANY", 0)
        found.append(bounds.backward(mdp, mdp.reward))
    assert np.allclose(*found, rtol=1e-12, atol=1e-12 * np.abs(mdp.reward).max())


def test_an_order_that_is_not_that_of_the_numbers() -> None:
    mdp = Scenario.load("yuan2025").with_(tasks=[3, 1]).compile()
    turn = np.random.default_rng(7).permutation(mdp.n_states)
    order = np.argsort(turn[mdp.pair_state], kind="stable")
    other = MDP.from_pairs(
        turn[mdp.pair_state][order],
        mdp.pair_action[order],
        mdp.transition[order][:, np.argsort(turn)],
        mdp.reward[order],
        start=int(turn[0]),
    )
    assert not numbered_in_order(other)
    found, known = solve(other), solve(mdp)
    assert found.method == "backward-induction"
    gap = np.abs(found.value[turn] - known.value)
    assert (gap <= found.state_error[turn] + known.state_error + 1e-12).all()


def test_runs_do_not_lead_to_themselves() -> None:
    mdp = Scenario.load("yuan2025").compile()
    cuts = runs_in_order(mdp)
    assert np.diff(cuts).max() == 16
    assert (cuts[0], cuts[-1]) == (0, mdp.n_states)


# ---- sizes -----------------------------------------------------------------------------------


@pytest.mark.parametrize("option", READINGS["skip_timestep"])
@pytest.mark.parametrize("cost", READINGS["status_cost"])
@pytest.mark.parametrize("onset", READINGS["skip_onset"])
@pytest.mark.parametrize("bonus", ["always", "no-subtask-skipped"])
@pytest.mark.parametrize("tasks", [[1], [2, 1]])
def test_the_size_of_a_table_is_known_beforehand(
    option: str, cost: str, onset: str, bonus: str, tasks: list[int]
) -> None:
    readings = {"skip_timestep": option, "status_cost": cost}
    readings |= {"skip_onset": onset, "task_bonus": bonus}
    scenario = Scenario.load("yuan2025").with_(tasks=tasks, max_trial=2, readings=readings)
    (outcomes, denominator), table = size(*check_explicit(scenario)), scenario.compile().table
    assert len(table.next) <= outcomes <= 3 * len(table.next)
    assert max(int(bottom) for bottom in table.denominator) <= denominator


def weighted(
    statuses: int, *, same: bool, subtasks: int = 2, base: F = F(1, 10**12 + 39)
) -> Scenario:
    """Made-up numbers, one trial; statuses that weigh the same, or all sums of them distinct."""
    numbers = {f"reward.s{i}": -1 if same else -(2**i) for i in range(statuses)}
    scenario = scenario_of(own_text(statuses, 2))
    numbers |= {"base.s0": base, "base.s1": base}
    return scenario.with_(tasks=[subtasks], max_trial=1, parameters=numbers)


@pytest.mark.parametrize("statuses", [3, 5])
@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("base", [F(1, 3), F(1, 10**12 + 39)])
def test_last_trials_of_statuses_with_weights_of_their_own(
    statuses: int, same: bool, base: F
) -> None:
    scenario = weighted(statuses, same=same, base=base)
    table, (outcomes, denominator) = scenario.compile().table, size(*check_explicit(scenario))
    assert (table.weight.dtype == object) == (base != F(1, 3))
    assert (denominator >= 2**62) == (base != F(1, 3))
    check_own(scenario, range(0, table.pairs - 1, 1 if statuses == 3 else 37))
    assert len(table.next) <= outcomes


def test_a_few_present_vectors_at_a_time_make_the_same_table(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    whole = weighted(5, same=False).compile().table
    monkeypatch.setattr(blocks, "ENTRIES", 1)
    parts = weighted(5, same=False).compile().table
    for field in fields(OutcomeTable):
        assert np.array_equal(getattr(whole, field.name), getattr(parts, field.name)), field.name


def test_what_is_too_large_to_build_is_refused_for_a_reason_that_is_true() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[90_000])
    with pytest.raises(ModelError, match=r"7,200,000 states and up to [\d,]+ outcomes") as refused:
        scenario.compile()
    assert "statuses, more" not in refused.value.what
    with pytest.raises(ModelError, match=r"^11 statuses, more than 10"):
        scenario_of(own_text(11, 2))
    # 9 statuses have as many transitions either way, but not as many outcomes.
    check_explicit(weighted(9, same=True, subtasks=4))
    with pytest.raises(ModelError, match=r"2,048 states and up to [\d,]+ outcomes of 230 bytes"):
        check_explicit(weighted(9, same=False, subtasks=4))
    check_explicit(weighted(9, same=False, subtasks=4, base=F(1, 3)))


# ---- blocks that repeat ----------------------------------------------------------------------


@pytest.mark.parametrize("tasks", [[4], [1, 2], [3, 1, 2], [1, 1, 1], [2, 2]])
@pytest.mark.parametrize("reading", ["skip_timestep", "task_bonus", "status_cost"])
def test_a_layout_of_repeated_blocks_is_a_checked_model(tasks: list[int], reading: str) -> None:
    option = READINGS[reading][-1]
    scenario = Scenario.load("yuan2025").with_(tasks=tasks, readings={reading: option})
    mdp = scenario.compile()
    check_model(mdp)
    again = mdp.with_(name="again")  # built anew from the table, with everything derived anew
    for name in ("pair_offsets", "reward", "components"):
        assert np.array_equal(getattr(mdp, name), getattr(again, name)), name
    for name in ("data", "indices", "indptr"):
        array, other = getattr(mdp.transition, name), getattr(again.transition, name)
        assert np.array_equal(array, other), name
        assert array.dtype == other.dtype
        assert not array.flags.writeable
    assert np.array_equal(mdp.terminal, again.terminal)
    # The bonus is paid in the last subtask of each task, and nowhere else.
    bonus = mdp.components[:, mdp.component_names.index("task-complete")]
    paid = {int(k) for k in mdp.space.values("subtask")[mdp.pair_state[bonus != 0]]}
    assert paid == set((np.cumsum(tasks) - 1).tolist())
    assert np.allclose(mdp.components.sum(axis=1), mdp.reward, atol=1e-12)
