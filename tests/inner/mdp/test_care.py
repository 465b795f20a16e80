"""Care models in batches and in blocks, against exact fractions and the explicit model."""

from dataclasses import fields
from fractions import Fraction as F
from itertools import product

import numpy as np
import pytest
from own_scenarios import check_own, own_text, scenario_of

from exact_mdp import READINGS, ModelError, Scenario, counted
from exact_mdp.mdp.care import compile as blocks
from exact_mdp.mdp.care.compile import check_explicit, estimate_size
from exact_mdp.mdp.care.perception import compute_rates
from exact_mdp.mdp.table import OutcomeTable, Rows

# ---- models built in blocks ----------------------------------------------------------------------


@pytest.mark.parametrize("option", READINGS["skip_timestep"])
@pytest.mark.parametrize("tasks", [[1], [2, 1]])
def test_the_size_of_a_table_is_known_beforehand(option: str, tasks: list[int]) -> None:
    others = ("status_cost", "skip_onset", "task_bonus")
    for chosen in product(*(READINGS[name] for name in others)):
        readings = dict(zip(others, chosen, strict=True)) | {"skip_timestep": option}
        scenario = Scenario.load("yuan2025").with_(tasks=tasks, max_trial=2, readings=readings)
        (outcomes, denominator), table = estimate_size(scenario.laws), scenario.compile().table
        assert len(table.next) <= outcomes <= 3 * len(table.next)
        assert max(int(bottom) for bottom in table.denominator) <= denominator


def weighted(
    statuses: int, *, same: bool, subtasks: int = 2, base: F = F(1, 10**12 + 39)
) -> Scenario:
    """Made-up numbers, one trial; statuses that weigh the same, or all sums of them distinct."""
    numbers = {f"reward.s{i}": -1 if same else -(2**i) for i in range(statuses)}
    numbers |= {"base.s0": base, "base.s1": base}
    scenario = scenario_of(own_text(statuses, 2))
    return scenario.with_(tasks=[subtasks], max_trial=1, parameters=numbers)


@pytest.mark.parametrize("statuses", [3, 5])
@pytest.mark.parametrize("same", [True, False])
@pytest.mark.parametrize("base", [F(1, 3), F(1, 10**12 + 39)])
def test_last_trials_of_statuses_with_weights_of_their_own(
    statuses: int, same: bool, base: F, monkeypatch: pytest.MonkeyPatch
) -> None:
    scenario = weighted(statuses, same=same, base=base)
    table, (outcomes, denominator) = scenario.compile().table, estimate_size(scenario.laws)
    assert (table.weight.dtype == object) == (base != F(1, 3))
    assert (denominator >= 2**62) == (base != F(1, 3))
    check_own(scenario, range(0, table.pairs - 1, 1 if statuses == 3 else 37))
    assert len(table.next) <= outcomes
    monkeypatch.setattr(blocks, "BLOCK", 1)
    parts = weighted(statuses, same=same, base=base).compile().table
    arrays = (*fields(Rows), *fields(OutcomeTable))
    names = [field.name for field in arrays if field.name not in ("rows", "sound")]
    for name in names:
        assert np.array_equal(getattr(table, name), getattr(parts, name)), name


def test_what_is_too_large_to_build_is_refused_for_a_reason_that_is_true() -> None:
    scenario = Scenario.load("yuan2025").with_(tasks=[90_000])
    with pytest.raises(ModelError, match=r"7,200,000 states and up to [\d,]+ outcomes") as refused:
        scenario.compile()
    assert "statuses, more" not in refused.value.what
    with pytest.raises(ModelError, match=r"^11 statuses, more than 10"):
        scenario_of(own_text(11, 2))
    # 9 statuses have as many transitions either way, but not as many outcomes.
    check_explicit(weighted(9, same=True, subtasks=4).laws)
    with pytest.raises(ModelError, match=r"2,048 states and up to [\d,]+ outcomes of 230 bytes"):
        check_explicit(weighted(9, same=False, subtasks=4).laws)
    check_explicit(weighted(9, same=False, subtasks=4, base=F(1, 3)).laws)


def test_rates_are_of_single_statuses() -> None:
    counts = counted([("10", "11"), ("10", "00"), ("01", "01"), ("00", "10")], size=4)
    table = compute_rates(counts, ["anger", "confusion"])
    assert table[["status", "rate", "right", "total"]].to_numpy().tolist() == [
        ["anger", "sensitivity", 1, 2], ["anger", "specificity", 1, 2],
        ["confusion", "sensitivity", 1, 1], ["confusion", "specificity", 2, 3],
    ]  # fmt: skip
    empty = compute_rates(counted([("00", "00")], size=4), ["a", "b"]).iloc[0]
    assert (empty.total, empty.low, empty.high) == (0, 0.0, 1.0)
    ten = compute_rates(counted([(1, 1)] * 10 + [(0, 0)], size=2), ["a"]).iloc[0]
    assert (ten.low, ten.high) == (pytest.approx(0.025**0.1), 1.0)
