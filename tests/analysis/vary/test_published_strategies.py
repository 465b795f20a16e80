"""Strategies of published models: rows by time or residence, costs of transitions, discounts."""

import pytest
from cases import hip_replacement
from cases.sick_sicker import PUBLISHED, STRATEGIES, build_life

from exact_mdp import cohort_trace, cost_effectiveness


def test_the_time_dependent_tutorial() -> None:
    """Costs in dollars, QALYs in thousandths, and the ICERs of the two efficient strategies."""
    life = build_life()
    table = cost_effectiveness(life, {name: f"always:{name}" for name in STRATEGIES}).icers()
    for row in table.itertuples():
        assert (round(row.cost), round(row.effect, 3)) == PUBLISHED[row.strategy]
    by_name = table.set_index("strategy")
    assert by_name["ICER"].dropna().round().tolist() == [65_288, 104_461]
    assert by_name.loc["A", ["status", "by"]].tolist() == ["dominated", "B"]
    trace = cohort_trace(life, "always:usual").frame()
    assert trace["H"][1] == 1
    assert trace.iloc[:, 1:].sum(axis=1).tolist() == pytest.approx([1] * 77)


def test_a_risk_that_depends_on_the_years_in_a_state() -> None:
    """All digits that were printed: costs to 0.0001, QALYs to 0.00001, the ICER to 0.001."""
    devices = {name: f"always:{name}" for name in hip_replacement.PRICE}
    life, discounts = hip_replacement.build_life(), hip_replacement.DISCOUNTS
    table = cost_effectiveness(life, devices, discount=discounts).icers().set_index("strategy")
    for name, (cost, qalys) in hip_replacement.PUBLISHED.items():
        found = table.loc[name]
        assert (round(found["cost"], 4), round(found["effect"], 5)) == (cost, qalys)
    assert round(table.loc["NP1", "ICER"], 3) == hip_replacement.PUBLISHED_ICER
