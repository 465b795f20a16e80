"""Strategies of published models: time-dependent rows, costs of transitions, two discounts."""

import pytest
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
